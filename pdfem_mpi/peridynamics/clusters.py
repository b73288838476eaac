"""Cluster layout: four points stand together as the bond kernels read them, x of the four, then y, then z."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.kernels.simd import W


def cluster_layout(rows: np.ndarray) -> np.ndarray:
    """Rows of the eight points of each cell, (n_cells, 8, 3), as a flat array ``[cluster][component][lane]``."""
    return np.ascontiguousarray(rows.reshape(-1, 2, W, 3).swapaxes(2, 3)).reshape(-1)


def point_rows(flat: np.ndarray) -> np.ndarray:
    """The inverse of `cluster_layout`: shape (n_points, 3)."""
    return np.ascontiguousarray(flat.reshape(-1, 3, W).swapaxes(1, 2)).reshape(-1, 3)


def by_component(flat: np.ndarray) -> np.ndarray:
    """A view of an array in cluster layout as ``[cluster][component][lane]``, shape (n_clusters, 3, 4)."""
    return flat.reshape(-1, 3, W)
