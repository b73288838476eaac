"""Making the bonds of a rank: search, strengths, surface correction, seeded noise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

from pdfem_mpi.body.materials import MaterialTable
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels import families
from pdfem_mpi.kernels.bond_failure import add_noise
from pdfem_mpi.kernels.reflections import share_own_images
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.peridynamics.bonds import RESPONSE_CONSTANT, Bonds
from pdfem_mpi.peridynamics.fit.fit import BodyFit, fit_body
from pdfem_mpi.peridynamics.gaps import with_gaps
from pdfem_mpi.peridynamics.points import Points
from pdfem_mpi.peridynamics.rows import find_bonds, within_bodies
from pdfem_mpi.peridynamics.softened import make_softened
from pdfem_mpi.peridynamics.surface_correction import appendix_a
from pdfem_mpi.peridynamics.volumetric import volumetric_part, with_moments
from pdfem_mpi.system.heap import large_arrays_together


def bonds_of_scene(
    scene: Scene, share: Share, comm, points: Points, fits: tuple[Path, ...]
) -> tuple[Bonds, float, BodyFit | None]:
    """The bonds that a deck describes, before cracks. Collective.

    Parameters
    ----------
    fits : paths
        Folders where fits of bond factors are looked for and left.

    Returns
    -------
    bonds : Bonds
    remaining : float
        See `make_bonds`; 0 where factors are fitted.
    body_fit : BodyFit or None
        Of the bond factors, where the deck asks for them.

    Raises
    ------
    SceneError
        Bond factors cannot be fitted, or bonds do not bear a material's Poisson's ratio.
    """
    settings, body_fit = scene.peridynamics, None
    fitted = settings.surface_correction == "fitted"
    points = with_gaps(share, points)
    body = comm, points, share.materials, share.cutoff, scene.kinematics == "finite"
    correction = "virial" if fitted else settings.surface_correction
    bonds, remaining = make_bonds(*body, correction)
    if fitted:
        with large_arrays_together():
            bonds, body_fit = fit_body(comm, share, points, bonds, settings.signs, fits)
        if body_fit.fit:
            remaining = 0.0
        elif not share.boundaries.thin:  # the fit that does not serve is written over them
            bonds, remaining = make_bonds(*body, correction)
    if settings.stiffness_noise:
        bonds = perturbed(points, bonds, settings.stiffness_noise, settings.seed)
    bonds = with_moments(comm, points, bonds, share.materials)
    if scene.softens:
        bonds = replace(bonds, softened=make_softened(scene, share, bonds))
    return bonds, remaining, body_fit


def make_bonds(
    comm, points: Points, materials: MaterialTable, cutoff: float, finite: bool, correction: str
) -> tuple[Bonds, float]:
    """Build the bonds of the owned points with their surface correction in them.

    Parameters
    ----------
    materials : MaterialTable
        Those that ``points.material`` counts.
    cutoff : float, dimension length
        Guarded cutoff radius.
    correction : "none", "appendix_a" or "virial"

    Returns
    -------
    bonds : Bonds
    remaining : float
        Largest ``|G / g_inf - 1|`` before the last update, of the virial stress ``|S / E - 1|``; 0 without correction.
    """
    interior, boundary = find_bonds(points, cutoff, finite)
    if points.body is not None:
        interior, boundary = (within_bodies(points, rows, finite) for rows in (interior, boundary))
    of_point = np.zeros(points.n_clusters * W, np.int64)
    at_cluster = np.zeros(points.n_clusters, np.int64)
    for rows in (interior, boundary):
        families.count_rows(rows.start, rows.offset, of_point, at_cluster)
    of_point, at_cluster = of_point.astype(np.int32), at_cluster.astype(np.int32)

    constants = RESPONSE_CONSTANT * materials.bond_modulus
    part = volumetric_part(comm, points, materials)

    def filled(factor):
        counts, strongest = np.zeros(constants.shape, np.int64), np.zeros(2)
        for rows in (interior, boundary):
            families.fill_rows(
                *rows.arrays, points.x, points.volume, factor, constants, points.material, cutoff, finite, strongest,
                counts,
            )  # fmt: skip
            if points.gaps:
                points.gaps.keep_apart(points, rows, finite, counts)
        if points.images:
            share_own_images(*boundary.arrays, points.cell_number, points.material, finite, counts)
        return Bonds(
            interior, boundary, finite, cutoff, of_point, at_cluster, counts, *largest(comm, strongest).tolist(),
            part,
        )  # fmt: skip

    bonds = filled(np.empty(0))
    if correction == "none":
        return bonds, 0.0
    factor, remaining = appendix_a(comm, points, materials, bonds, virial=correction == "virial")
    return filled(factor), remaining


def perturbed(points: Points, bonds: Bonds, amplitude: float, seed: int) -> Bonds:
    """Multiply every bond's stiffness by a factor within ``1 +- amplitude``, the same on any ranks; in place."""
    with np.errstate(over="ignore"):
        for rows in bonds.rows:
            add_noise(*rows.arrays, points.cell_number, amplitude, seed, bonds.finite)
    widest = 1.0 + amplitude
    return replace(bonds, strongest=widest * bonds.strongest, stiffest=widest * bonds.stiffest)
