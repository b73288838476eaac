"""What a crack through bonds that soften transmits over its opening, and the branch that fits a measured curve.

A plane cuts bonds of all lengths and directions. Where it opens by ``w``, a bond of length ``r`` at the cosine ``m`` to
its normal is stretched by ``w m / r``, and pulls with ``f`` of that along its axis::

    tau(w)  ~  int_0^rc r^3 exp(-(r/l)^2) int_0^1 f(w m / r) m^2 dm dr,        int_0^inf tau dw = G_c

The curve hangs on strength, energy and shape of the branch, and hardly on ``l`` where the final stretch is far above
the first.

Where Poisson's ratio is not 1/4 points beside the plane have a dilatation besides. At the height z over it, in internal
lengths, ``theta = 3 s_t int int_(r m > z) r^3 exp(-r^2) f dm dr``, and the opening spends what it stores for given
stiffnesses::

    G = C mu l s_t^2 (2 int f ds / s_t^2) + (lambda - mu) l int 2 int_0^a theta^2 dz dw / w

The second part is a tenth of the first (at ``lambda - mu = mu``) where bonds break at once, and fades as the final
stretch grows: ``theta`` is bounded by ``s_t``, however far a crack opens.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from pdfem_mpi.body.quadrature import gauss_legendre, in_steps
from pdfem_mpi.body.softening_law import Shape
from pdfem_mpi.deck.softening import DROP

#: Points of the quadratures over lengths and directions, and openings at which curves are compared.
LENGTHS, DIRECTIONS, OPENINGS = 60, 60, 80
#: Openings between which dilatations are summed, in s_t l and s_c l, and their number: to 0.1 %.
LEAST_OPENING, MOST_OPENING, WIDTHS = 1e-3, 100.0, 160
#: Range of the branch's kink in a fit: fraction of the final stretch, and force.
KINKS = ((0.05, 0.9), (0.01, DROP - 0.01))
START = (0.25, 0.15)
#: Least stretch of the kink over the first one. Nearer it is another drop, and what lattice and dilatation take of the
#: energy then shortens the branch to nothing.
LEAST_KINK = 2.0
#: A fit begins so much later with its kink until that is not too near.
LATER = 1.1
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
    third, fourth = _moments(r, wr)
    weights = third[:, None] * (wm * m**2)
    # the integral over all openings: m / r dw = ds
    whole = 0.5 * first * branch.energy * float(fourth.sum()) * float((wm * m).sum())
    return (force * weights).sum(axis=(1, 2)) * energy / (whole * length)


def fit_curve(curve, modulus: float, unit_energy: float, length: float, cutoff_ratio: float) -> Shape:
    """The kink of the branch that fits a traction-opening curve best, by least squares, at `LEAST_KINK` or beyond; the
    drop is to 1/2.

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
    from scipy.optimize import least_squares  # 10 MiB that other decks do without

    opening, traction = np.array(curve).T
    energy, first = curve_energy(curve), traction[0] / modulus
    places = (np.arange(OPENINGS) + 0.5) / OPENINGS * opening[-1] * 1.25
    wanted = np.interp(places, opening, traction, right=0.0)

    def law(kink):
        shape = Shape(DROP, (float(kink[0]), float(kink[1])))
        return shape, shape.ratio(energy / (unit_energy * first**2))

    def misfit(kink):
        shape, ratio = law(kink)
        if ratio * kink[0] < LEAST_KINK:
            return np.full(OPENINGS, 1.0)
        return (transmitted(shape, ratio, first, energy, length, cutoff_ratio, places) - wanted) / traction[0]

    start = START
    while law(start)[1] * start[0] < LEAST_KINK and start[0] * LATER < KINKS[0][1]:
        start = start[0] * LATER, start[1]
    found = least_squares(misfit, start, bounds=tuple(zip(*KINKS, strict=True)), diff_step=1e-3)
    return tuple(float(f"{value:.{DIGITS}g}") for value in found.x)


@functools.lru_cache(maxsize=256)
def dilatation_energy(shape: Shape, ratio: float, cutoff_ratio: float) -> float:
    """Fracture energy of the dilatation beside a crack that opens, over ``(lambda - mu) l s_t^2 C``, where ``C mu l``
    is that of bonds that break at stretch 1.
    """
    branch = shape.branch(ratio)
    r, wr = _gauss(LENGTHS, cutoff_ratio)
    m, wm = _gauss(DIRECTIONS, 1.0)
    third, fourth = _moments(r, wr)
    weights = (third[:, None] * wm).reshape(-1)
    height, per_opening = (r[:, None] * m).reshape(-1), (m / r[:, None]).reshape(-1)
    downwards = np.argsort(-height, kind="stable")
    depth = -np.diff(np.append(height[downwards], 0.0))
    opening = np.array(in_steps(LEAST_OPENING, MOST_OPENING * ratio, WIDTHS))
    stored = np.empty(WIDTHS)
    for k, width in enumerate(opening):
        s = width * per_opening
        force = np.where(s < 1.0, s, np.interp(s, branch.stretch, branch.force, right=0.0))
        theta = 3.0 * np.cumsum((weights * force)[downwards])
        stored[k] = (theta * theta * depth).sum()
    whole = 15.0 * float(fourth.sum()) * float((wm * m).sum())
    return float(2.0 * np.trapezoid(stored, [math.log(width) for width in opening])) / whole


def curve_energy(curve) -> float:
    """The area under a curve of pairs of opening and traction."""
    opening, traction = np.array(curve).T
    return float(np.trapezoid(traction, opening))


def _moments(r: np.ndarray, weight: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of a quadrature over lengths, times ``r^3 exp(-r^2)`` and ``r^4 exp(-r^2)``."""
    third = weight * (r * r * r) * np.array([math.exp(-length * length) for length in r])
    return third, third * r


def _gauss(n: int, end: float) -> tuple[np.ndarray, np.ndarray]:
    nodes, weights = gauss_legendre(n)
    return 0.5 * end * (nodes + 1.0), 0.5 * end * weights
