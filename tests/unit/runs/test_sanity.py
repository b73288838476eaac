"""Sentences about what may not be meant: one for each doubt, none for sound decks."""

import numpy as np
import pytest

from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.table import Units
from pdfem_mpi.runs.failure_notes import Criterion
from pdfem_mpi.runs.sanity import (
    describe_first_break,
    describe_small_strains,
    doubtful_limits,
    doubtful_moduli,
    largest_gradient,
    supports_that_may_break_loose,
)
from pdfem_mpi.runs.simulation import Simulation
from support.bodies import YOUNGS_MODULUS, local_share, make_scene
from support.failing import strip

STEEL = {("N", "mm"): 2.1e5, ("N", "m"): 2.1e11, ("lbf", "in"): 3.0e7}
#: 2.1e11 Pa in each of these, to four digits; a pound over a square inch is 6894.757 Pa.
STEEL_TOLD = {("N", "mm"): "2.1e+05", ("N", "m"): "2.1e+11", ("lbf", "in"): "3.046e+07"}
ROUND_OFF = 1e-5  # displacements of bonds are stored in single precision


def scene(modulus=YOUNGS_MODULUS, units=("", ""), **material):
    found = make_scene((4, 2, 2), 2)
    units = Units(force=units[0], length=units[1])
    return found.model_copy(update={"material": Material(youngs_modulus=modulus, **material), "units": units})


@pytest.mark.parametrize("units", STEEL)
def test_moduli_a_thousand_times_off_are_told(units):
    assert not list(doubtful_moduli(scene(STEEL[units], units)))
    (soft,), (stiff,) = (list(doubtful_moduli(scene(STEEL[units] * factor, units))) for factor in (1e-6, 1e3))
    assert soft.startswith("warning: material.youngs_modulus = ") and "below that of rubber" in soft
    assert "above that of diamond" in stiff and f"steel has {STEEL_TOLD[units]} {units[0]}/{units[1]}^2." in stiff


def test_units_that_are_not_known_tell_nothing():
    assert not list(doubtful_moduli(scene(1e-9))) and not list(doubtful_moduli(scene(1e-9, ("stone", "mm"))))


@pytest.mark.parametrize(
    ("stretch", "words"),
    [(0.5, "at a stretch of 50 %"), (1e-7, "rounding is not far below"), (0.05, 'Use "finite".'), (0.01, None)],
)
def test_limits(stretch, words):
    limits = {"default": Criterion(stretch, 1.0, 1.0, None)}
    found = list(doubtful_limits(scene(critical_stretch=stretch), limits))
    assert [words in text for text in found] == ([] if words is None else [True])


def test_supports_on_bonds_that_may_break():
    sound = strip()
    assert not list(supports_that_may_break_loose(sound, local_share(sound)))
    regions = tuple(region.model_copy(update={"may_fail": None}) for region in sound.regions)
    loose = sound.model_copy(update={"regions": regions})
    (text,) = supports_that_may_break_loose(loose, local_share(loose))
    assert text.startswith("note: supports.0, supports.1 act on cells whose bonds may break")


@pytest.mark.parametrize(("factor", "told"), [(1e-4, True), (-1e-4, True), (1e3, True), (0.5, False), (None, False)])
def test_first_break(factor, told):
    assert bool(list(describe_first_break(factor))) == told


@pytest.mark.parametrize("elements", [0, 2, 6])
def test_strains_in_linear_kinematics(elements):
    """A bar stretched by 3 % between moved ends, and one by 0.3 %."""
    for amount, told in ((0.18, True), (0.018, False)):
        supports = (Support(face="x-", x=0.0, y=0.0, z=0.0), Support(face="x+", x=amount))
        body = make_scene((6, 1, 1), elements, supports=supports, loads=(), solver="cg", correction="none")
        simulation = Simulation(body)
        simulation.solve(1.0)
        edge = simulation.share.quality.shortest_edge / simulation.share.units.length
        found = list(describe_small_strains(body, simulation.forces, edge))
        assert bool(found) == told, (elements, amount)


def test_the_gradient_is_that_of_a_uniform_strain():
    loads = tuple(
        BodyForce(kind="body_force", face=face, total=(total, 0.0, 0.0)) for face, total in (("x-", -1.0), ("x+", 1.0))
    )
    simulation = Simulation(make_scene((4, 2, 2), loads=loads))
    x = simulation.model.points.x
    u = np.zeros_like(simulation.state.u)
    u[:] = 0.04 * x[: len(u)]
    simulation.forces.evaluate_surely(u, np.zeros_like(u), np.empty_like(u))
    assert largest_gradient(simulation.forces, 1.0) == pytest.approx(0.04, rel=ROUND_OFF)
