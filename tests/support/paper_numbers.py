"""What docs/paper.md tells of small bodies: single bonds, lattice constants, release rates, damage, patch tests.

Everything is numbers and lists of them, which reports of tests can hold. The coarse form keeps to smaller bodies.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from pdfem_mpi.kernels import correction_sweeps
from pdfem_mpi.peridynamics.bonds import BULK_MODULUS
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.surface_correction import appendix_a
from support.bodies import bond_list, build, make_scene
from support.measure import (
    POWER_ITERATIONS,
    cracked_block,
    damage_by_layer,
    largest_eigenvalue,
    lattice_constants,
    lattice_of,
    release_rate_inside,
    single_bond,
    stored_responses,
)
from support.patch import BLOCKS, STRAINS, block, patch_test

KEPT = 0.971457  # of the fracture energy by r_c = 2.5 l
CRITICAL_STRETCH = 0.0025
SWEEPS = (1, 2, 3, 4, 5, 6, 8, 10, 11, 12, 15, 18, 21, 25, 31)  # a sweep tells what was left before it
FEW_SWEEPS = (1, 6, 11, 21)
SMALL_COUPLED = ((8, 6, 6), 4)
FEW_POWER_ITERATIONS = 10


def paper_numbers(full: bool) -> dict[str, Any]:
    """All of them."""
    return _bonds() | _lattices(full) | _stability(full) | _patch_tests(full) | _appendix_a(full)


def _bonds() -> dict[str, Any]:
    """Figs 2 to 5: stored bonds of several internal lengths, and one bond that is pulled."""
    stored, error = [], 0.0
    for length in (0.5, 1.0, 1.5, 2.0):
        scene = make_scene((4, 4, 4), correction="none")
        peridynamics = scene.peridynamics.model_copy(update={"internal_length": length, "cutoff_radius": 2.5 * length})
        body = build(scene.model_copy(update={"peridynamics": peridynamics}), loaded=False)
        r, response = stored_responses(bond_list(body), body.model.points.volume, length)
        exact = 9.0 / (math.pi * length**4) * np.exp(-((r / length) ** 2))
        error = max(error, float(np.abs(response / exact - 1.0).max()))
        shown = np.unique(r.round(6), return_index=True)[1]
        stored.append((length, r[shown].tolist(), response[shown].tolist()))
    body = build(make_scene((1, 1, 1), correction="none", kinematics="finite"), loaded=False)
    stretch = np.linspace(0.0, 1.25 * CRITICAL_STRETCH, 26)
    force = single_bond(body, bond_list(body), stretch)
    slope = force[-1] / stretch[-1]
    return {
        "stored_responses": stored,
        "locality_error": error,
        "critical_stretch": CRITICAL_STRETCH,
        "bond_stretch": stretch.tolist(),
        "bond_force": (force / (slope * CRITICAL_STRETCH)).tolist(),
        "bond_law_error": float(np.abs(force - slope * stretch).max() / force.max()),
    }


def _lattices(full: bool) -> dict[str, Any]:
    """Fracture energy, elastic constants of the lattice, damage beside a crack."""
    constant = 27.0 * math.sqrt(math.pi) / 16.0
    release = [release_rate_inside(length) / (constant * KEPT * BULK_MODULUS) for length in (1.0, 1.5)]
    n = 12 if full else 8  # appendix A's factors are those of an infinite body from about 12 cells on
    lattice = {
        kind: lattice_constants(build(make_scene((n, n, n), correction=kind), loaded=False))
        for kind in ("none", "appendix_a")
    }
    layers = [float(layer.mean()) for layer in damage_by_layer(cracked_block())]
    return {
        "fracture_constant": constant,
        "fracture_cutoff": constant * KEPT,
        "release_one": float(release[0]),
        "release_more": float(release[1]),
        "lattice_none": float(lattice["none"][0]),
        "lattice_a": float(lattice["appendix_a"][0]),
        "lattice_nu": float(lattice["appendix_a"][1]),
        "lattice_short": ", ".join(
            "E/E0 = {:.2f}, nu = {:.3f} at l = {:g} Delta".format(*lattice_of(length), length)
            for length in (0.75, 0.5, 0.4, 0.3)
        ),
        "damage_first": layers[0],
        "damage_second": layers[1],
        "damage_third": layers[2],
    }


def _stability(full: bool) -> dict[str, Any]:
    """Largest eigenvalues with the densities (11) as they are used, and as they are printed."""
    size, steps = ((8, 8, 8), POWER_ITERATIONS) if full else ((4, 4, 4), FEW_POWER_ITERATIONS)
    corrected, plain = (build(make_scene(size, correction=kind)) for kind in ("appendix_a", "none"))
    return {
        "eigenvalue": float(largest_eigenvalue(corrected, steps=steps)),
        "eigenvalue_printed": float(largest_eigenvalue(corrected, plain.model.mass, steps)),
    }


def _patch_tests(full: bool) -> dict[str, Any]:
    """Errors of each block under six strains: displacements, forces."""
    names = list(BLOCKS)
    chosen = names if full else [names[0], *(name for name in names if name.startswith("coupled"))]
    patch = {}
    for name in chosen:
        body = block(name, None if full or not name.startswith("coupled") else SMALL_COUPLED)
        patch[name] = [(error.displacement, error.force) for error in (patch_test(body, strain) for strain in STRAINS)]
    return {
        "patch_strains": list(STRAINS),
        "patch": patch,
        "patch_fe": max(force for _, force in patch[names[0]]),
        "patch_a": max(moved for moved, _ in patch["coupled, reading A"]),
        "patch_b": max(moved for moved, _ in patch["coupled, reading B"]),
    }


def _appendix_a(full: bool) -> dict[str, Any]:
    """The surface correction of a block, sweep by sweep."""
    n = 12 if full else 6
    body = build(make_scene((n, n, n), correction="none"), loaded=False)
    usual = correction_sweeps.SWEEPS
    left_over, vectors = {}, {}
    try:
        for sweeps in sorted({*(SWEEPS if full else FEW_SWEEPS), usual}):
            correction_sweeps.SWEEPS = sweeps
            materials = body.share.materials
            flat, remaining = appendix_a(body.model.comm, body.model.points, materials, body.model.bonds)
            left_over[sweeps - 1] = float(remaining)
            vectors[sweeps] = point_rows(flat)
    finally:
        correction_sweeps.SWEEPS = usual
    x = point_rows(body.model.points.x)
    depth = x + 0.5 * n
    axis = (np.abs(x[:, 1:] + 0.2113) < 0.01).all(axis=1) & (x[:, 0] < 0.0)
    order = np.flatnonzero(axis)[np.argsort(depth[axis, 0])]

    def at(*outer):
        place = [depth.min() if out else x[x < 0].max() + 0.5 * n for out in outer]
        return int(np.argmin(((depth - place) ** 2).sum(axis=1)))

    face, edge, corner, inside = (
        at(True, False, False), at(True, True, False), at(True, True, True), at(False, False, False),
    )  # fmt: skip
    before, after = 1.0 / vectors[1], vectors[usual]
    return {
        "block_cells": n,
        "sweeps": [[sweeps, value] for sweeps, value in left_over.items() if sweeps + 1 in SWEEPS],
        "layers": [[float(depth[k, 0]), *map(float, after[k, :2])] for k in order],
        "g_face": float(before[face, 0]),
        "g_face_along": float(before[face, 1]),
        "g_edge": float(before[edge, 0]),
        "g_corner": float(before[corner, 0]),
        "g_inside": float(before[inside, 0]),
        "g_c_inside": float(after[inside, 0]),
        "g_c_face": float(after[face, 0]),
        "g_c_along": float(after[face, 1]),
        "g_c_corner": float(after[corner, 0]),
        "g_infinite": float(correction_sweeps.INFINITE_RESPONSE),
        **{f"left_{sweeps}": left_over[sweeps] for sweeps in (0, 5, 10, 20)},
    }
