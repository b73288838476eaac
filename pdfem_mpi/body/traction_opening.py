"""What a crack through bonds that soften transmits over its opening, and the branch that fits a measured curve.

A plane cuts bonds of all lengths and directions. Where it opens by ``w``, a bond of length ``r`` at the cosine ``m`` to
its normal is stretched by ``w m / r``, and pulls with ``f`` of that along its axis::

    tau(w)  ~  int_0^rc r^3 exp(-(r/l)^2) int_0^1 f(w m / r) m^2 dm dr,        int_0^inf tau dw = G_c

The curve hangs on strength, energy and shape of the branch, and hardly on ``l`` where the final stretch is far above
the first.
"""

from __future__ import annotations

import functools
import math

import numpy as np
from scipy.optimize import least_squares

from pdfem_mpi.body.quadrature import gauss_legendre
from pdfem_mpi.body.softening_law import Shape
from pdfem_mpi.deck.softening import DROP

#: Points of the quadratures over lengths and directions, and openings at which curves are compared.
LENGTHS, DIRECTIONS, OPENINGS = 60, 60, 80
#: Range of the branch's kink in a fit: fraction of the final stretch, and force.
KINKS = ((0.05, 0.9), (0.01, DROP - 0.01))
START = (0.25, 0.15)
#: Digits to which a fit is rounded, so that the last bits of a processor do not decide.
DIGITS = 3


def transmitted(shape: Shape, ratio: float, first: float, energy: float, length: float, cutoff_ratio: float, opening):
    """``tau`` at openings, dimension force / length^2.

    Parameters
    ----------
    shape, ratio : Shape, float
        The branch, and its final over its first stretch.
    first : float
        The first stretch.
    energy : float, dimension force / length
        Under the curve.
    length, cutoff_ratio : float
        Internal length, and the cutoff radius over it.
    opening : float64, shape (n,), dimension length
    """
    branch = shape.branch(ratio)
    r, wr = _gauss(LENGTHS, cutoff_ratio)
    m, wm = _gauss(DIRECTIONS, 1.0)
    stretch = np.asarray(opening)[:, None, None] / length * m / r[:, None] / first
    force = np.where(stretch < 1.0, stretch, np.interp(stretch, branch.stretch, branch.force, right=0.0))
    decay = np.array([math.exp(-length * length) for length in r])
    weights = (wr * (r * r * r) * decay)[:, None] * (wm * m**2)
    # the integral over all openings: m / r dw = ds
    whole = 0.5 * first * branch.energy * float((wr * (r * r) * (r * r) * decay).sum()) * float((wm * m).sum())
    return (force * weights).sum(axis=(1, 2)) * energy / (whole * length)


def fit_curve(curve, modulus: float, unit_energy: float, length: float, cutoff_ratio: float) -> Shape:
    """The kink of the branch that fits a traction-opening curve best, by least squares; the drop is to 1/2.

    Parameters
    ----------
    curve : pairs of floats
        Opening and traction.
    modulus : float, dimension force / length^2
        Young's.
    unit_energy : float, dimension force / length
        Fracture energy of bonds that break at stretch 1.
    length, cutoff_ratio : float
    """
    return Shape(DROP, _fit(tuple(curve), modulus, unit_energy, length, cutoff_ratio))


@functools.cache
def _fit(curve, modulus, unit_energy, length, cutoff_ratio) -> tuple[float, float]:
    opening, traction = np.array(curve).T
    energy, first = curve_energy(curve), traction[0] / modulus
    places = (np.arange(OPENINGS) + 0.5) / OPENINGS * opening[-1] * 1.25
    wanted = np.interp(places, opening, traction, right=0.0)

    def misfit(kink):
        shape = Shape(DROP, (float(kink[0]), float(kink[1])))
        ratio = shape.ratio(energy / (unit_energy * first**2))
        if ratio * kink[0] <= 1.0:
            return np.full(OPENINGS, 1.0)
        return (transmitted(shape, ratio, first, energy, length, cutoff_ratio, places) - wanted) / traction[0]

    found = least_squares(misfit, START, bounds=tuple(zip(*KINKS, strict=True)), diff_step=1e-3)
    return tuple(float(f"{value:.{DIGITS}g}") for value in found.x)


def curve_energy(curve) -> float:
    """The area under a curve of pairs of opening and traction."""
    opening, traction = np.array(curve).T
    return float(np.trapezoid(traction, opening))


def _gauss(n: int, end: float) -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = gauss_legendre(n)
    return 0.5 * end * (nodes + 1.0), 0.5 * end * weights
