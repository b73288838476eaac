"""Forces out of the table of nodes, and sums of what cells give to them, against numpy."""

import numpy as np

from pdfem_mpi.kernels import node_table

QUANTUM = 2.0**-40
N = 7


def numbers(*shape):
    return np.random.default_rng(3).standard_normal(shape)


def test_forces_of_nodes_are_read():
    integers = np.rint(numbers(N + 1, 3) / QUANTUM).astype(np.int64)
    external, force = 3.0 * numbers(N, 3), np.empty((N, 3))
    node_table.read_nodes(integers, QUANTUM, external, force)
    assert (force == external + integers[:N] * QUANTUM).all()


def test_what_nodes_add_is_rounded():
    places, r = np.array([5, 0, 3, 5], np.int32), numbers(4, 3)
    sums = np.arange(3 * N).reshape(N, 3)
    expected = sums.copy()
    np.add.at(expected, places, np.rint(r / QUANTUM).astype(np.int64))
    node_table.add_rounded_rows(places, r, QUANTUM, sums)
    assert (sums == expected).all()
