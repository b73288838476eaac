"""Shares cut out of what each rank sees are those cut out of the whole body, in every bit; errors are the same."""

import pytest

from pdfem_mpi.body.cutting import make_share, share_of
from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.sight import is_seen_in_part, see
from pdfem_mpi.deck.loads import BodyForce, Force, Pressure, Support, Traction
from pdfem_mpi.deck.mechanical_probes import PointProbe
from pdfem_mpi.deck.meshes import BoxMesh, PlateWithHoleMesh
from pdfem_mpi.deck.outputs import DisplacementProbe, OpeningProbe
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.removals import RemovedBox, RemovedCylinder
from pdfem_mpi.deck.restraints import Spring
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh.everywhere import SeenInPart
from pdfem_mpi.parallel.comm import agree
from support.bodies import make_scene
from support.dressed_decks import dressed_scene
from support.helpers import assert_all
from support.same_shares import differences
from support.softening import remade, softening_material

pytestmark = pytest.mark.mpi(min_size=2)

NOTCH = RemovedBox(kind="box", lower=(5.0, -1.0, -1.0), upper=(6.0, 2.0, 9.0))
STEPS = (
    RemovedBox(kind="box", lower=(5.0, 0.0, 0.0), upper=(9.0, 1.0, 3.0)),
    RemovedBox(kind="box", lower=(9.0, 1.0, 0.0), upper=(11.0, 2.0, 1.0)),
)
BORE = RemovedCylinder(kind="cylinder", axis="z", centre=(9.0, 3.0, 0.0), radius=1.2)


def notched(*removals, symmetry=()):
    return BoxMesh(lower=(0.0, 0.0, 0.0), upper=(12.0, 5.0, 3.0), spacing=1.0, remove=removals, symmetry=symmetry)


def cut_off(first, last):
    return RemovedBox(kind="box", lower=(first, 0.0, 0.0), upper=(last, 5.0, 3.0))


def opening(one, two):
    return OpeningProbe(kind="opening", name="b", one=one, two=two)


PLATE = PlateWithHoleMesh(
    kind="plate_with_hole", lower=(-2.0, -1.4, -0.1), upper=(2.0, 1.4, 0.1), hole_radius=0.4, spacing=0.2
)
ROUND = (
    Region(name="core", model="peridynamics", centre=(0.0, 0.0, 0.0), radius=1.1, axis="z"),
    Region(name="rest", model="finite_elements"),
)
SCENES = {
    "bonds": lambda: make_scene((9, 4, 3)),
    "elements": lambda: make_scene((9, 4, 3), 9, solver="cg"),
    "deep overlap": lambda: make_scene((14, 3, 3), 7, overlap=3, coupling="paper_a"),
    "mirror planes": lambda: make_scene((8, 5, 4), 3, symmetry=("x-", "y+", "z-"), loads=()),
    "repeated": lambda: make_scene((6, 3, 3), symmetry=("x-", "x+", "y-"), loads=()),
    "notched": lambda: make_scene((12, 5, 3), 4, mesh=notched(NOTCH, BORE)),
    "mirrored notch": lambda: make_scene((12, 5, 3), 4, mesh=notched(NOTCH, BORE, symmetry=("y+",)), loads=()),
    "plate": lambda: make_scene((4, 3, 1), regions=ROUND, mesh=PLATE, loads=()),
    "plate whose bonds soften": lambda: remade(
        make_scene((4, 3, 1), regions=ROUND, mesh=PLATE, loads=()), material=softening_material(length=0.2)
    ),
    "deep layers, tractions and springs": lambda: make_scene(
        (12, 4, 4), 6,
        loads=(
            BodyForce(kind="body_force", face="x+", layers=5, total=(1.0, 0.0, 0.0)),
            Traction(kind="traction", face="x-", total=(-1.0, 0.0, 0.0)),
            Pressure(kind="pressure", lower=(0.0, 0.0, 4.0), upper=(3.0, 4.0, 4.0), pressure=2.0),
        ),
        springs=(Spring(face="y-", stiffness=(0.0, 1.0, 0.0)),),
    ),
    "narrow places": lambda: make_scene(
        (12, 4, 4), 6,
        loads=(Force(kind="force", line=((3.0, 0.0, 4.0), (3.0, 4.0, 4.0)), total=(0.0, 0.0, -1.0)),
               Force(kind="force", line=((9.0, 0.0, 4.0), (9.0, 4.0, 4.0)), total=(0.0, 0.0, -1.0))),
        supports=(Support(line=((0.0, 0.0, 0.0), (0.0, 4.0, 0.0)), z=0.0),
                  Support(line=((12.0, 0.0, 0.0), (12.0, 4.0, 0.0)), z=0.0),
                  Support(point=(6.0, 2.0, 2.0), x=0.0, y=0.0),
                  Support(of="nodes", lower=(5.0, 0.0, 0.0), upper=(8.0, 1.0, 1.0), y=0.0)),
    ),
    "lines along a step, across elements and bonds": lambda: make_scene(
        (12, 5, 3), 6, mesh=notched(*STEPS),
        loads=(Force(kind="force", line=((0.0, 1.0, 1.0), (12.0, 1.0, 1.0)), total=(0.0, 1.0, 0.0)),
               Force(kind="force", line=((0.0, 5.0, 1.0), (12.0, 5.0, 1.0)), total=(0.0, 1.0, 0.0))),
        supports=(Support(line=((0.0, 1.0, 0.0), (12.0, 1.0, 0.0)), x=0.0, y=0.0),),
        springs=(Spring(line=((0.0, 2.0, 0.0), (12.0, 2.0, 0.0)), stiffness=(0.0, 0.0, 1.0)),),
    ),
    "probes, a crack through the overlap": lambda: make_scene(
        (12, 4, 4), 6,
        probes=(DisplacementProbe(kind="displacement", name="a", point=(6.0, 2.0, 4.0)),
                opening((2.0, 0.0, 0.0), (11.0, 0.0, 0.0))),
        cracks=(Crack(polygon=((3.0, -1.0, 1.9), (8.0, -1.0, 1.9), (8.0, 5.0, 1.9), (3.0, 5.0, 1.9))),),
    ),
}  # fmt: skip

