"""Model units, and what a deck's numbers are in them.

Where bonds break, last digits grow: conjugate gradients and batches of breaks multiply what two runs differ by, some
five times a batch. A body would then break otherwise in other units, or far from the origin, where the deck's own
numbers are rounded otherwise. So bodies that can break are rounded to model units: places to a multiple of a power of
two, all else to `DIGITS` binary digits, both far coarser than what other units change and far finer than what anybody
means. Bodies on a lattice of whole or half internal lengths stay where they are, and mirror twins are twins.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

#: Places are multiples of this in internal lengths: the stiffness of bonds is kept in as many digits (float32).
QUANTUM = 2.0**-24
#: Or of this times the distance from the deck's origin, where that leaves fewer digits.
FAR = 2.0**-47
#: Binary digits of what is no place: displacements, loads, moduli, critical stretches.
DIGITS = 40


@dataclass(frozen=True)
class ModelUnits:
    """One model unit of length and of stress, in the deck's units, and the deck's position of the model's origin.

    Attributes
    ----------
    length, stress : float
        Dimension length, stress; in the deck's units.
    origin : float64, shape (3,), dimension length
    quantum : float, dimension 1
        What places are multiples of; 0: nothing is rounded.
    """

    length: float
    stress: float
    origin: np.ndarray
    quantum: float = 0.0

    @property
    def force(self) -> float:
        """One model unit of force, in the deck's."""
        return self.stress * self.length**2

    def places(self, x: np.ndarray) -> np.ndarray:
        """Positions of the deck, shape (..., 3), in model units."""
        found = (x - self.origin) / self.length
        return np.rint(found / self.quantum) * self.quantum if self.quantum else found

    def numbers(self, x):
        """Numbers that were brought to model units, a float or an array."""
        return _to_digits(x) if self.quantum else x


def quantum_for(lower: np.ndarray, upper: np.ndarray, length: float) -> float:
    """What places of a body that can break are multiples of.

    Parameters
    ----------
    lower, upper : float64, shape (3,), dimension length
        Corners of the body's bounding box, in the deck's units.
    length : float, dimension length
        The model unit.
    """
    farthest = float(np.abs([lower, upper]).max()) / length
    # a little more than what is needed, so that no power of two is met by bodies of whole sizes
    return max(QUANTUM, 2.0 ** math.frexp(1.1 * FAR * farthest)[1])


def _to_digits(x):
    mantissa, exponent = np.frexp(x)
    return np.ldexp(np.rint(np.ldexp(mantissa, DIGITS)), exponent - DIGITS)
