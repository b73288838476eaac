"""Sparse matrices are loaded without numpy's translators of Fortran and helpers of tests, which stay to be had."""

import subprocess
import sys

SCRIPT = """
import sys
from pdfem_mpi.runs.libraries import load_sparse_matrices
import numpy as np
{before}
load_sparse_matrices()
print(*sorted(name for name in ("numpy.f2py", "numpy.testing", "scipy.sparse") if name in sys.modules))
import scipy.sparse
assert scipy.sparse.eye_array(3).toarray().sum() == 3.0
np.testing.assert_array_equal([1], [1])
assert np.f2py.__name__ == "numpy.f2py"
"""


def loaded(before):
    """Which of the modules a process has that loads sparse matrices after these lines."""
    script = SCRIPT.format(before=before)
    return subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()


def test_parts_of_numpy_that_nobody_asked_for_are_not_loaded():
    assert loaded("") == ["scipy.sparse"]


def test_parts_that_were_loaded_stay():
    assert loaded("np.testing, np.f2py") == ["numpy.f2py", "numpy.testing", "scipy.sparse"]
