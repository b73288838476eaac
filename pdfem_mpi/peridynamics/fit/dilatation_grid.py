"""Coarse level of the fit of the weights of the dilatation: its operator's local limit, on the grid of `grid`.

A bond counts ``1/2 k (D_ij^2 + D_ji^2)`` with ``D_ij = [xi . P_i . xi + xi . (v_i - v_j)] / r``. For multipliers that
vary slowly, with ``n`` the direction of the bond and ``e`` the symmetric gradient::

    D_ij^2 + D_ji^2 = 2 r^2 [n . (P - e(v)) . n]^2 + 1/2 r^4 [n . (n . grad P) . n]^2

and sums over a point's bonds tend to integrals over directions: means over the unit sphere, times moments of the
response. A tensor ``P`` that is the strain of ``v`` and has no symmetric gradient takes no energy: fourteen fields and
the six rigid motions, which bodies bend by and which blocks of points alone leave.
"""

from __future__ import annotations

import math
from itertools import product

import numpy as np

from pdfem_mpi.kernels.dense import orthonormal_rows
from pdfem_mpi.kernels.dilatation_fit import N
from pdfem_mpi.peridynamics.bonds import RESPONSE_CONSTANT
from pdfem_mpi.peridynamics.fit.grid import LocalLimit

#: Components of ``P`` in their order, and the factors of their entries: shear counts twice in ``P : P``.
PAIRS = ((0, 0), (1, 1), (2, 2), (1, 2), (2, 0), (0, 1))
FACTORS = (1.0, 1.0, 1.0, math.sqrt(2.0), math.sqrt(2.0), math.sqrt(2.0))
#: Combinations of free motions weaker than this fraction of the strongest are none.
INDEPENDENT = 1e-9


def limit_of_weights(cutoff: float) -> LocalLimit:
    """That of the fit of the weights of the dilatation."""
    strength = 4.0 * math.pi * RESPONSE_CONSTANT
    fourth, sixth = strength * _moment(4, 0.0, cutoff), 0.25 * strength * _moment(6, 0.0, cutoff)
    axes = (None, 0, 1, 2)
    tables = {pair: np.zeros((N, N)) for pair in product(axes, axes)}
    for direction, weight in _directions():
        of_tensor = np.zeros(N)
        of_tensor[:6] = [f * direction[a] * direction[b] for (a, b), f in zip(PAIRS, FACTORS, strict=True)]
        misfit, change = {None: of_tensor}, {}
        for d in range(3):
            misfit[d] = np.zeros(N)
            misfit[d][6:] = -direction[d] * direction
            change[d] = direction[d] * of_tensor
        for size, forms in ((fourth, misfit), (sixth, change)):
            for (d, one), (e, two) in product(forms.items(), forms.items()):
                tables[d, e] += size * weight * one[:, None] * two
    return LocalLimit(N, tables, free_motions)


def share_of_long_bonds(nearest: float, cutoff: float) -> float:
    """What the bonds longer than ``sqrt(nearest)`` have of the energy of a ``P`` that is no strain."""
    return _moment(4, math.sqrt(nearest), cutoff) / _moment(4, 0.0, cutoff)


def free_motions(x: np.ndarray) -> np.ndarray:
    """Orthonormal rows of the multipliers without energy at some positions, shape (at most 20, 9 n).

    Vectors ``v`` that are rigid motions, linear, or quadratic with no symmetric second gradient, with ``P = e(v)``.
    """
    extent = x.max(axis=0) - x.min(axis=0)
    y = (x - x.min(axis=0) - 0.5 * extent) / (0.5 * extent.max())
    size, rows = 0.5 * extent.max(), []
    for a in range(3):
        rows.append(_field(len(y), {a: np.ones(len(y))}, {}))
        for b in range(3):
            rows.append(_field(len(y), {a: y[:, b]}, {(a, b): np.full(len(y), 1.0 / size)}))
    for a, b, c in product(range(3), repeat=3):
        # v = (y_b y_c) along a, less as much of the two that permute it: its fully symmetric part is gone
        if b <= c and not a == b == c:
            vector, gradient = {}, {}
            for one, two, three, share in ((a, b, c, 2.0), (b, c, a, -1.0), (c, a, b, -1.0)):
                vector[one] = vector.get(one, 0.0) + share * y[:, two] * y[:, three]
                for at, other in ((two, three), (three, two)):
                    gradient[one, at] = gradient.get((one, at), 0.0) + share * y[:, other] / size
            rows.append(_field(len(y), vector, gradient))
    return orthonormal_rows(np.stack(rows), INDEPENDENT)


def _field(n: int, vector: dict[int, np.ndarray], gradient: dict[tuple[int, int], np.ndarray]) -> np.ndarray:
    """One row of `free_motions` from the components of ``v`` and of its gradient, (component, along)."""
    components = np.zeros((n, N))
    for (a, b), values in gradient.items():
        for k, pair in enumerate(PAIRS):
            if {a, b} == set(pair):
                components[:, k] += FACTORS[k] * (1.0 if a == b else 0.5) * values
    for a, values in vector.items():
        components[:, 6 + a] += values
    return components.reshape(-1)


def _directions():
    """Directions and weights whose means over the unit sphere are exact for polynomials up to the seventh degree."""
    for direction in product((-1.0, 0.0, 1.0), repeat=3):
        n = sum(abs(c) for c in direction)
        if n:
            yield np.array(direction) / math.sqrt(n), {1.0: 1 / 21, 2.0: 4 / 105, 3.0: 9 / 280}[n]


def _moment(power: int, a: float, b: float) -> float:
    """``int exp(-r^2) r^power dr`` from a to b, of an even power."""
    value = 0.5 * math.sqrt(math.pi) * (math.erf(b) - math.erf(a))
    for k in range(2, power + 1, 2):
        value = 0.5 * ((k - 1) * value - b ** (k - 1) * math.exp(-b * b) + a ** (k - 1) * math.exp(-a * a))
    return value
