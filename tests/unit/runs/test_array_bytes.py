"""Bytes of arrays are found wherever objects keep them, and each buffer counts once."""

from dataclasses import dataclass
from functools import partial

import numpy as np
from scipy import sparse

from pdfem_mpi.model.bounds import Bounds
from pdfem_mpi.peridynamics.rows import Rows
from pdfem_mpi.runs.array_bytes import Count

WHOLE = np.zeros(1000)  # 8000 bytes


@dataclass
class Stranger:
    """Not of this package: not looked into."""

    array: np.ndarray


class Holder:
    """Counts as one of the package's own."""

    def __init__(self, **things):
        self.__dict__.update(things)

    def method(self):
        """Do nothing."""


Holder.__module__ = "pdfem_mpi.test"


def counted(*things):
    return Count().bytes_of(*things)


def test_a_view_counts_as_the_buffer_that_it_keeps():
    assert counted(WHOLE[:3]) == 8000
    assert counted(WHOLE[::2].reshape(-1, 2).T) == 8000


def test_a_buffer_counts_once_and_for_whom_it_is_asked_first():
    count = Count()
    assert count.bytes_of(WHOLE[:10], WHOLE.view(np.int64)) == 8000
    assert count.bytes_of([WHOLE, np.zeros(2, np.float32)]) == 8
    assert count.total == 8008


def test_arrays_are_found_in_containers_objects_and_functions():
    a, b, c, d, e, f = (np.zeros(n) for n in (1, 10, 100, 1000, 10_000, 100_000))
    holder = Holder(inside={"a": (a, [b])}, rows=Rows(c, c, c))
    holder.itself = holder
    things = holder, partial(np.add, d), lambda: e, Holder(f=f).method, Bounds()
    assert counted(*things) == 8 * 111_111


def test_sparse_matrices_are_counted_and_strangers_are_not():
    matrix = sparse.csr_array(np.eye(5))
    assert counted(matrix) == matrix.data.nbytes + matrix.indices.nbytes + matrix.indptr.nbytes
    assert counted(Stranger(WHOLE), None, "text", np.empty((0, 3)), np.float64(1.0)) == 0


def test_objects_made_where_others_were_are_counted():
    """Numbers of dead objects are given again: they must not pass for visited ones."""
    count = Count()
    assert [count.bytes_of([np.zeros(4)]) for _ in range(50)] == [32] * 50


def test_a_copy_goes_on_by_itself():
    count = Count()
    count.bytes_of(WHOLE)
    assert count.copy().bytes_of(WHOLE, np.zeros(2)) == 16
    assert count.total == 8000
