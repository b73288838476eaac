"""The probe of an energy release rate: against the compliances of two bodies, and what it refuses."""

import numpy as np
import pytest

import pdfem_mpi as pdfem
from pdfem_mpi.deck.toml import parse_deck

EQUILIBRIUM = 1e-7  # of a difference of compliances: residuals of 1e-10

STRIP = """
[mesh]
kind = "box"
lower = [0.0, 0.0, 0.0]
upper = [8.0, 6.0, 1.0]
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
polygon = [[-1.0, 3.0, -1.0], [LENGTH, 3.0, -1.0], [LENGTH, 3.0, 2.0], [-1.0, 3.0, 2.0]]
[[probes]]
kind = "energy_release"
name = "tip"
direction = [2.0, 0.0, 0.0]
[solver]
kind = "cg"
tolerance = 1e-10
[output]
fields = false
figures = false
"""
PULLED = '[[loads]]\nkind = "body_force"\nface = "y-"\ntotal = [0.0, -2.0, 0.0]\n' + (
    '[[loads]]\nkind = "body_force"\nface = "y+"\ntotal = [0.0, 2.0, 0.0]\n'
)
MOVED = '[[supports]]\nface = "y-"\ny = -0.01\n[[supports]]\nface = "y+"\ny = 0.01\nx = 0.0\n'


def row(length, loading):
    simulation = pdfem.Simulation(parse_deck(STRIP.replace("LENGTH", str(length)) + loading, "strip.toml"))
    return simulation.solve(1.0)


def test_rate_under_forces_is_that_of_the_compliance(tmp_path):
    """``G = P dv / 2`` per new area: what the longer crack adds to the work of the same forces."""
    folder = pdfem.run(parse_deck(STRIP.replace("LENGTH", "3.0") + PULLED, "strip.toml"), tmp_path / "run")
    shorter, longer = row(3.0, PULLED), row(4.0, PULLED)
    assert shorter["reaction"] == longer["reaction"] == 2.0
    expected = 0.5 * 2.0 * (longer["displacement"] - shorter["displacement"])
    found = folder.summary["probes"]["tip"]
    assert found["energy_release_rate"] == pytest.approx(expected, rel=EQUILIBRIUM)
    modulus = 1000.0 / (1.0 - 0.25**2)
    assert found["stress_intensity"] == pytest.approx(np.sqrt(expected * modulus), rel=EQUILIBRIUM)


def test_rate_between_moving_supports_is_that_of_the_stiffness(tmp_path):
    """``G = -v dP / 2`` per new area, with ``v`` and ``P`` of both ends: the energy that the body loses."""
    folder = pdfem.run(parse_deck(STRIP.replace("LENGTH", "3.0") + MOVED, "strip.toml"), tmp_path / "run")
    shorter, longer = row(3.0, MOVED), row(4.0, MOVED)
    expected = 0.5 * 0.02 * (shorter["reaction"] - longer["reaction"])
    assert folder.summary["probes"]["tip"]["energy_release_rate"] == pytest.approx(expected, rel=1e-6)


def test_half_a_body_beside_a_crack_on_its_mirror_releases_as_much(tmp_path):
    whole = parse_deck(STRIP.replace("LENGTH", "3.0") + PULLED, "strip.toml")
    text = STRIP.replace("LENGTH", "3.0") + PULLED.partition("[[loads]]")[2].partition("[[loads]]")[2]
    text = text.replace('symmetry = ["z-", "z+"]', 'symmetry = ["z-", "z+", "y-"]').replace(
        "lower = [0.0, 0.0, 0.0]", "lower = [0.0, 3.0, 0.0]"
    )
    half = parse_deck(text.replace('kind = "body_force"', '[[loads]]\nkind = "body_force"', 1), "half.toml")
    rates = [
        pdfem.run(scene, tmp_path / name).summary["probes"]["tip"]["energy_release_rate"]
        for name, scene in (("whole", whole), ("half", half))
    ]
    assert rates[1] == pytest.approx(rates[0], rel=1e-6)


@pytest.mark.parametrize(
    ("before", "after", "sentence"),
    [
        ("direction = [2.0", "crack = 1\ndirection = [2.0", "probes.0.crack = 1 is not the number of a crack"),
        ("[2.0, 0.0, 0.0]", "[0.0, 0.0, 0.0]", "probes.0.direction = [0.0, 0.0, 0.0] has no direction"),
        ("[2.0, 0.0, 0.0]", "[2.0, 0.0, 1.0]", "ends at one corner of the crack. Give the normal of its straight"),
        ("youngs_modulus", "critical_stretch = 0.1\nyoungs_modulus", "compares two bodies that keep their bonds"),
    ],
)
def test_what_has_no_rate_is_told(before, after, sentence):
    with pytest.raises(pdfem.DeckError) as error:
        parse_deck(STRIP.replace("LENGTH", "3.0").replace(before, after) + PULLED, "strip.toml")
    assert sentence in str(error.value)
