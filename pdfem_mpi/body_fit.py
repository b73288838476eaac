"""From a discretized body to fitted bonds: its boundary, area vectors, slack, background grid, and fits done before.

A body that is somewhere one cell thick has no positive fit, and its free one is unstable; other fits may end far from
their equations. Such bodies get the correction by the virial stress instead, and the run says why.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from pdfem_mpi import factor_cache
from pdfem_mpi.bond_factors import Fit, fit_factors, write_factors
from pdfem_mpi.bonds import Bonds, Points
from pdfem_mpi.boundary_areas import Boundary, area_vectors, find_boundary, restore_compatibility
from pdfem_mpi.discretization import Discretization
from pdfem_mpi.factor_grid import make_factor_grid
from pdfem_mpi.hex8 import gauss_positions
from pdfem_mpi.kernels.bond_factors import N
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.mesh.quality import CORNERS
from pdfem_mpi.parallel.comm import broadcast, gather_rows
from pdfem_mpi.scene import SceneError
from pdfem_mpi.subdomain import Subdomain

#: Counts up whenever the algorithm gives other numbers: fits of before are not used again.
VERSION = 3
#: Sweeps over the bonds that a fit takes on bodies of cubes, and bonds a second and core, all work between included.
EXPECTED_SWEEPS, SWEEP_RATE = {"free": 200, "bounded": 290}, 7.5e7
#: A residual above this is told, and above that a fit does not serve: a few of its factors are hundreds and more.
POOR, USELESS = 1e-6, 1e-2
#: Edges at a corner are at right angles, and neighbours equally long, within this.
SQUARE = 1e-6


@dataclass(frozen=True)
class BodyFit:
    """Outcome for a body.

    Attributes
    ----------
    fit : Fit or None
        None where the body is too thin, or the fit too far off: "virial" has to serve.
    notes : tuple of str
        What a user should know.
    reused : bool
        An earlier fit was found.
    fingerprint : str
    """

    fit: Fit | None
    notes: tuple[str, ...]
    reused: bool
    fingerprint: str


def fit_body(
    comm,
    discretization: Discretization,
    subdomain: Subdomain,
    points: Points,
    bonds: Bonds,
    signs: str,
    folders: tuple[Path, ...] = (),
) -> tuple[Bonds, BodyFit]:
    """Fit the factors of the cells with points, or take those of an earlier fit. Collective.

    Parameters
    ----------
    bonds : Bonds
        Without correction; overwritten unless the body is too thin. Of no use without a fit.
    signs : "free" or "bounded"
    folders : paths
        Where fits are looked for and left; used on rank 0.

    Raises
    ------
    SceneError
        Several materials, a boundary that is not closed, cells inside out, several pieces.
    """
    mesh, chosen = discretization.mesh, discretization.has_points
    modulus = _only_modulus(discretization)
    boundary = find_boundary(mesh, discretization.nodes, chosen)
    thin = thin_cells(boundary, len(chosen))
    key = fingerprint(discretization, signs, bonds.finite)
    if thin.any():
        where = ", ".join(f"{c:.6g}" for c in mesh.centroids[np.flatnonzero(thin)[0]])
        note = (
            f'peridynamics.surface_correction = "fitted" needs two cells of thickness; {np.count_nonzero(thin)} of '
            f'{np.count_nonzero(chosen)} cells with bonds have less, the first at ({where}). Using "virial" instead.'
        )
        return bonds, BodyFit(None, (note,), False, key)

    cells = np.concatenate([subdomain.free, subdomain.overlap])
    found = broadcast(comm, factor_cache.load(folders, key) if comm.rank == 0 else None)
    if found is not None:
        report, stored = found
        number = points.cell_number[: points.n_owned]
        multipliers = [
            np.ascontiguousarray(rows.reshape(-1, 2, W, N)[number].swapaxes(2, 3)).reshape(-1, N, W) for rows in stored
        ]
        bonds = write_factors(comm, points, bonds, multipliers, signs == "bounded")
        return bonds, _outcome(Fit(**report), True, key)

    areas, change = compatible_areas(discretization, boundary)
    slack = np.zeros((len(chosen), 8), bool)
    if signs == "bounded":
        slack[skewed_corners(discretization, boundary)] = True
    slack = slack[cells].reshape(-1)
    lower, upper = _box(discretization)
    edge = discretization.mesh.mean_edge / discretization.units.length

    def make_grid(omega):
        return make_factor_grid(comm, points, lower, upper, edge, discretization.cutoff, slack, omega, modulus)

    bonds, fit, multipliers = fit_factors(
        comm, points, bonds, areas[cells].reshape(-1, 3), slack, signs == "bounded", make_grid, change, modulus
    )
    if folders:
        number = points.cell_number[: points.n_owned]
        n_cells = discretization.n_point_cells
        rows = [np.ascontiguousarray(v.reshape(-1, 2, N, W).swapaxes(2, 3)).reshape(-1, 8, N) for v in multipliers]
        stored = [gather_rows(comm, number, part, n_cells) for part in rows]
        if comm.rank == 0:
            factor_cache.store(folders, key, asdict(fit), stored)
    return bonds, _outcome(fit, False, key)


def _outcome(fit: Fit, reused: bool, key: str) -> BodyFit:
    """What a fit is good for."""
    if not fit.residual <= USELESS:
        note = (
            f'peridynamics.surface_correction = "fitted" found no factors: after {fit.sweeps} sweeps the residual is '
            f'{fit.residual:.2g}, the largest factor {fit.largest_factor:.4g}. Using "virial" instead. More cells of '
            "thickness or more even cells help."
        )
        return BodyFit(None, (note,), reused, key)
    return BodyFit(fit, _remarks(fit), reused, key)


def _only_modulus(discretization: Discretization) -> float:
    """Young's modulus of the one material of the cells with points, model units."""
    found = np.unique(discretization.material[discretization.has_points])
    if len(found) > 1:
        names = " and ".join(discretization.materials.names[k] for k in found)
        raise SceneError(
            [
                f'peridynamics.surface_correction = "fitted" fits bodies of one material, and cells with bonds, the '
                f'overlap among them, are of {names}. Use "virial", or let interfaces lie outside of peridynamics.'
            ]
        )
    return float(discretization.materials.youngs_modulus[found[0]])


