"""Model units: what is rounded where bonds can break, and what other units or another place leave of that."""

import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.model_units import FAR, QUANTUM, ModelUnits, quantum_for
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import PlateWithHoleMesh
from support.bodies import make_scene
from support.failing import strip
from support.transformed import Transform

PLATE = PlateWithHoleMesh(
    kind="plate_with_hole", lower=(-4.0, -3.0, 0.0), upper=(4.0, 3.0, 1.0), spacing=0.5, hole_radius=1.0
)


def units(quantum):
    return ModelUnits(0.3, 7.0, np.array([1.0, 2.0, 3.0]), quantum)


def test_without_a_quantum_nothing_is_rounded():
    x = np.random.default_rng(1).uniform(-5.0, 5.0, (50, 3))
    np.testing.assert_array_equal(units(0.0).places(x), (x - [1.0, 2.0, 3.0]) / 0.3)
    assert units(0.0).numbers(0.1) == 0.1


def test_places_are_multiples_of_the_quantum():
    """At most half of it away, and mirror images stay mirror images."""
    x = np.random.default_rng(1).uniform(-5.0, 5.0, (50, 3))
    found = units(QUANTUM).places(x)
    exact = units(0.0).places(x)
    assert (found / QUANTUM == np.rint(found / QUANTUM)).all()
    assert 0.1 * QUANTUM < np.abs(found - exact).max() <= 0.5 * QUANTUM
    centred = ModelUnits(0.3, 7.0, np.zeros(3), QUANTUM)
    np.testing.assert_array_equal(centred.places(-x), -centred.places(x))


def test_numbers_keep_forty_digits():
    """Relative: whatever their size; 0 and what is not given stay."""
    x = np.array([1e-9, 1.0 / 3.0, -2e7 / 3.0])
    found = units(QUANTUM).numbers(x)
    assert (found != x).all() and np.abs(found / x - 1.0).max() <= 2.0**-40
    np.testing.assert_array_equal(units(QUANTUM).numbers(x * (1.0 + 2.0**-51)), found)
    np.testing.assert_array_equal(units(QUANTUM).numbers(np.array([0.0, 0.5, np.nan])), [0.0, 0.5, np.nan])


def test_the_quantum_grows_far_from_the_origin():
    """With what the deck's own numbers leave of places there."""
    box = np.zeros(3), np.array([20.0, 10.0, 1.0])
    assert quantum_for(*box, 1.0) == QUANTUM
    far = quantum_for(box[0] + 1e9, box[1] + 1e9, 1.0)
    assert FAR * 1e9 <= far <= 4.0 * FAR * 1e9 and np.log2(far) == np.rint(np.log2(far))


@pytest.mark.parametrize(
    "transform",
    [Transform(length=3.7e-3, stress=6895.0), Transform(length=1e-9), Transform(length=1 / 3, shift=(1e6 / 3,) * 3)],
    ids=["inches to metres or so", "nanometres", "far away"],
)
def test_bodies_that_break_are_the_same_in_other_units_and_elsewhere(transform, tmp_path):
    """Every bit of places and cutoff; the other digits were another's in units of the deck."""
    here = discretize(strip(cells=(9, 7, 1)))
    there = discretize(transform.scene(strip(cells=(9, 7, 1)), tmp_path))
    np.testing.assert_array_equal(here.nodes, there.nodes)
    assert here.cutoff == there.cutoff
    assert (here.mesh.nodes != there.mesh.nodes).any()


def test_graded_cells_as_well(tmp_path):
    """Around a hole no place is on a lattice."""
    material = Material(youngs_modulus=1000.0, critical_stretch=0.002)
    scene = make_scene((1, 1, 1), loads=(), mesh=PLATE).model_copy(update={"material": material})
    here, there = (discretize(s) for s in (scene, Transform(length=3.7e-3).scene(scene, tmp_path)))
    np.testing.assert_array_equal(here.nodes, there.nodes)
    assert (here.nodes != discretize(make_scene((1, 1, 1), loads=(), mesh=PLATE)).nodes).any()


def test_bodies_that_cannot_break_are_not_rounded():
    """A linear deck keeps its bits."""
    assert discretize(make_scene((3, 2, 1))).units.quantum == 0.0
