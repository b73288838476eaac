"""Private memory is told apart from what several processes share, also at a peak between two looks."""

import sys

import pytest

from pdfem_mpi.system import process_memory
from pdfem_mpi.system.process_memory import footprint
from support.helpers import run_python

MIB = 2**20
#: Python's own goings on beside 64 MiB that are taken on purpose.
NEAR = 4 * MIB

# In a process of its own: the system keeps the largest memory since it began.
MEASURE = """
import mmap
from pdfem_mpi.system.process_memory import MemoryWatch
SIZE = 64 << 20
watch = MemoryWatch()
shared = mmap.mmap(-1, SIZE)
shared.write(b"1" * (SIZE // 2))
shared.write(b"1" * (SIZE // 2))
watch.look()
print(watch.private_peak - watch.start.private, watch.last.resident - watch.start.resident)
taken = b"1" * (SIZE + 1)
del taken
watch.look()
print(watch.private_peak - watch.start.private, watch.last.private - watch.start.private)
"""


@pytest.mark.skipif(not sys.platform.startswith("linux"), reason="/proc tells them apart")
def test_private_memory_is_told_from_shared_memory_and_its_peak_found_between_looks():
    answer = run_python("-c", MEASURE)
    assert answer.returncode == 0, answer.stderr
    half, shared, peak, after = map(int, answer.stdout.split())
    assert 32 * MIB - NEAR < half < 32 * MIB + NEAR  # the bytes that were copied from
    assert shared > 64 * MIB - NEAR
    assert 64 * MIB - NEAR < peak < 64 * MIB + NEAR
    assert after < NEAR


def test_without_the_files_of_linux_all_memory_counts_as_private(monkeypatch, tmp_path):
    monkeypatch.setattr(process_memory, "STATUS", tmp_path / "none")
    now = footprint()
    assert now.private == now.resident > MIB and now.peak >= now.resident and now.shared == 0