def _remarks(fit: Fit) -> tuple[str, ...]:
    remarks = []
    if fit.residual > POOR:
        remarks.append(
            f"the fit of the bond factors stops at a residual of {fit.residual:.2g}: uniform strains balance "
            'to about this. Use signs = "free", better cells, or a larger cutoff radius.'
        )
    if fit.slack_points:
        remarks.append(
            f"no positive bond factors balance {fit.slack_points} points at corners of skewed cells: they miss their "
            f"targets by up to {fit.residual_in_slack:.2g}."
        )
    return tuple(remarks)


def fingerprint(discretization: Discretization, signs: str, finite: bool) -> str:
    """Hexadecimal name of a fit: everything it depends on. Young's modulus and the unit of length are not among it."""
    mesh, chosen = discretization.mesh, discretization.has_points
    digest = hashlib.sha256(f"{VERSION} {signs} {finite} {discretization.cutoff!r}".encode())
    digest.update(f"{_only_modulus(discretization)!r}".encode())
    digest.update(np.ascontiguousarray(discretization.nodes[mesh.cells[chosen]]).tobytes())
    digest.update(np.ascontiguousarray(mesh.cells[chosen], np.int64).tobytes())
    digest.update(np.ascontiguousarray(_beside_elements(discretization)).tobytes())
    return digest.hexdigest()


def _box(discretization: Discretization) -> tuple[np.ndarray, np.ndarray]:
    nodes = discretization.nodes[np.unique(discretization.mesh.cells[discretization.has_points])]
    return nodes.min(axis=0), nodes.max(axis=0)


def _beside_elements(discretization: Discretization) -> np.ndarray:
    """Cells with points that touch a cell without: bool, shape (n_cells,)."""
    return discretization.has_points & discretization.mesh.neighbours(~discretization.has_points)


def compatible_areas(discretization: Discretization, boundary: Boundary) -> tuple[np.ndarray, float]:
    """Area vectors of all cells' points, shape (n_cells, 8, 3), model units; and the relative change they needed.

    Those beside cells without points stay: there the elements' nodal forces are the same integrals.
    """
    n_cells = len(discretization.has_points)
    areas = area_vectors(boundary, n_cells)
    cells = np.unique(boundary.cell)
    x = gauss_positions(discretization.nodes[discretization.mesh.cells[cells]]).reshape(-1, 3)
    own = areas[cells].reshape(-1, 3)
    used = (own != 0.0).any(axis=1)
    changeable = np.repeat(~_beside_elements(discretization)[cells], 8)[used]
    own[used], change = restore_compatibility(x[used], own[used], changeable)
    areas[cells] = own.reshape(-1, 8, 3)
    return areas, change


def thin_cells(boundary: Boundary, n_cells: int) -> np.ndarray:
    """Cells with two opposite faces on the boundary; bool, shape (n_cells,)."""
    count = np.zeros((n_cells, 3), np.int64)
    np.add.at(count, (boundary.cell, boundary.side // 2), 1)
    return (count == 2).any(axis=1)


def skewed_corners(discretization: Discretization, boundary: Boundary) -> np.ndarray:
    """Cells with three or more boundary faces that have cells other than right-angled ones within the cutoff radius.

    All bonds of a corner's point lie in one octant of a regular grid. Their xyz moment has to vanish, which positive
    factors can only do where points lie exactly in its planes.
    """
    mesh = discretization.mesh
    corners = np.flatnonzero(np.bincount(boundary.cell, minlength=len(mesh.cells)) >= 3)
    nodes = discretization.nodes[mesh.cells]
    edges = nodes[:, CORNERS] - nodes[:, :, None]
    length = np.sqrt((edges**2).sum(axis=-1))
    angle = np.abs((edges[:, :, 0] * edges[:, :, 1]).sum(axis=-1) / (length[:, :, 0] * length[:, :, 1]))
    for a, b in ((1, 2), (2, 0)):
        angle = np.maximum(
            angle, np.abs((edges[:, :, a] * edges[:, :, b]).sum(axis=-1) / (length[:, :, a] * length[:, :, b]))
        )
    skewed = np.flatnonzero(discretization.has_points & (angle.max(axis=1) > SQUARE))
    if not len(skewed) or not len(corners):
        return np.empty(0, np.int64)
    centres = (mesh.centroids - discretization.units.origin) / discretization.units.length
    reach = discretization.cutoff + float(length.max())
    near, _ = cKDTree(centres[skewed]).query(centres[corners], distance_upper_bound=reach)
    return corners[np.isfinite(near)]
