"""Failure of positive fitted bonds beside an exact coupling: the same bits on any ranks, stopped or not."""

from unittest.mock import patch

import pytest

from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.programs import Events
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import YOUNGS_MODULUS, build, make_scene
from support.failing import numbers
from support.helpers import assert_all
from support.notched import notched
from support.restarts import StopAt, alone, differing, go, outcome

pytestmark = pytest.mark.mpi(min_size=2)

FINISHED, STOPPED = 0, 75
ROWS = 8
EDGE = ((5.0, -1.0, -1.0), (5.0, 1.01, -1.0), (5.0, 1.01, 3.0), (5.0, -1.0, 3.0))


def cracked(kinematics="linear"):
    """A coupled strip two cells thick with an edge crack, pulled by events until it loses a fifth of its load."""
    scene = make_scene(
        (7, 3, 2),
        2,
        kinematics=kinematics,
        correction="fitted",
        signs="bounded",
        coupling="exact",
        loads=(),
        supports=(Support(face="x-", x=0.0, y=0.0, z=0.0), Support(face="x+", layers=1, x=0.25)),
        solver="cg",
        cracks=(Crack(polygon=EDGE),),
        output=Output(figures=False, fields=False),
    )
    breaking = Material(youngs_modulus=YOUNGS_MODULUS, critical_stretch=0.02)
    stepping = Events(kind="events", eta=1e-2, inner_iterations=4, report_every=5, end_reaction=0.8)
    return Scene.model_validate({**dict(scene), "material": breaking, "stepping": stepping})


def events(comm, kinematics):
    """The first rows, and the broken bonds of all ranks. Collective."""
    body = build(cracked(kinematics), comm)
    failure = make_failure(body.scene, body.share, body.model)
    solver = make_solver(body.scene, body.share, body.forces, body.case, print)
    program = follow_load_program(body.scene, solver, failure, body.state, body.case)
    rows = [numbers(row) for _, row in zip(range(ROWS), program, strict=False)]
    return rows, sorted(pair for part in comm.allgather(failure.broken_pairs().tolist()) for pair in part)


@pytest.mark.parametrize("kinematics", ["linear", pytest.param("finite", marks=pytest.mark.slow)])
def test_events_do_not_depend_on_the_number_of_ranks(comm, kinematics):
    """Every row, and every bond that broke."""
    rows, pairs = events(comm, kinematics)
    expected = events(mpi().COMM_SELF, kinematics)
    assert_all(comm, rows == expected[0] and len(rows) == ROWS, "rows differ from those of one rank")
    assert_all(comm, pairs == expected[1] and len(pairs) > 0, "other bonds broke than on one rank")


@pytest.mark.parametrize(
    ("kinematics", "length"),
    [("linear", 55), *(pytest.param(*case, marks=pytest.mark.slow) for case in (("linear", 25), ("finite", 9)))],
)
def test_starts_on_other_ranks_without_the_fit(mpi_tmp_path, kinematics, length):
    """Stopped within avalanches, gone on with on other ranks; every other start but the first finds no fit."""
    world, folder = mpi().COMM_WORLD, mpi_tmp_path / "run"
    scene, fits = cracked(kinematics), []
    with patch("pdfem_mpi.runs.run.fit_folders", lambda out: (out,)):  # the user's cache knows those of other tests
        expected = None
        if world.rank == 0:
            straight = folder.with_name("straight")
            assert alone(scene, straight) == FINISHED
            expected = outcome(straight)
        for start in range(100):
            n = 1 + (start + 1) % world.size
            group = world.Split(int(world.rank >= n))
            code = None
            if world.rank < n:
                requests = StopAt(length, group.rank == group.size - 1)
                code = go(scene, group, folder, requests=requests)
            group.Free()
            world.Barrier()
            code = world.bcast(code)
            if world.rank == 0:
                found = list(folder.glob("bond_factors-*.npz"))
                fits.append(len(found))
                for path in found if start % 2 else ():
                    path.unlink()
            world.Barrier()
            if code != STOPPED:
                break
    assert_all(world, code == FINISHED and start >= 2, f"ended with {code} after {start} stops")
    different = differing(outcome(folder), expected) if world.rank == 0 else []
    assert_all(world, not different, f"{different}")
    assert_all(world, world.rank > 0 or min(fits) == 1, f"a fit was not left behind: {fits}")


def test_a_part_between_mirror_planes_goes_on_on_other_ranks(mpi_tmp_path):
    """An eighth of a notched plate, stopped within avalanches, with bonds to images among those that broke."""
    world, folder = mpi().COMM_WORLD, mpi_tmp_path / "run"
    quick = {"stepping": Events(kind="events", eta=1e-2, inner_iterations=4, end_reaction=0.8)}
    scene = notched(("x-", "y-", "z-")).model_copy(update={"output": Output(figures=False, fields=False)} | quick)
    expected = None
    if world.rank == 0:
        assert alone(scene, folder.with_name("straight")) == FINISHED
        expected = outcome(folder.with_name("straight"))
    for start in range(100):
        n = 1 + (start + 1) % world.size
        group, code = world.Split(int(world.rank >= n)), None
        if world.rank < n:
            code = go(scene, group, folder, requests=StopAt(80, group.rank == group.size - 1))
        group.Free()
        world.Barrier()
        code = world.bcast(code)
        if code != STOPPED:
            break
    assert_all(world, code == FINISHED and start >= 1, f"ended with {code} after {start} stops")
    different = differing(outcome(folder), expected) if world.rank == 0 else []
    assert_all(world, not different, f"{different}")
