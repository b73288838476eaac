"""What a crack transmits over its opening: its area, a sum over single bonds, and the fit of a measured curve."""

import numpy as np
import pytest

from pdfem_mpi.body.softening import law_of
from pdfem_mpi.body.softening_law import Shape
from pdfem_mpi.body.traction_opening import curve_energy, dilatation_energy, fit_curve, transmitted
from pdfem_mpi.deck.materials import Material

BILINEAR = ((0.0, 2.59), (0.0361, 0.61), (0.203, 0.0))
SAMPLED = 0.02  # of bonds drawn at random


def test_area_is_the_fracture_energy():
    shape = Shape(0.5, (0.3, 0.1))
    opening = np.append(0.0, np.geomspace(1e-5, 20.0, 2000))  # bonds along the plane open far
    curve = transmitted(shape, 30.0, 2e-3, 7.0, 1.0, 2.5, opening)
    assert np.trapezoid(curve, opening) == pytest.approx(7.0, rel=2e-3)


def test_curve_is_the_sum_over_single_bonds():
    """Bonds of random length and direction across a plane, each pulled by the opening along the normal."""
    random = np.random.default_rng(3)
    shape, ratio, first = Shape(0.5), 20.0, 1e-3
    branch = shape.branch(ratio)
    r, m = 2.5 * random.random(400_000), random.random(400_000)
    weight = r**3 * np.exp(-(r**2)) * m**2

    def force(w):
        s = w * m / r / first
        return (weight * np.where(s < 1.0, s, np.interp(s, branch.stretch, branch.force, right=0.0))).sum()

    opening = np.array([0.003, 0.01, 0.02])
    found = transmitted(shape, ratio, first, 1.0, 1.0, 2.5, opening)
    expected = np.array([force(w) for w in opening])
    assert found / found[0] == pytest.approx(expected / expected[0], rel=SAMPLED)


def test_far_above_the_first_stretch_the_curve_hangs_on_no_length():
    """Strength, energy and shape fix it: at half the internal length the same, to 2 % of the strength."""
    unit = Material(youngs_modulus=2.6e4, critical_stretch=1.0).energy_at_failure(1.0, 1.0, 2.5)
    opening, first, shape = np.linspace(0.01, 0.2, 40), 1e-4, Shape(0.5, (0.2, 0.114))
    curves = [
        transmitted(shape, shape.ratio(0.11 / (unit * length * first**2)), first, 0.11, length, 2.5, opening)
        for length in (5.0, 2.5)
    ]
    assert np.abs(curves[0] - curves[1]).max() < 0.02 * 2.6


@pytest.mark.parametrize("ratio", [1.0001, 20.0])
def test_dilatation_beside_a_plane_that_opens(ratio):
    """Points at many heights, each with its own bonds across the plane: what the opening spends on the dilatation."""
    branch = Shape(0.5).branch(ratio)
    middles = (np.arange(150) + 0.5) / 150
    r, m = (grid.reshape(-1) for grid in np.meshgrid(2.5 * middles, middles))
    heights = (np.arange(100) + 0.5) / 100 * 2.5
    weight = 2.5 * r**3 * np.exp(-(r**2)) / len(r)
    openings = np.geomspace(1e-3, 100.0 * ratio, 120)
    above = (r * m > heights[:, None]).astype(float)

    def stored(w):
        s = w * m / r
        force = np.where(s < 1.0, s, np.interp(s, branch.stretch, branch.force, right=0.0))
        return ((3.0 * (above @ (weight * force))) ** 2).sum() * 2.5 / len(heights)

    spent = 2.0 * np.trapezoid([stored(w) for w in openings], np.log(openings))
    assert dilatation_energy(Shape(0.5), ratio, 2.5) == pytest.approx(spent / 4.843, rel=SAMPLED)


def test_fit_of_a_bilinear_curve():
    """That of concrete: the kink near the one in use for it, and the tail within a twentieth of the strength."""
    modulus, length = 26110.0, 10.0
    unit = Material(youngs_modulus=modulus, critical_stretch=1.0).energy_at_failure(1.0, length, 2.5)
    shape = fit_curve(BILINEAR, modulus, unit, length, 2.5)
    assert shape.drop == 0.5
    assert shape.kink[0] == pytest.approx(0.23, abs=0.05) and shape.kink[1] == pytest.approx(0.114, abs=0.01)
    first, energy = 2.59 / modulus, curve_energy(BILINEAR)
    opening = np.linspace(0.02, 0.2, 50)
    found = transmitted(shape, shape.ratio(energy / (unit * first**2)), first, energy, length, 2.5, opening)
    assert np.abs(found - np.interp(opening, *np.array(BILINEAR).T)).max() < 0.35 * 2.59
    late = opening > 0.05
    assert np.abs(found - np.interp(opening, *np.array(BILINEAR).T))[late].max() < 0.05 * 2.59


@pytest.mark.parametrize("length", [1.0, 1.25, 1.5, 2.0])
def test_a_short_branch_keeps_a_length_beyond_its_kink(length):
    """A polymer whose branch is a few first stretches long: what lattice and dilatation take leaves one."""
    polymer = ((0.0, 10.4), (0.0276, 2.7), (0.0803, 0.0))
    material = Material(youngs_modulus=3707.0, poissons_ratio=0.39, traction_opening=polymer)
    law = law_of(material, length, 2.5, 1.25, 0.956)
    assert law.longest > 1.3 * length
    assert law.shape.kink[0] * law.final > 1.5 * law.first
    assert law.energy == pytest.approx(curve_energy(polymer))
