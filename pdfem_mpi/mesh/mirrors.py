"""Mirror planes: the reflections they make of a body, and what a body that is its own mirror image cannot do.

A deck models the part of a symmetric body on one side of its mirror planes, which are faces of the part's bounding box.
Every point then has images, one for each product of reflections. Two planes across one axis reflect each other's images
for ever: the body is repeated along that axis without end.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from itertools import product

import numpy as np


@dataclass(frozen=True)
class Mirrors:
    """Mirror planes normal to the axes.

    Attributes
    ----------
    planes : three tuples of at most two floats, dimension length
        Positions of the planes across x, y and z.
    """

    planes: tuple[tuple[float, ...], ...] = ((), (), ())

    def __bool__(self) -> bool:
        """Whether there is any plane."""
        return any(self.planes)

    @property
    def kept_motions(self) -> np.ndarray:
        """Rigid motions that leave every plane where it is: three translations, three rotations; bool, shape (6,).

        A rotation must turn each plane within itself, so its axis is normal to all of them.
        """
        across = np.array([bool(positions) for positions in self.planes])
        rotations = [not any(across[e] for e in range(3) if e != d) for d in range(3)]
        return np.concatenate([~across, rotations])

    def normal_components(self, x: np.ndarray, tolerance: float) -> np.ndarray:
        """Components of positions (n, 3) that are normal to a plane they lie on; bool, shape (n, 3)."""
        on = np.zeros(x.shape, bool)
        for d, positions in enumerate(self.planes):
            for position in positions:
                on[:, d] |= np.abs(x[:, d] - position) <= tolerance
        return on

    def reflections(self, body, target) -> tuple[np.ndarray, np.ndarray]:
        """Products of reflections ``x -> sign x + shift``, the identity left out, that bring a box to another.

        Parameters
        ----------
        body, target : float64, shape (2, 3), dimension length
            Lower and upper corner of the box that is reflected, and of the box that its image has to touch.

        Returns
        -------
        sign : float64, shape (n, 3)
        shift : float64, shape (n, 3), dimension length
        """
        along = [_along_axis(self.planes[d], *np.transpose(body)[d], *np.transpose(target)[d]) for d in range(3)]
        elements = np.array(list(product(*along))).reshape(-1, 3, 2)
        sign, shift = elements[:, :, 0], elements[:, :, 1]
        others = ~((sign == 1.0) & (shift == 0.0)).all(axis=1)
        return sign[others], shift[others]


def mirrors_at(faces: Iterable[str], lower, upper) -> Mirrors:
    """Mirror planes at faces ``x-``, ``x+``, ... ``z+`` of a box with the corners ``lower`` and ``upper``."""
    faces = set(faces)
    return Mirrors(
        tuple(
            tuple(float(corner[d]) for side, corner in (("-", lower), ("+", upper)) if f"{'xyz'[d]}{side}" in faces)
            for d in range(3)
        )
    )


def _along_axis(planes, low, high, target_low, target_high) -> list[tuple[float, float]]:
    """Signs and shifts along one axis that bring ``[low, high]`` to ``[target_low, target_high]``; identity first."""
    elements = [(1.0, 0.0)]
    if len(planes) == 1:
        elements.append((-1.0, 2.0 * planes[0]))
    elif planes:
        period = 2.0 * (planes[1] - planes[0])
        for sign, start, end, offset in ((1.0, low, high, 0.0), (-1.0, -high, -low, 2.0 * planes[0])):
            first = math.ceil((target_low - end - offset) / period)
            last = math.floor((target_high - start - offset) / period)
            elements += [(sign, offset + k * period) for k in range(first, last + 1) if sign < 0.0 or k]
    return [e for e in elements if e == (1.0, 0.0) or _touches(*e, low, high, target_low, target_high)]


def _touches(sign, shift, low, high, target_low, target_high) -> bool:
    ends = sorted((sign * low + shift, sign * high + shift))
    return ends[0] <= target_high and ends[1] >= target_low
