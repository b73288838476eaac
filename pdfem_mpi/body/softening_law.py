"""The law of a bond that softens, and the teeth in which it loses its stiffness.

A bond is intact up to the stretch ``s_t``. There its force falls to a part of itself, and from there it follows a
branch of straight lines to 0 at ``s_c = R s_t``. Unloading and reloading go along the secant, so that a body is linear
while no bond goes on, and stretches and forces are in units of those at ``s_t`` here.

**Teeth** (sequentially linear analysis). The branch is followed through points ``e_k``, whose stretches rise by one
ratio. A bond at point k has the secant's stiffness ``phi_k = f(e_k) / e_k`` and goes on to the next where its stretch
passes ``sqrt(e_k e_k+1)``: the teeth straddle the branch, and the area under them is that under the branch.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.quadrature import gauss_legendre, in_steps

#: Bonds within a cone, by the cosine to its axis: of the response of a uniform body.
DIRECTIONS = 200
#: Strains, in units of s_t, among which the strength of a body is sought, and their number. With a drop it is reached
#: at once; without, hardening ends within a tenth of the final stretch.
LEAST_STRAIN, MOST_STRAIN, STRAINS = 0.99, 12.0, 240
#: Force after a drop up to which a body is as strong as its bonds whatever follows, to a hundredth.
MOST_DROP = 0.53
#: Halvings of the bracket of the lateral contraction: to 4e-6 of the strain.
HALVINGS = 20


@dataclass(frozen=True)
class Branch:
    """What a bond follows once it softens.

    Attributes
    ----------
    stretch : float64, shape (n,)
        From 1 to ``R``, in units of ``s_t``.
    force : float64, shape (n,)
        From the force after the drop to 0, in units of that at ``s_t``.
    """

    stretch: np.ndarray
    force: np.ndarray

    @property
    def ratio(self) -> float:
        """``R = s_c / s_t``."""
        return float(self.stretch[-1])

    @property
    def energy(self) -> float:
        """Energy to break a bond, over that of one that breaks at ``s_t``."""
        return 1.0 + 2.0 * float(np.trapezoid(self.force, self.stretch))


@dataclass(frozen=True)
class Teeth:
    """Stretches at which a bond goes on, and what is left of its stiffness from there.

    Attributes
    ----------
    limit : float64, shape (T,)
        Rising, from ``s_t``; dimension 1.
    stiffness : float64, shape (T + 1,)
        Of the intact one, from 1 to 0.
    """

    limit: np.ndarray
    stiffness: np.ndarray

    @property
    def energy(self) -> float:
        """Energy to break a bond, over that of the intact bond at stretch 1."""
        return float((-np.diff(self.stiffness) * self.limit**2).sum())


@dataclass(frozen=True)
class Shape:
    """The shape of a branch, whatever its length.

    Attributes
    ----------
    drop : float
        Force after the drop, 1 without one.
    kink : (float, float) or None
        Stretch over the final one, and force.
    """

    drop: float
    kink: tuple[float, float] | None = None

    def branch(self, ratio: float) -> Branch:
        """The branch that ends at ``ratio`` times the stretch at which it begins."""
        if self.kink is None:
            return Branch(np.array([1.0, ratio]), np.array([self.drop, 0.0]))
        at, force = self.kink
        return Branch(np.array([1.0, at * ratio, ratio]), np.array([self.drop, force, 0.0]))

    def ratio(self, energy: float) -> float:
        """The final over the first stretch that gives bonds this energy; below 1 or before the kink there is none.

        Parameters
        ----------
        energy : float
            As `Branch.energy`.
        """
        if self.kink is None:
            return 1.0 + (energy - 1.0) / self.drop
        at, force = self.kink
        # energy = 1 + (drop + force)(at R - 1) + force (1 - at) R
        return (energy - 1.0 + self.drop + force) / ((self.drop + force) * at + force * (1.0 - at))

    def raised(self, factor: float) -> Shape:
        """The shape with forces after the drop so many times as large, up to a drop to `MOST_DROP`; a line as it is."""
        if self.drop == 1.0:
            return self
        factor = min(factor, MOST_DROP / self.drop)
        return Shape(self.drop * factor, None if self.kink is None else (self.kink[0], self.kink[1] * factor))

    @property
    def least_energy(self) -> float:
        """The energy below which no bond has this shape: where its branch, up to the kink, has no length."""
        if self.kink is None:
            return 1.0
        at, force = self.kink
        return 1.0 + force * (1.0 / at - 1.0)


def make_teeth(branch: Branch, tooth_ratio: float, first: float = 1.0) -> Teeth:
    """The teeth of a branch.

    Parameters
    ----------
    tooth_ratio : float
        About the ratio of stretches from one point to the next: adjusted, so that the last is ``s_c``.
    first : float
        ``s_t``, in whose place limits are stretches.
    """
    ratio = branch.ratio
    n = max(1, round(math.log(ratio) / math.log(tooth_ratio)))
    points = np.array([ratio ** (k / n) for k in range(n + 1)])
    stiffness = np.interp(points, branch.stretch, branch.force) / points
    stiffness[-1] = 0.0
    limit = np.sqrt(points[:-1] * points[1:])
    # exact where the branch is straight; one number makes it so where a kink lies between two points
    under = float(((stiffness[:-1] - stiffness[1:]) * limit**2).sum())
    limit *= math.sqrt((branch.energy - 1.0 + branch.force[0]) / under)
    if branch.force[0] < 1.0:
        limit, stiffness = np.append(1.0, limit), np.append(1.0, stiffness)
    else:  # without a drop the first tooth begins on the line through the origin
        stiffness[0] = 1.0
    return Teeth(first * limit, stiffness)


def brittle(critical_stretch: float) -> Teeth:
    """A bond that breaks at once, as one tooth."""
    return Teeth(np.array([critical_stretch]), np.array([1.0, 0.0]))


def strength_factor(teeth: Teeth, poissons_ratio: float = 0.25) -> float:
    """Strength of a uniform body under uniaxial stress, over ``E`` times the first limit of its bonds.

    Bonds in all directions, the lateral strain such that nothing acts across. Without a drop the first bonds to soften
    lie along the stress, and the others carry more than they lose. With ``<>`` the mean over all directions ``n``, and
    ``mu = 1``, the stress is ``15 <phi s n n> + 3 M theta <phi n n>`` and the dilatation ``theta = 3 <phi s>``.
    """
    lacks = (4.0 * poissons_ratio - 1.0) / (1.0 - 2.0 * poissons_ratio)
    modulus = 2.0 * (1.0 + poissons_ratio)
    nodes, weights = gauss_legendre(DIRECTIONS)
    along, weight = (0.5 * (nodes + 1.0)) ** 2, 0.5 * weights  # squares of the cosines
    limit = teeth.limit / teeth.limit[0]
    largest, most = np.zeros(DIRECTIONS), 0.0

    def response(strain, lateral):
        stretch = strain * along - lateral * (1.0 - along)
        tooth = np.searchsorted(limit, np.maximum(largest, stretch), side="right")
        left = weight * teeth.stiffness[tooth]
        force = left * stretch
        if lacks:
            force += 0.6 * lacks * float((left * stretch).sum()) * left
        return stretch, force

    for strain in in_steps(LEAST_STRAIN, MOST_STRAIN, STRAINS):
        low, high = -strain, 3.0 * strain
        for _ in range(HALVINGS):  # the more the body contracts, the less its bonds pull across
            middle = 0.5 * (low + high)
            pulls = (response(strain, middle)[1] * (1.0 - along)).sum() > 0.0
            low, high = (middle, high) if pulls else (low, middle)
        stretch, force = response(strain, 0.5 * (low + high))
        largest = np.maximum(largest, stretch)
        most = max(most, 15.0 / modulus * float((force * along).sum()))
    return most
