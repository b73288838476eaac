"""The units in which a rank computes."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np


@dataclass(frozen=True)
class ModelUnits:
    """One model unit of length and of stress, in the deck's units, and the deck's position of the model's origin."""

    length: float
    stress: float
    origin: np.ndarray

    @property
    def force(self) -> float:
        """One model unit of force, in the deck's."""
        return self.stress * self.length**2
