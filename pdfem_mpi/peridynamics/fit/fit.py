"""From discretized bodies to fitted bonds: boundaries, area vectors, slack, background grids, and fits done before.

A body that is somewhere one cell thick has no positive fit, and its free one is unstable; other fits may end far from
their equations. Such a scene gets the correction by the virial stress instead, and the run says why.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial import cKDTree

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.body.fitted_bodies import meets_another
from pdfem_mpi.body.share import Subdomain
from pdfem_mpi.kernels.hex8 import gauss_positions, gauss_volumes
from pdfem_mpi.kernels.monomials import N
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.mesh.quality import CORNERS
from pdfem_mpi.parallel.comm import broadcast
from pdfem_mpi.parallel.slabs import gather_rows
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.fit import cache as factor_cache
from pdfem_mpi.peridynamics.fit.areas import Boundary, area_vectors, find_boundary, restore_compatibility
from pdfem_mpi.peridynamics.fit.dilatation import DilatationFit, fit_dilatation
from pdfem_mpi.peridynamics.fit.equations import fit_factors, write_factors
from pdfem_mpi.peridynamics.fit.grid import MOST_ENTRIES, make_factor_grid
from pdfem_mpi.peridynamics.fit.outcome import Fit
from pdfem_mpi.peridynamics.points import Points

#: Counts up whenever the algorithm gives other numbers: fits of before are not used again.
VERSION = 9
#: Sweeps over the bonds that a fit takes on bodies of cubes, and bonds a second and core, all work between included.
EXPECTED_SWEEPS, SWEEP_RATE = {"free": 180, "bounded": 330}, 7.5e7
#: A residual above this is told, and above that a fit does not serve: a few of its factors are hundreds and more.
POOR, USELESS = 1e-6, 1e-2
#: Free surfaces change alone while this takes at most so many times the change of all. Uniform strains of bodies
#: jittered by 10 % then err as much (1.9 times the change: .063 against .058 eps Delta) or more (4.9 times: .38
#: against .067).
DEARER = 3.0
#: Edges at a corner are at right angles, and neighbours equally long, within this.
SQUARE = 1e-6


@dataclass(frozen=True)
class BodyFit:
    """Outcome for the bodies of a scene.

    Attributes
    ----------
    fit : Fit or None
        None where a body is too thin, or the fit too far off: "virial" has to serve.
    notes : tuple of str
        What a user should know.
    reused : bool
        An earlier fit was found.
    fingerprint : str
    n_bodies : int
        Fitted each by itself.
    dilatation : DilatationFit or None
        Of the volumetric part, where there is one.
    """

    fit: Fit | None
    notes: tuple[str, ...]
    reused: bool
    fingerprint: str
    n_bodies: int
    dilatation: DilatationFit | None = None


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
        With the correction by the virial stress; overwritten unless a body is too thin. Of no use without a fit.
    signs : "free" or "bounded"
    folders : paths
        Where fits are looked for and left; used on rank 0.
    """
    mesh, materials = discretization.mesh, discretization.materials
    key = fingerprint(discretization, signs, bonds.finite, bonds.volumetric is not None)
    if len(discretization.thin):
        where = ", ".join(f"{c:.6g}" for c in mesh.centroids[discretization.thin[0]])
        note = (
            f'peridynamics.surface_correction = "fitted" needs two cells of thickness; {len(discretization.thin)} of '
            f'{discretization.n_point_cells} cells with bonds have less, the first at ({where}). Using "virial" '
            "instead."
        )
        return bonds, BodyFit(None, (note,), False, key, discretization.n_bodies)

    cells = np.concatenate([subdomain.free, subdomain.overlap])
    found = broadcast(comm, factor_cache.load(folders, key) if comm.rank == 0 else None)
    if found is not None:
        report, stored = found
        number = points.cell_number[: points.n_owned]
        multipliers = [
            np.ascontiguousarray(rows.reshape(-1, 2, W, N)[number].swapaxes(2, 3)).reshape(-1, N, W) for rows in stored
        ]
        bonds = write_factors(comm, points, bonds, materials.own_bond_modulus, multipliers, signs == "bounded")
        outcome = _outcome(Fit(**report), True, key, discretization.n_bodies)
        return _with_dilatation(comm, discretization, cells, points, bonds, outcome)

    boundary = find_boundary(mesh, discretization.nodes, discretization.body)
    areas, change = compatible_areas(discretization, boundary, bonds.volumetric is not None)
    slack = np.zeros((len(mesh.cells), 8), bool)
    if signs == "bounded":
        slack[skewed_corners(discretization, boundary)] = True
    slack = slack[cells].reshape(-1)

    def make_grids(omega):
        return list(_make_grids(comm, discretization, cells, points, slack, omega))

    bonds, fit, multipliers = fit_factors(
        comm, points, bonds, materials.own_bond_modulus, areas[cells].reshape(-1, 3), slack, signs == "bounded",
        make_grids, change,
    )  # fmt: skip
    if folders:
        stored = _gathered(comm, points.cell_number[: points.n_owned], multipliers, discretization.n_point_cells)
        if stored is not None:
            factor_cache.store(folders, key, asdict(fit), stored)
    outcome = _outcome(fit, False, key, discretization.n_bodies)
    return _with_dilatation(comm, discretization, cells, points, bonds, outcome)