BAD = {
    "an empty region": lambda: make_scene(
        (8, 3, 3), regions=(Region(name="a", model="peridynamics"),
                            Region(name="b", model="finite_elements", lower=(90.0, 0.0, 0.0)))),
    "regions that overlap": lambda: make_scene(
        (8, 3, 3), regions=(Region(name="a", model="peridynamics"),
                            Region(name="b", model="finite_elements", lower=(5.0, 0.0, 0.0)))),
    "cells left out": lambda: make_scene(
        (8, 3, 3), regions=(Region(name="a", model="peridynamics", upper=(6.0, 3.0, 3.0)),)),
    "too deep an overlap": lambda: make_scene((8, 3, 3), 3, overlap=3),
    "removals": lambda: make_scene(
        (12, 5, 3), mesh=notched(NOTCH, RemovedBox(kind="box", lower=(0.0, 0.0, 0.0), upper=(0.4, 0.4, 0.4)))),
    "a body in parts": lambda: make_scene((12, 5, 3), mesh=notched(cut_off(5.0, 6.0))),
    "no mirror plane": lambda: make_scene((12, 5, 3), mesh=notched(cut_off(0.0, 2.0), symmetry=("x-",))),
    "nothing on a line": lambda: make_scene((8, 3, 3), supports=(Support(point=(0.3, 0.3, 0.3), x=0.0),)),
    "an opening outside": lambda: make_scene((8, 3, 3), probes=(opening((2.0, 0.0, 0.0), (11.0, 0.0, 0.0)),)),
    "points outside": lambda: make_scene(
        (8, 3, 3), probes=(DisplacementProbe(kind="displacement", name="a", point=(8.0, 3.0, 5.5)),
                           PointProbe(kind="point", name="b", point=(-7.0, 1.2, 1.0)))),
    "a point in a hole": lambda: make_scene(
        (4, 3, 1), regions=ROUND, mesh=PLATE, loads=(),
        probes=(PointProbe(kind="point", name="a", point=(0.1, 0.15, 0.0)),)),
    "more ranks than cells": lambda: make_scene((1, 1, 1)),
}  # fmt: skip

#: What ranks that see parts of the body find and tell.
OF_PARTS = "an opening outside", "points outside", "a point in a hole"


def of_whole(scene, comm):
    """The share cut out of the whole body."""
    return make_share(scene, discretize(scene, None, comm), comm)


def assert_same(scene, comm):
    in_part = is_seen_in_part(scene, comm)
    found, expected = share_of(scene, comm, before_whole=_never if in_part else None), of_whole(scene, comm)
    wrong = agree(comm, list(differences(found, expected)))
    assert not wrong, wrong[:5]


def _never():
    raise AssertionError("every rank makes the whole body")


@pytest.mark.parametrize("name", SCENES)
def test_shares_are_those_of_the_whole_body(comm, name):
    assert_same(SCENES[name](), comm)


@pytest.mark.parametrize("seed", [1, 2, 3, 4, *(pytest.param(k, marks=pytest.mark.slow) for k in range(5, 60))])
def test_shares_of_drawn_decks(comm, seed, tmp_path):
    """Some of them see the whole body on every rank: mesh files, fitted factors."""
    assert_same(dressed_scene(seed, tmp_path), comm)


@pytest.mark.parametrize("name", BAD)
def test_errors_are_those_of_the_whole_body(comm, name):
    """Found by the ranks together, and told of the whole: the same sentences."""
    scene, told, wholes = BAD[name](), [], []
    for make in (lambda: share_of(scene, comm, before_whole=lambda: wholes.append(1)), lambda: of_whole(scene, comm)):
        try:
            share = make()
            told.append(list(share.selections.problems.values()))
        except SceneError as error:
            told.append(error.messages)
    is_wrong = comm.size > 1 or name != "more ranks than cells"
    assert_all(comm, told[0] == told[1] and bool(str(told[0]).strip("[]() ,")) == is_wrong, f"{told}")
    assert_all(comm, len(wholes) == (comm.size > 1 and name not in OF_PARTS))


def test_what_is_wrong_is_told_to_all_ranks(comm):
    if comm.size > 1:
        with pytest.raises(SeenInPart):
            see(BAD["cells left out"](), comm)
