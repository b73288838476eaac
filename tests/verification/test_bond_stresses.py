"""Stresses of bonds against those of elements of the same mesh, and stress intensity against its closed form."""

import numpy as np
import pytest

import pdfem_mpi as pdfem
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.measure.field_values import mean_of
from pdfem_mpi.measure.stresses import mechanics_of_bonds, mechanics_of_elements
from pdfem_mpi.runs.energy_release import longer_scene, rate_between

#: Means of cells more than l from free faces, and more than 2.5 l, in parts of the largest stress: measured 1.83 % and
#: 1.04 % on this plate; single points 4.4 % and 1.7 %.
NEAR, FAR = 0.03, 0.015
#: Of the stress intensity: measured 1.9 % below with "virial".
INTENSITY = 0.05

PLATE = """
[mesh]
kind = "plate_with_hole"
symmetry = ["x-", "y-", "z-", "z+"]
lower = [0.0, 0.0, 0.0]
upper = [28.0, 16.0, 1.0]
hole_radius = 5.0
spacing = 1.0
[material]
youngs_modulus = 1000.0
[[regions]]
name = "far"
model = "finite_elements"
lower = [20.0, 0.0, 0.0]
[[regions]]
name = "near"
model = "MODEL"
upper = [20.0, 16.0, 1.0]
[peridynamics]
surface_correction = "virial"
kinematics = "linear"
[[loads]]
kind = "traction"
face = "x+"
traction = [1.0, 0.0, 0.0]
[solver]
kind = "cg"
tolerance = 1e-9
"""


def solved(model):
    simulation = pdfem.Simulation(parse_deck(PLATE.replace("MODEL", model), "plate.toml"))
    simulation.solve(1.0)
    return simulation


def means(mechanics):
    """Stresses of the means of cells, by the number of the cell."""
    found = np.full((mechanics.cells.max() + 1, 6), np.nan)
    found[mechanics.cells] = mean_of(mechanics).stress[:, 0]
    return found


def test_stresses_of_bonds_are_those_of_elements():
    """A plate with a hole of five cells' radius in plane strain, from one cell off its faces on."""
    bonds, elements = solved("peridynamics"), solved("finite_elements")
    exact = mechanics_of_elements(elements.share, elements.forces)
    found, expected = means(mechanics_of_bonds(bonds.share, bonds.forces)), means(exact)
    mesh = bonds.share.mesh
    corners = mesh.nodes[mesh.cells[: len(found)]]
    distance = np.minimum(np.hypot(corners[..., 0], corners[..., 1]) - 5.0, 16.0 - corners[..., 1]).min(axis=1)
    inside = corners[..., 0].max(axis=1) <= 17.0  # off the buried end of the bonds by more than they reach
    error = np.abs(found - expected[: len(found)]).max(axis=1) / np.abs(exact.stress).max()
    assert error[inside & (distance > 0.99)].max() <= NEAR
    assert error[inside & (distance > 2.49)].max() <= FAR


CRACKED = """
[mesh]
kind = "box"
lower = [0.0, 0.0, 0.0]
upper = [40.0, 40.0, 1.0]
spacing = 1.0
symmetry = ["z-", "z+"]
[material]
youngs_modulus = 1000.0
[[regions]]
name = "bonds"
model = "peridynamics"
[peridynamics]
surface_correction = "virial"
kinematics = "linear"
[[cracks]]
polygon = [[-5.0, 20.0, -1.0], [20.0, 20.0, -1.0], [20.0, 20.0, 2.0], [-5.0, 20.0, 2.0]]
[[probes]]
kind = "energy_release"
name = "tip"
direction = [1.0, 0.0, 0.0]
[solver]
kind = "cg"
tolerance = 1e-8
""" + "".join(
    f'[[supports]]\nface = "{face}"\nlayers = 3\nx = 0.0\ny = 0.0\nz = 0.0\n' for face in ("x-", "x+", "y-", "y+")
)
INTENSITY_PRESCRIBED, MODULUS, RATIO = 1.0, 1000.0, 0.25


def field_of_a_crack(x, tip):
    """Displacements around a crack's tip in plane strain (Williams), mode I; x of shape (n, 3)."""
    dx, dy = (x - tip)[:, :2].T
    half, mu = 0.5 * np.arctan2(dy, dx), MODULUS / (2.0 * (1.0 + RATIO))
    size = INTENSITY_PRESCRIBED / (2.0 * mu) * np.sqrt(np.hypot(dx, dy) / (2.0 * np.pi))
    kappa = 3.0 - 4.0 * RATIO
    u = np.zeros_like(x)
    u[:, 0] = size * np.cos(half) * (kappa - 1.0 + 2.0 * np.sin(half) ** 2)
    u[:, 1] = size * np.sin(half) * (kappa + 1.0 - 2.0 * np.cos(half) ** 2)
    return u


def test_stress_intensity_of_a_crack_of_twenty_cells():
    """Displacements of a unit K_I on three layers around a square between mirror planes; the tip halfway of both."""
    shorter = pdfem.Simulation(parse_deck(CRACKED, "crack.toml"))
    (probe,) = shorter.scene.probes
    longer = pdfem.Simulation(longer_scene(shorter, probe))
    for simulation in (shorter, longer):
        unknowns, units = simulation.model.unknowns, simulation.share.units
        x = unknowns.rows(simulation.model.points.x[: unknowns.size]) * units.length + units.origin
        u = unknowns.join(field_of_a_crack(x, np.array([20.5, 20.0, 0.0])) / units.length)
        fixed = simulation.case.fixed
        simulation.case.prescribed[fixed] = u[fixed]
        simulation.solve(1.0)
    found = rate_between(shorter, longer, probe)
    assert found["stress_intensity"] == pytest.approx(INTENSITY_PRESCRIBED, rel=INTENSITY)
    rate = INTENSITY_PRESCRIBED**2 * (1.0 - RATIO**2) / MODULUS
    assert found["energy_release_rate"] == pytest.approx(rate, rel=2 * INTENSITY)