def _with_dilatation(
    comm, discretization: Discretization, cells: np.ndarray, points: Points, bonds: Bonds, outcome: BodyFit
) -> tuple[Bonds, BodyFit]:
    """Fit the weights of the dilatation too, where there is a volumetric part and factors that serve. Collective."""
    if bonds.volumetric is None or outcome.fit is None:
        return bonds, outcome
    boundary = find_boundary(discretization.mesh, discretization.nodes, discretization.body)
    areas, _ = compatible_areas(discretization, boundary, True)
    modulus = discretization.materials.own_bond_modulus
    bonds, found = fit_dilatation(comm, points, bonds, modulus, areas[cells].reshape(-1, 3))
    notes = outcome.notes
    if found.residual > POOR:
        notes += (
            f"the fit of the dilatation stops at a residual of {found.residual:.2g} after {found.iterations} "
            "iterations: uniform strains balance to about this.",
        )
    return bonds, replace(outcome, notes=notes, dilatation=found)


def _gathered(comm, number: np.ndarray, multipliers: list[np.ndarray], n_cells: int) -> np.ndarray | None:
    """Multipliers of all points in global order, (n, n_cells, 8, 10); None except on rank 0. Collective."""
    stored = np.empty((len(multipliers), n_cells, 8, N)) if comm.rank == 0 else None
    for k, v in enumerate(multipliers):
        rows = np.ascontiguousarray(v.reshape(-1, 2, N, W).swapaxes(2, 3)).reshape(-1, 8, N)
        gathered = gather_rows(comm, number, rows, n_cells)
        if stored is not None:
            stored[k] = gathered
    return stored


def _make_grids(comm, discretization: Discretization, cells: np.ndarray, points: Points, slack: np.ndarray, omega):
    """Each body's clusters among the owned ones, and its background grid. Collective."""
    mesh, body, n_bodies = discretization.mesh, discretization.body, discretization.n_bodies
    edge = mesh.mean_edge / discretization.units.length
    n = 8 * points.n_owned
    x, volume, slack = points.x[: 3 * n].reshape(-1, 3 * W), points.volume[:n].reshape(-1, W), slack.reshape(-1, W)
    for number in range(n_bodies):
        nodes = discretization.nodes[np.unique(mesh.cells[body == number])]
        clusters = slice(None) if n_bodies == 1 else np.flatnonzero(np.repeat(body[cells] == number, 2))
        own = (part[clusters].reshape(-1) for part in (x, volume))
        box = nodes.min(axis=0), nodes.max(axis=0)
        yield (
            clusters,
            make_factor_grid(
                comm,
                *own,
                *box,
                edge,
                discretization.cutoff,
                slack[clusters].reshape(-1),
                omega,
                MOST_ENTRIES / n_bodies,
            ),
        )


