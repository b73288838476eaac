"""The displacement that belongs to the reaction: the largest prescribed one in size, and the motion's in sign."""

import pytest

from pdfem_mpi import Simulation
from pdfem_mpi.deck.loads import Support
from support.bodies import make_scene

HELD = Support(face="x-", x=0.0, y=0.0, z=0.0)


def told(load_factors, *supports):
    """Displacements of the rows of a short bar whose supports move."""
    scene = make_scene((3, 1, 1), 3, supports=supports, loads=(), solver="cg", correction="none")
    simulation = Simulation(scene)
    return [simulation.solve(f)["displacement"] for f in load_factors]


@pytest.mark.parametrize("size", ["0.01", "-0.01"])
def test_cycles_of_a_formula_do_not_fold(size):
    """Positive the way it began, as prescribed numbers are, whether that is a pull or a push."""
    pushed = Support(face="x+", x=f"{size}*sin(2*pi*f)")
    assert told((0.25, 0.75, 1.25, -0.25), HELD, pushed) == pytest.approx([0.01, -0.01, 0.01, -0.01], rel=1e-12)


def test_both_ends_that_move_apart_and_together():
    ends = Support(face="x-", x="-0.01*sin(2*pi*f)", y=0.0, z=0.0), Support(face="x+", x="0.01*sin(2*pi*f)")
    assert told((0.25, 0.75), *ends) == pytest.approx([0.01, -0.01], rel=1e-12)


def test_motions_that_only_grow_keep_the_sign_of_the_load_factor():
    assert told((0.5, 1.0), HELD, Support(face="x+", x="-0.01*f**3")) == pytest.approx([0.00125, 0.01], rel=1e-12)
    assert told((-1.0, 0.0), HELD, Support(face="x+", x="0.01*f")) == pytest.approx([-0.01, 0.0], rel=1e-12)
    late = Support(face="x+", x="0.01*max(f - 0.5, 0.0)")
    assert told((1.0, -1.0), HELD, late) == pytest.approx([0.005, 0.0], rel=1e-12)


def test_an_even_motion_is_not_turned_by_the_load_factor():
    """At -1 the end has moved as at 1."""
    assert told((1.0, -1.0), HELD, Support(face="x+", x="0.01*f**2")) == pytest.approx([0.01, 0.01], rel=1e-12)


def test_a_motion_from_elsewhere_is_signed_by_where_it_goes():
    assert told((0.0, 1.0), HELD, Support(face="x+", x="0.01*(f - 0.25)")) == pytest.approx(
        [-0.0025, 0.0075], rel=1e-12
    )


def test_large_turns_go_on_with_the_sign_of_the_load_factor():
    """By more than half a turn, where the way from the beginning is at right angles to how it began, and beyond."""
    y, z = "(y - 0.5)", "(z - 0.5)"
    turned = Support(face="x+", y=f"(cos(pi*f) - 1)*{y} - sin(pi*f)*{z}", z=f"sin(pi*f)*{y} + (cos(pi*f) - 1)*{z}")
    assert all(found > 0.0 for found in told((0.1, 0.9, 1.0, 1.2), HELD, turned))
    assert all(found < 0.0 for found in told((-0.1, -0.9, -1.0, -1.2), HELD, turned))
