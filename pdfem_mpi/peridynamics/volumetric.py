"""The volumetric part of bonds: what Poisson's ratio asks for that bonds alone do not have, where it is not 1/4.

Bonds with the response (2) are an isotropic solid with equal constants of Lame. Let them have the material's ``mu``,
and add at every point what ``lambda`` lacks (the linear peridynamic solid of Silling et al. 2007, with the response of
the paper as its influence function)::

    U = 1/2 sum_bonds k_ij e_ij^2 / r_ij + 1/2 sum_i M_i w_i theta_i^2,      M = lambda - mu
    w_i theta_i = sum_j A_ij e_ij,                                         A_ij = k_ij / (10 mu_i)
    T_ij = k_ij e_ij / r_ij + A_ij M_i theta_i + A_ji M_j theta_j

with ``e_ij`` the extension of a bond and ``k_ij = c exp(-r^2) g_ij w_i w_j``, ``c = 15 mu_ij / pi``. ``theta`` is the
dilatation of every uniform strain in the bulk.

* A bond stores nothing more: ``A`` comes from the number it has.
* Between its two sweeps a point sends one number, ``q = M theta / (10 mu)`` (`volumetric_forces`).
* The energy is a sum over bonds and one over points; forces act along bonds, in pairs; the tangent is symmetric.
* A body is stable if ``M_i n_i > -1/2`` at every point, ``n_i = sum_j k_ij r_ij / (10 mu_i)^2 / w_i``: by Cauchy and
  Schwarz ``(w theta)^2 <= w n sum_j k e^2 / r``, and half of each bond is a point's. For one material this says
  ``m_i < (5 mu / 3) / |M|`` with ``m_i = sum_j k_ij r_ij / (30 mu w_i)``, 1 in the bulk; corrections raise it at
  surfaces. Bonds that break only lower it.

At 1/4 ``M`` is 0, and there is no such part.

References
----------
Silling, Epton, Weckner, Xu & Askari, Peridynamic states and constitutive modeling, J. Elasticity 88, 2007.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.materials import MaterialTable
from pdfem_mpi.deck.materials import BOND_POISSONS_RATIO, DEFAULT_MATERIAL, NEARLY_INCOMPRESSIBLE
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.bond_densities import add_family_sums
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.peridynamics.images import MAGNITUDES, SCALAR, halo_for
from pdfem_mpi.peridynamics.points import Points, sums_table

if TYPE_CHECKING:
    from pdfem_mpi.peridynamics.bonds import Bonds

#: Shear modulus of bonds per their `MaterialTable.bond_modulus`, which is Young's at a Poisson's ratio of 1/4.
SHEAR = 0.4


@dataclass(frozen=True)
class Moment:
    """How near a material's points come to what is stable.

    Attributes
    ----------
    material : str
    poissons_ratio : float
    largest : float
        Largest ``m_i`` of its points; 1 in the bulk.
    limit : float
        What it must stay below; infinity for a Poisson's ratio of 1/4 and above.
    """

    material: str
    poissons_ratio: float
    largest: float
    limit: float


@dataclass(frozen=True)
class Volumetric:
    """Constants of the volumetric part, in model units.

    Attributes
    ----------
    modulus : float64, shape (n_materials,), dimension stress
        ``M = lambda - mu``.
    shear : float64, shape (n_materials,), dimension stress
    factor : float64, shape (n_materials,), dimension 1 / stress
        ``M / (10 mu)^2``: a point counts all of its bonds by its own modulus.
    material : int16, shape (n_clusters,)
        Of the points of each local cluster.
    moments : tuple of Moment
        How near the points come to what is stable, by material; empty with fitted weights.
    weights : float32 arrays, shapes ((n_rows + 1) * 8,)
        Fitted weights of the bonds' slots (`fit.dilatation`) of interior and boundary rows; empty where all are 1.
    largest_weight : float
        Magnitude, on all ranks.
    """

    modulus: np.ndarray
    shear: np.ndarray
    factor: np.ndarray
    material: np.ndarray
    moments: tuple[Moment, ...] = ()
    weights: tuple[np.ndarray, np.ndarray] = (np.empty(0, np.float32), np.empty(0, np.float32))
    largest_weight: float = 1.0

    @property
    def is_weighted(self) -> bool:
        """Whether bonds have fitted weights."""
        return self.weights[0].size > 0

    def dilatation(self, q: np.ndarray) -> np.ndarray:
        """``theta`` of the first clusters by their ``q``, shapes (n, 4); 0 where ``M`` is."""
        modulus = self.modulus
        inverse = np.divide(10.0 * self.shear, modulus, out=np.zeros_like(modulus), where=modulus != 0.0)
        return q * inverse[self.material[: len(q)], None]


def volumetric_part(comm, points: Points, materials: MaterialTable) -> Volumetric | None:
    """The volumetric part of the bonds between points of these materials; None where no ratio needs one. Collective."""
    used = np.zeros(len(materials.names))
    used[points.material] = 1.0
    used = largest(comm, used) > 0.0
    nu = materials.poissons_ratio
    if not (used & (nu != BOND_POISSONS_RATIO)).any():
        return None
    shear = SHEAR * materials.bond_modulus
    own = np.diag(shear)
    modulus = np.where(used, own * (4.0 * nu - 1.0) / (1.0 - 2.0 * nu), 0.0)
    return Volumetric(
        modulus=modulus,
        shear=np.ascontiguousarray(own),
        factor=modulus / (10.0 * own) ** 2,
        material=np.repeat(points.material, 2),
    )


def with_moments(comm, points: Points, bonds: Bonds, materials: MaterialTable) -> Bonds:
    """The same bonds, whole as they are before cracks, whose volumetric part knows its `Moment`. Collective.

    Raises
    ------
    SceneError
        Some point's energy might be negative.
    """
    part = bonds.volumetric
    if part is None or part.is_weighted:
        return bonds
    moments = _largest_moments(comm, points, bonds, materials)
    refuse_unstable(moments)
    return replace(bonds, volumetric=replace(part, moments=moments))


def _largest_moments(comm, points: Points, bonds: Bonds, materials: MaterialTable) -> tuple[Moment, ...]:
    """How near each material with a volumetric part comes to what is stable. Collective."""
    part = bonds.volumetric
    moments = _family_sums(points, bonds)[:, 1] / (30.0 * part.shear[part.material[: 2 * points.n_owned], None])
    top = np.zeros(len(materials.names))
    np.maximum.at(top, part.material[: 2 * points.n_owned], moments.max(axis=1))
    return tuple(
        Moment(name, float(nu), float(m), float(5.0 / 3.0 * mu / -modulus) if modulus < 0.0 else math.inf)
        for name, nu, m, mu, modulus in zip(
            materials.names, materials.poissons_ratio, largest(comm, top), part.shear, part.modulus, strict=True
        )
        if modulus != 0.0
    )


def refuse_unstable(moments: tuple[Moment, ...]) -> None:
    """Refuse a Poisson's ratio below 1/4 with which some point's energy might be negative.

    Raises
    ------
    SceneError
    """
    messages = [
        f"{_key(moment.material)}.poissons_ratio = {moment.poissons_ratio:g} is too low for these bonds: the moment "
        f"m = sum k r / (30 mu w) of some point is {moment.largest:.3g}, and the body is stable below "
        f"{moment.limit:.3g}. Use cells of more even shape or two and more across the body, "
        'peridynamics.surface_correction = "none", or a Poisson\'s ratio nearer to 0.25.'
        for moment in moments
        if moment.largest >= moment.limit
    ]
    if messages:
        raise SceneError(messages)


def describe_moments(moments: tuple[Moment, ...]) -> list[str]:
    """What a run says of its volumetric part."""
    return [
        f"{_key(moment.material)}.poissons_ratio = {moment.poissons_ratio:g}: bonds and a volumetric part; largest "
        f"moment of a point {moment.largest:.3g}"
        + (f", stable below {moment.limit:.3g}" if moment.limit < math.inf else ", stable whatever it is")
        for moment in moments
    ] + [
        f"warning: {_key(moment.material)}.poissons_ratio = {moment.poissons_ratio:g} is above "
        f"{NEARLY_INCOMPRESSIBLE:g}: solves take several times as long, and displacements are less exact. Use a "
        "lower one where it serves."
        for moment in moments
        if moment.poissons_ratio > NEARLY_INCOMPRESSIBLE
    ]


def _key(name: str) -> str:
    return "material" if name == DEFAULT_MATERIAL else f"materials.{name}"


def stiffening(comm, points: Points, bonds: Bonds) -> tuple[np.ndarray, float]:
    """``h_i`` of all local points, by which the volumetric part stiffens bonds at most, and the largest. Collective.

    By Cauchy and Schwarz ``(sum_j A e)^2 <= S_i sum_j A e^2`` with ``S_i = sum_j A_ij``: for ``M > 0`` the energy is
    at most that of bonds whose stiffness ``k / r`` has grown by the factor ``1 + r (h_i + h_j)``,
    ``h = M S / (10 mu w)``, times the square of the largest weight. Where ``M < 0`` the part softens.

    Returns
    -------
    h : float64, shape (n_clusters * 4,)
        Empty without a volumetric part.
    largest : float
        Of ``r (h_i + h_j)``, on all ranks.
    """
    part = bonds.volumetric
    if part is None:
        return np.empty(0), 0.0
    h = np.zeros((points.n_clusters, W))
    owned = part.material[: 2 * points.n_owned]
    h[: len(owned)] = _family_sums(points, bonds)[:, 0] * np.maximum(part.factor, 0.0)[owned, None]
    h *= part.largest_weight**2
    halo_for(points.halo, SCALAR).scatter_forward(h.reshape(-1, 2, 1, W))
    top = float(largest(comm, np.array([h.max(initial=0.0)]))[0])
    return h.reshape(-1), 2.0 * part.largest_weight * bonds.cutoff * top


def _family_sums(points: Points, bonds: Bonds) -> np.ndarray:
    """``sum_j k_ij / w_i`` and ``sum_j k_ij r_ij / w_i`` of the owned points. Collective.

    Of bonds of negative stiffness the magnitudes count. Shape (n_owned_clusters, 2, 4).
    """
    part = bonds.volumetric
    T, _ = sums_table(points)
    widest = part.largest_weight
    bound = bonds.strongest * max(widest, widest**2 * bonds.cutoff)
    sums, quantum, _ = bonds.sum_over(add_family_sums, T, bound, points, MAGNITUDES)
    volume = points.volume.reshape(-1, 1, W)[: 2 * points.n_owned]
    return sums[:, :2] * quantum / volume