def _outcome(fit: Fit, reused: bool, key: str, n_bodies: int) -> BodyFit:
    """What a fit is good for."""
    if not fit.residual <= USELESS:
        note = (
            f'peridynamics.surface_correction = "fitted" found no factors: after {fit.sweeps} sweeps the residual is '
            f'{fit.residual:.2g}, the largest factor {fit.largest_factor:.4g}. Using "virial" instead'
            f"{', in bodies that stay joined by their nodes' if n_bodies > 1 else ''}. More cells of thickness or more "
            "even cells help."
        )
        return BodyFit(None, (note,), reused, key, n_bodies)
    return BodyFit(fit, _remarks(fit), reused, key, n_bodies)


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


def fingerprint(discretization: Discretization, signs: str, finite: bool, volumetric: bool = False) -> str:
    """Hexadecimal name of a fit: everything it depends on. The units of stress and length are not among it."""
    mesh, chosen = discretization.mesh, discretization.has_points
    more = " volumetric" if volumetric else ""  # other area vectors
    digest = hashlib.sha256(f"{VERSION} {signs} {finite} {discretization.cutoff!r}{more}".encode())
    moduli = discretization.materials.own_bond_modulus[discretization.material[chosen]]
    digest.update(np.unique(moduli).tobytes() if discretization.n_bodies == 1 else moduli.tobytes())
    digest.update(np.ascontiguousarray(discretization.body[chosen]).tobytes())
    digest.update(np.ascontiguousarray(discretization.nodes[mesh.cells[chosen]]).tobytes())
    digest.update(np.ascontiguousarray(mesh.cells[chosen], np.int64).tobytes())
    digest.update(np.ascontiguousarray(_beside_others(discretization)).tobytes())
    return digest.hexdigest()


def _beside_others(discretization: Discretization) -> np.ndarray:
    """Cells with points that touch a cell without, or of another body: bool, shape (n_cells,)."""
    mesh, body = discretization.mesh, discretization.body
    touch = mesh.neighbours(body < 0)
    if discretization.n_bodies > 1:
        touch |= meets_another(mesh, body)
    return discretization.has_points & touch


def compatible_areas(
    discretization: Discretization, boundary: Boundary, volumetric: bool = False
) -> tuple[np.ndarray, float]:
    """Area vectors of all cells' points, shape (n_cells, 8, 3), model units; and the largest change a body needed.

    Those beside cells without points, or of another body, stay: there the nodal forces are the same integrals. Where
    too few others are left, as of a body all inside others or of a fibre's ends, they share in the change.
    """
    n_cells = len(discretization.has_points)
    areas = area_vectors(boundary, n_cells)
    beside, largest_change = _beside_others(discretization), 0.0
    for number in range(discretization.n_bodies):
        cells = np.unique(boundary.cell[discretization.body[boundary.cell] == number])
        x = gauss_positions(discretization.nodes[discretization.mesh.cells[cells]]).reshape(-1, 3)
        own = areas[cells].reshape(-1, 3)
        used = (own != 0.0).any(axis=1)
        moments = _moments(discretization, number) if volumetric else None
        changeable = np.repeat(~beside[cells], 8)[used]
        changed, change = restore_compatibility(x[used], own[used], np.ones(len(changeable), bool), moments)
        if change and changeable.any():
            of_free, more = restore_compatibility(x[used], own[used], changeable, moments)
            if more <= DEARER * change:
                changed, change = of_free, more
        own[used] = changed
        areas[cells] = own.reshape(-1, 8, 3)
        largest_change = max(largest_change, change)
    return areas, largest_change


def _moments(discretization: Discretization, number: int) -> np.ndarray:
    """Volume and first moments of the points of a body, model units; float64, shape (4,)."""
    corners = discretization.nodes[discretization.mesh.cells[discretization.body == number]]
    w, x = gauss_volumes(corners).reshape(-1), gauss_positions(corners).reshape(-1, 3)
    return np.append(w.sum(), w @ x)


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
