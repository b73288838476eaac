"""Many more ranks than cores: sums, sizes, a solution and a tear are those of one rank. Also run on 8 and 32 ranks."""

import numpy as np
import pytest

from pdfem_mpi.measure.fields import fields_sha256
from pdfem_mpi.parallel.comm import broadcast, mpi, sum_integers, world
from pdfem_mpi.peridynamics.bonds import total_bonds
from pdfem_mpi.solvers.preconditioner import nested_grids
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import build, make_scene
from support.failing import followed, numbers, strip
from support.helpers import assert_all

pytestmark = pytest.mark.mpi
#: 32 cells: a rank of 32 owns one of them, elements or points or both.
SCENE = make_scene((8, 2, 2), 4, correction="none", solver="adr", tolerance=0.5)


def solved(comm, scene=SCENE):
    """Numbers of bonds and unknowns, evaluations, and the digest of the fields (of rank 0 on all)."""
    body = build(scene, comm)
    solve = make_solver(body.scene, body.share, body.forces, body.case, lambda text: None)
    (row,) = follow_load_program(body.scene, solve, None, body.state, body.case)
    fields = body.fields(body.state.u)
    owned = int(sum_integers(comm, np.array([body.model.n_unknowns]))[0])
    digest = broadcast(comm, fields_sha256(fields) if comm.rank == 0 else None)
    return total_bonds(comm, body.model.bonds), owned, body.forces.evaluations, row.convergence.residual, digest


def test_a_solution_on_many_ranks_is_that_of_one():
    comm = world()
    together = solved(comm)
    alone = broadcast(comm, solved(mpi().COMM_SELF) if comm.rank == 0 else None)
    assert_all(comm, together == alone, f"{together} where one rank has {alone}")


@pytest.mark.parametrize("most", [100, 30])
def test_nested_grids_on_many_ranks_are_those_of_one(monkeypatch, most):
    """Rows of a grid lie with their owners, ranks without any among them; the last grid has eight nodes."""
    monkeypatch.setattr(nested_grids, "MOST_UNKNOWNS", most)
    comm = world()
    scene = make_scene((12, 3, 3), 5, correction="none", solver="cg", tolerance=1e-6)
    together = solved(comm, scene)
    alone = broadcast(comm, solved(mpi().COMM_SELF, scene) if comm.rank == 0 else None)
    assert_all(comm, together == alone and together[2] < 40, f"{together} where one rank has {alone}")


def test_integers_are_summed_exactly_over_all_ranks():
    comm = world()
    large = 2**62 // comm.size
    found = sum_integers(comm, np.array([comm.rank, large - comm.rank, 1]))
    expected = [comm.size * (comm.size - 1) // 2, comm.size * large - comm.size * (comm.size - 1) // 2, comm.size]
    assert_all(comm, found.tolist() == expected, str(found))


ROWS = 4


def torn(comm):
    """First rows of a coupled strip of another ratio behind a mirror plane, and its broken bonds. Collective."""
    scene = strip(poissons_ratio=0.4, elements=2, report_every=1)  # 48 cells
    mesh = scene.mesh.model_copy(update={"symmetry": ("z-",)})
    run = followed(scene.model_copy(update={"mesh": mesh}), ROWS, comm)
    pairs = np.concatenate(run.body.model.comm.allgather(run.failure.broken_pairs()))
    return [numbers(row) for row in run.rows], sorted(map(tuple, pairs.tolist()))


def test_bonds_of_another_ratio_break_on_many_ranks_as_on_one():
    comm = world()
    rows, pairs = torn(comm)
    expected, broken = broadcast(comm, torn(mpi().COMM_SELF) if comm.rank == 0 else None)
    assert_all(comm, rows == expected and len(rows) == ROWS, "rows differ from those of one rank")
    assert_all(comm, pairs == broken and len(pairs) == rows[-1]["broken"] > 0, "other bonds broke than on one rank")
