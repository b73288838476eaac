"""Residuals by rows of blocks, against the dense matrix."""

import numpy as np
import pytest

from pdfem_mpi.kernels.grid_rows import grid_residual

ROUND_OFF = 1e-14  # relative to the sum of all entries: blocks are single precision for both, sums are not


@pytest.mark.nojit
def test_residuals_are_those_of_the_dense_matrix():
    """Rows of none, one and several blocks; components of a node stand together."""
    rng = np.random.default_rng(0)
    n_rows, n_nodes = 4, 6
    there = rng.random((n_rows, n_nodes)) < 0.5
    there[2] = False
    table = rng.standard_normal((n_rows, n_nodes, 3, 3)).astype(np.float32) * there[..., None, None]
    row, column = np.nonzero(there)
    blocks = np.zeros((len(row), 3, 4), np.float32)
    blocks[:, :, :3] = table[row, column].swapaxes(1, 2)
    start = np.searchsorted(row, np.arange(n_rows + 1)).astype(np.int32)
    x, right, residual = rng.standard_normal(3 * n_nodes), rng.standard_normal(3 * n_rows), np.empty(3 * n_rows)
    grid_residual(start, column.astype(np.int32), blocks.reshape(-1), x, right, residual)
    dense = table.astype(float).swapaxes(1, 2).reshape(3 * n_rows, 3 * n_nodes)
    np.testing.assert_allclose(residual, right - dense @ x, rtol=0, atol=ROUND_OFF * np.abs(dense).sum())
