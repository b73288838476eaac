"""The overlap: cells whose points follow the nodes of elements."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class Overlap:
    """Overlap cells owned by this rank: ``points.n_free`` is the first; local nodes of each, shape (n, 8)."""

    connectivity: np.ndarray
