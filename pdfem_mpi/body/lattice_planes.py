"""What the bonds across a plane of the cells' lattice take, beside what the integral over a continuum of bonds says.

Points stand in a lattice of Gauss points, of which a plane normal to an axis cuts fewer bonds within a cell than
between two cells, and in the mean fewer than the integral has. Of cubes without ends, whose corrected bonds have the
material's stiffness, the mean over all places of such a plane is a sum over the bonds of one point: with the energy
``e = c exp(-(r / l)^2) w w r / 2`` of a bond at unit stretch, ``G = sum e |xi_x|`` over the bonds of a unit of volume.
"""

from __future__ import annotations

import functools
import math

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.materials import BOND_POISSONS_RATIO, Material
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.correction_sweeps import INFINITE_RESPONSE
from pdfem_mpi.kernels.families import CUTOFF_GUARD

#: Digits of a cell's edge and of what planes take: the last ones of lengths hang on the deck's units.
DIGITS = 6
#: From so many cells in an internal length on the lattice is taken as dense as there: to 1e-4.
DENSE = 6.0
#: Half the edge of a cell is so many times the way of its points from its middle.
GAUSS = math.sqrt(3.0)


def bond_sizes(scene: Scene, share: Share) -> tuple[float, float, float]:
    """Internal length, cutoff radius over it, and `energy_of_planes`: what laws of bonds hang on in a body."""
    return share.units.length, share.cutoff / (1.0 + CUTOFF_GUARD), energy_of_planes(scene, share)


def energy_of_planes(scene: Scene, share: Share) -> float:
    """Fracture energy of planes normal to an axis of the body's lattice, over that of the formula for the bulk.

    By the median edge of the cells whose bonds can soften, taken as cubes: 0.956 with internal lengths of one cell and
    "virial", 0.995 with 1.5 cells. 1 where no bonds soften, and nobody asks.

    Raises
    ------
    SceneError
        These cells are so long that no bonds hold the points of one together.
    """
    if share.softening_cells is None:
        return 1.0
    edge, cutoff = share.softening_cells.edge, share.cutoff / (1.0 + CUTOFF_GUARD)
    cells = float(f"{1.0 / edge:.{DIGITS}g}")
    energy = lattice_energy(cells, cutoff, scene.peridynamics.surface_correction)
    if share.cutoff * GAUSS < edge or not energy > 0.0:
        length = share.units.length
        raise SceneError([
            f"peridynamics.internal_length = {length:.6g} is too small for cells of edge {edge * length:.6g} whose "
            f"bonds may soften: within the cutoff radius of {cutoff * length:.6g} no bonds hold such a cell together. "
            f"Use finer cells there, or an internal length from {0.5 * edge * length:.6g} to {edge * length:.6g}."
        ])  # fmt: skip
    return energy


@functools.lru_cache(maxsize=64)
def lattice_energy(cells: float, cutoff_ratio: float, correction: str) -> float:
    """The same of any lattice.

    Parameters
    ----------
    cells : float
        Cells in an internal length.
    cutoff_ratio : float
        ``r_c / l``.
    correction : str
        ``peridynamics.surface_correction``: fitted factors have the stiffness of "virial".

    Returns
    -------
    float
        0 where points have no bonds, or none whose weight is a number above 0.
    """
    length = min(cells, DENSE)
    x, r, weight = _bonds_of_a_point(length, cutoff_ratio)
    # c w w of Young's modulus 1: c = 9 k / (pi l^4), and a point has an eighth of a cell
    weight *= 6.0 / (math.pi * length**4) / 64.0
    if not weight.any():
        return 0.0
    energy = 4.0 * float((0.5 * weight * r * x).sum())
    bulk = Material(youngs_modulus=1.0).energy_of_bonds(length, cutoff_ratio)
    cosine = x / r
    per_stretch = weight * ((1.0 + BOND_POISSONS_RATIO) * cosine * cosine - BOND_POISSONS_RATIO)
    factor = 1.0
    if correction == "appendix_a":
        factor = INFINITE_RESPONSE * 2.0 / 3.0 / length / (8.0 * float((per_stretch * cosine).sum()))
    elif correction != "none":
        factor = 1.0 / (4.0 * float((per_stretch * r * cosine * cosine).sum()))
    return float(f"{factor * energy / bulk:.{DIGITS}g}")


def _bonds_of_a_point(length: float, cutoff_ratio: float) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Ways along x, lengths, ``exp(-(r / l)^2)`` of the bonds of one point; cells of edge 1; float64, shape (n,)."""
    radius = cutoff_ratio * length * (1.0 + CUTOFF_GUARD)
    reach = math.ceil(radius) + 1
    ways = [float(k) + part for k in range(-reach, reach + 1) for part in (0.0, 1.0 / GAUSS)]
    along = np.array(ways)
    bell = np.array([math.exp(-((way / length) ** 2)) for way in ways])
    square = along * along
    r2 = square[:, None, None] + square[:, None] + square
    near = (r2 > 0.0) & (r2 <= radius * radius)
    weight = (bell[:, None, None] * bell[:, None] * bell)[near]
    x = np.broadcast_to(np.abs(along)[:, None, None], r2.shape)[near]
    return x, np.sqrt(r2[near]), weight
