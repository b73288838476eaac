"""Supports that follow the load factor: two at one place agree at all factors, and one of them holds it."""

import itertools

import numpy as np
import pytest

from pdfem_mpi.deck.displacements import Rotation
from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.simulation import Simulation
from support.bodies import build, make_scene

HOLD = Support(face="x-", x=0.0, y=0.0, z=0.0)
#: 0.01 f at all factors that are tried in any program, and nowhere else.
ALIKE = "0.01*f + (f-0.25)*(f-0.5)*(f-0.75)*(f-1)*(f-2)"


def scene_of(*supports, factors=(0.5, 1.0), n_elements=4, **options):
    scene = make_scene((4, 2, 2), n_elements, loads=(), supports=(HOLD, *supports), solver="cg", **options)
    return Scene.model_validate({**dict(scene), "stepping": Steps(kind="steps", load_factors=factors)})


def refused(*supports, **options):
    with pytest.raises(SceneError) as caught:
        build(scene_of(*supports, **options))
    return caught.value.messages


@pytest.mark.parametrize("n_elements", [0, 4])
def test_supports_that_agree_at_the_full_load_alone_are_refused(n_elements):
    """In both orders of the deck; the sentence names both, and the first load factor of the program that tells."""
    one, two = Support(face="x+", x="0.01*f^2"), Support(face="x+", x=0.01)
    count = 9 if n_elements else 4
    (sentence,) = refused(one, two, n_elements=n_elements)
    assert sentence == (
        f'supports.2.x = 0.01 contradicts supports.1.x = "0.01*f^2" at load factor 0.5, at {count} of the same places. '
        "Keep one of them."
    )
    (sentence,) = refused(two, one, n_elements=n_elements, factors=(0.3, 1.0))
    assert sentence.startswith('supports.2.x = "0.01*f^2" contradicts supports.1.x = 0.01 at load factor 0.3')


def test_two_formulas_that_share_an_edge_are_compared():
    (sentence,) = refused(Support(face="x+", x="0.01*f^2"), Support(face="y+", x="0.01*f^3*x/4"))
    assert 'contradicts supports.1.x = "0.01*f^2" at load factor 0.5, at 3 of the same places' in sentence


def test_load_factors_of_the_program_are_tried():
    """And those alone that it names, beside a few that any program has."""
    supports = (Support(face="x+", x=ALIKE), Support(face="x+", x=0.01))
    (sentence,) = refused(*supports, factors=(0.3, 1.0))
    assert "at load factor 0.3," in sentence
    assert build(scene_of(*supports, factors=(1.0,))).case is not None


def test_what_is_not_finite_at_factors_that_nobody_asks_for_is_no_contradiction():
    text = "0.01*sqrt(2 - f - 0.5)"  # of a load factor of 2, no number
    assert build(scene_of(Support(face="x+", x=text), Support(face="x+", x=text))).case is not None


def test_supports_that_agree_at_all_factors_leave_one_holder():
    """The later one, whose formula or number it is that the place follows."""
    agreeing = (Support(name="a", face="x+", x="0.01*f"), Support(name="b", face="x+", x=0.01))
    simulation = Simulation(scene_of(*agreeing, tolerance=1e-8), mpi().COMM_SELF)
    for row in simulation.steps():
        assert row["a.force_x"] == 0.0
        assert row["b.force_x"] > 0.0


def test_a_rotation_of_two_places_that_overlap_is_one():
    """Each unknown follows one of both formulas."""
    turning = Rotation(axis=(0.0, 0.0, 1.0), point=(0.0, 0.0, 0.0), angle=0.3, finite=True)
    supports = (Support(face="x+", rotation=turning), Support(lower=(3.0, 1.0, 0.0), rotation=turning))
    case = build(scene_of(*supports)).case
    for one, two in itertools.combinations([part.index for part in case.following], 2):
        assert not np.intersect1d(one, two).size
    count = np.bincount(np.concatenate([part.index for part in case.following]), minlength=len(case.fixed))
    assert np.count_nonzero(count == 1) == 2 * 15  # nodes of both places, along x and y


@pytest.mark.parametrize("text", ["0.02*f*(1-f)", "0.02*sin(2*pi*f)"])
def test_motion_out_of_a_mirror_plane_on_the_way_is_refused(text):
    (sentence,) = refused(Support(face="x+", y=text), symmetry=("y-",))
    assert sentence.startswith(f'supports.1.y = "{text}" moves 3 nodes out of a mirror plane')


def test_nodes_stay_on_a_mirror_plane_whatever_the_formula():
    """It is 0 there at all factors that are tried, and not between."""
    body = build(scene_of(Support(face="x+", y=f"0.01*f*y + {ALIKE} - 0.01*f"), symmetry=("y-",), factors=(1.0,)))
    u = np.zeros(body.model.n_unknowns)
    body.case.displace(u, 0.3)
    assert not u[body.model.rollers].any()
    assert u.any()
