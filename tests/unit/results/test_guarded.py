"""Files that HDF5 cannot open end no process."""

import h5py
import pytest

from support.helpers import run_python

OPEN = """
import sys
from pdfem_mpi.results.guarded import guarded
try:
    with guarded(sys.argv[1], "r+"):
        print("open")
except OSError as error:
    print("refused:", error)
"""


def whole(path):
    with h5py.File(path, "w") as file:
        file["x"] = range(1000)


def zeros(path):
    path.write_bytes(bytes(5000))


def cut(path):
    whole(path)
    path.write_bytes(path.read_bytes()[:-100])


def nothing(path):
    path.write_bytes(b"")


@pytest.mark.parametrize(
    ("make", "said"), [(whole, "open"), (zeros, "refused: "), (cut, "refused: "), (nothing, "refused: ")]
)
def test_a_damaged_file_ends_no_process(tmp_path, make, said):
    """HDF5 that opened it through an object would end the process with a segmentation fault, after its last line."""
    path = tmp_path / "file.h5"
    make(path)
    result = run_python("-c", OPEN, path)
    assert result.stdout.startswith(said), result.stderr
    assert result.returncode == 0
