"""Fracture energy of planes of the cells' lattice, against sums one by one and the bonds of a body."""

import itertools
import math

import numpy as np
import pytest

from pdfem_mpi.body.lattice_planes import bond_sizes, energy_of_planes, lattice_energy
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.runs.failure_notes import criteria
from support.bodies import build, make_scene
from support.softening import softening_material

CUTOFF = 2.5
DIGITS = 1e-5  # six are kept
#: Cubes whose faces are all mirror planes: a body without ends.
ALL = ("x-", "x+", "y-", "y+", "z-", "z+")


def endless(correction, material):
    mesh = BoxMesh(lower=(0.0, 0.0, 0.0), upper=(2.0, 2.0, 1.0), spacing=1.0, symmetry=ALL)
    scene = make_scene((2, 2, 1), mesh=mesh, correction=correction, loads=())
    return scene.model_copy(update={"material": material})


def bonds_of_a_cell(length):
    """Starts and ways of the bonds of all eight points of a cell, and half of their energies at unit stretch."""
    axis = (0.5 - 0.5 / math.sqrt(3.0), 0.5 + 0.5 / math.sqrt(3.0))
    corners = np.array(list(itertools.product(axis, repeat=3)))
    reach = math.ceil(CUTOFF * length) + 1
    cells = np.array(list(itertools.product(range(-reach, reach + 1), repeat=3)))
    others = (cells[:, None, :] + corners).reshape(-1, 3)
    start = np.repeat(corners, len(others), axis=0)
    xi = np.tile(others, (8, 1)) - start
    r = np.linalg.norm(xi, axis=1)
    near = (r > 0.0) & (r <= CUTOFF * length * (1.0 + 1e-6))
    start, xi, r = start[near], xi[near], r[near]
    return start, xi, 0.25 * 6.0 / (math.pi * length**4) * np.exp(-((r / length) ** 2)) / 64.0 * r


def formula(length):
    return 0.971457 * 27.0 * math.sqrt(math.pi) / 16.0 * 2.0 / 3.0 * length


@pytest.mark.parametrize("length", [0.75, 1.0, 1.5])
def test_mean_over_planes_one_by_one(length):
    """Bonds of all eight points of a cell, each counted for the planes that it crosses; without correction."""
    _, xi, energy = bonds_of_a_cell(length)
    mean = (energy * np.abs(xi[:, 0])).sum() / formula(length)
    assert lattice_energy(length, CUTOFF, "none") == pytest.approx(mean, rel=DIGITS)


@pytest.mark.parametrize(("place", "expected"), [(0.0, 0.986), (0.5, 0.934)])
def test_planes_between_and_within_cells(place, expected):
    """With "virial" and an internal length of one cell: 3 % more and 2 % less than in the mean."""
    start, xi, energy = bonds_of_a_cell(1.0)
    low, high = np.minimum(start[:, 0], start[:, 0] + xi[:, 0]), np.maximum(start[:, 0], start[:, 0] + xi[:, 0])
    crossed = np.floor(high - place) - np.floor(low - place)  # planes x = place + k
    factor = lattice_energy(1.0, CUTOFF, "virial") / lattice_energy(1.0, CUTOFF, "none")
    assert factor * (energy * crossed).sum() / formula(1.0) == pytest.approx(expected, abs=5e-4)


@pytest.mark.parametrize("correction", ["none", "virial", "appendix_a"])
def test_planes_of_a_body_without_ends(correction):
    """What `failure.fracture_energy.own_bonds` says of brittle bonds: the same, by the program's bonds and factors."""
    scene = endless(correction, Material(youngs_modulus=1000.0, critical_stretch=0.002))
    body = build(scene, loaded=False)
    found = criteria(scene, body.share, body.model)["default"]
    over = np.array(found.fracture_energy_own_bonds) / found.fracture_energy_bulk
    np.testing.assert_allclose(over, lattice_energy(1.0, CUTOFF, correction), rtol=1e-4)  # twenty sweeps of factors
    assert energy_of_planes(scene, body.share) == 1.0  # nothing is made up for where bonds are brittle


@pytest.mark.parametrize("ratio", [6.0, 60.0])
def test_bonds_that_soften_take_the_decks_energy(ratio):
    """In a body without ends, whatever the lattice makes of the formula."""
    scene = endless("virial", softening_material(ratio))
    body = build(scene, loaded=False)
    found = criteria(scene, body.share, body.model)["default"]
    np.testing.assert_allclose(found.fracture_energy_own_bonds, scene.material.fracture_energy, rtol=1e-4)
    assert bond_sizes(scene, body.share) == (1.0, CUTOFF, lattice_energy(1.0, CUTOFF, "virial"))


def test_dense_lattices_have_the_stiffness_of_cut_bonds():
    """Bonds beyond 2.5 l are not there: corrected ones are 1.4 % stiffer, G_c is as much above the formula's."""
    assert lattice_energy(6.0, CUTOFF, "virial") == lattice_energy(50.0, CUTOFF, "virial")
    kept = math.erf(2.5) - 2.0 / math.sqrt(math.pi) * math.exp(-6.25) * (2.5 + 2.0 / 3.0 * 2.5**3)
    stiffness = 1.0 / (1.0 - math.exp(-6.25) * (1.0 + 6.25))
    assert kept == pytest.approx(0.971457, rel=1e-5)
    assert lattice_energy(50.0, CUTOFF, "virial") == pytest.approx(stiffness, rel=2e-3)
