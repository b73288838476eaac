"""From discretized bodies to fitted bonds: boundaries, area vectors, slack, background grids, and fits done before.

A body that is somewhere one cell thick has no positive fit, and its free one is unstable; other fits may end far from
their equations. Such a scene gets the correction by the virial stress instead, and the run says why.
"""

from __future__ import annotations

import hashlib
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import broadcast
from pdfem_mpi.parallel.slabs import gather_rows
from pdfem_mpi.peridynamics.bonds import Bonds
from pdfem_mpi.peridynamics.fit import cache as factor_cache
from pdfem_mpi.peridynamics.fit.dilatation import DilatationFit, fit_dilatation, write_dilatation
from pdfem_mpi.peridynamics.fit.dilatation_grid import limit_of_weights
from pdfem_mpi.peridynamics.fit.equations import fit_factors, write_factors
from pdfem_mpi.peridynamics.fit.grid import MOST_ENTRIES, LocalLimit, limit_of_factors, make_factor_grid
from pdfem_mpi.peridynamics.fit.outcome import Fit
from pdfem_mpi.peridynamics.points import Points

#: Counts up whenever the algorithm gives other numbers: fits of before are not used again.
VERSION = 10
#: The same of the weights of the dilatation.
DILATATION_VERSION = 2
#: Sweeps over the bonds that a fit takes on bodies of cubes, and bonds a second and core, all work between included.
EXPECTED_SWEEPS, SWEEP_RATE = {"free": 180, "bounded": 330}, 7.5e7
#: The run warns of a residual above the first, and does not use a fit above the second: some factors are then in the
#: hundreds.
POOR, USELESS = 1e-6, 1e-2


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
    share: Share,
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
    materials, boundaries, n_bodies = share.materials, share.boundaries, share.counts.bodies
    n_cells = share.counts.point_cells
    key = boundaries.fingerprint(f"{VERSION} {signs} {bonds.finite}")
    if boundaries.thin:
        where = ", ".join(f"{c:.6g}" for c in boundaries.first_thin)
        note = (
            f'peridynamics.surface_correction = "fitted" needs two cells of thickness; {boundaries.thin} of '
            f'{n_cells} cells with bonds have less, the first at ({where}). Using "virial" '
            "instead."
        )
        return bonds, BodyFit(None, (note,), False, key, n_bodies)

    cells = np.concatenate([share.subdomain.free, share.subdomain.overlap])
    found = broadcast(comm, factor_cache.load(folders, key) if comm.rank == 0 else None)
    if found is not None:
        report, stored = found
        multipliers = _spread(share.point_row[cells], stored)
        bonds = write_factors(comm, points, bonds, materials.own_bond_modulus, multipliers, signs == "bounded")
        outcome = _outcome(Fit(**report), True, key, n_bodies)
        return _with_dilatation(comm, share, points, bonds, outcome, folders)

    areas, change, slack = boundaries.areas_and_slack(signs == "bounded")
    slack = slack[cells].reshape(-1)

    def make_grids(omega):
        return list(_make_grids(comm, share, cells, points, limit_of_factors(share.cutoff), slack, omega))

    bonds, fit, multipliers = fit_factors(
        comm, points, bonds, materials.own_bond_modulus, areas[cells].reshape(-1, 3), slack, signs == "bounded",
        make_grids, change,
    )  # fmt: skip
    if folders:
        stored = _gathered(comm, share.point_row[cells], multipliers, n_cells)
        if stored is not None:
            factor_cache.store(folders, key, asdict(fit), stored)
    return _with_dilatation(comm, share, points, bonds, _outcome(fit, False, key, n_bodies), folders)


def _with_dilatation(
    comm, share: Share, points: Points, bonds: Bonds, outcome: BodyFit, folders: tuple[Path, ...]
) -> tuple[Bonds, BodyFit]:
    """Fit the weights of the dilatation too, or take earlier ones, where there is a volumetric part. Collective.

    They depend on the factors, and are named by the fingerprint of their fit.
    """
    if bonds.volumetric is None or outcome.fit is None:
        return bonds, outcome
    cells = np.concatenate([share.subdomain.free, share.subdomain.overlap])
    number, modulus = share.point_row[cells], share.materials.own_bond_modulus
    key = hashlib.sha256(f"{outcome.fingerprint} dilatation {DILATATION_VERSION}".encode()).hexdigest()
    known = broadcast(comm, factor_cache.load(folders, key) if comm.rank == 0 else None)
    if known is not None:
        report, stored = known
        found = DilatationFit(**report)
        bonds = write_dilatation(comm, points, bonds, modulus, _spread(number, stored))
    else:
        areas, _, _ = share.boundaries.areas_and_slack(False)
        none = np.zeros(8 * len(cells), bool)
        grids = list(_make_grids(comm, share, cells, points, limit_of_weights(share.cutoff), none))
        bonds, found, multipliers = fit_dilatation(comm, points, bonds, modulus, areas[cells].reshape(-1, 3), grids)
        if folders:
            stored = _gathered(comm, number, multipliers, share.counts.point_cells)
            if stored is not None:
                factor_cache.store(folders, key, asdict(found), stored)
    notes = outcome.notes
    if found.residual > POOR:
        notes += (
            f"the fit of the dilatation stops at a residual of {found.residual:.2g} after {found.iterations} "
            "iterations: uniform strains balance to about this.",
        )
    return bonds, replace(outcome, notes=notes, dilatation=found)


def _gathered(comm, number: np.ndarray, multipliers: list[np.ndarray], n_cells: int) -> np.ndarray | None:
    """Multipliers of all points in global order, (n, n_cells, 8, m); None except on rank 0. Collective."""
    m = multipliers[0].shape[1]
    stored = np.empty((len(multipliers), n_cells, 8, m)) if comm.rank == 0 else None
    for k, v in enumerate(multipliers):
        rows = np.ascontiguousarray(v.reshape(-1, 2, m, W).swapaxes(2, 3)).reshape(-1, 8, m)
        gathered = gather_rows(comm, number, rows, n_cells)
        if stored is not None:
            stored[k] = gathered
    return stored


def _spread(number: np.ndarray, stored: list[np.ndarray]) -> list[np.ndarray]:
    """Multipliers of the owned points, shapes (n_owned_clusters, m, 4), from those of `_gathered`."""
    m = stored[0].shape[-1]
    return [np.ascontiguousarray(rows.reshape(-1, 2, W, m)[number].swapaxes(2, 3)).reshape(-1, m, W) for rows in stored]


def _make_grids(comm, share: Share, cells: np.ndarray, points: Points, limit: LocalLimit, slack, omega=0.0):
    """Each body's clusters among the owned ones, and its background grid. Collective."""
    body, n_bodies = share.body, share.counts.bodies
    edge = share.mesh.mean_edge / share.units.length
    n = 8 * points.n_owned
    x, volume, slack = points.x[: 3 * n].reshape(-1, 3 * W), points.volume[:n].reshape(-1, W), slack.reshape(-1, W)
    for number in range(n_bodies):
        clusters = slice(None) if n_bodies == 1 else np.flatnonzero(np.repeat(body[cells] == number, 2))
        own = (part[clusters].reshape(-1) for part in (x, volume))
        box = share.boundaries.boxes[number]
        yield (
            clusters,
            make_factor_grid(
                comm,
                *own,
                *box,
                edge,
                limit,
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
