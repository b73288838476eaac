"""What an iteration sends and a rank holds: no reduction and no array that grows with the body.

Also run on 8 and 32 ranks, oversubscribed: 216 cells a rank.
"""

import math

import numpy as np
import pytest

from pdfem_mpi.body.cutting import cells_seen, share_of
from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.partitioning import partition
from pdfem_mpi.body.sight import see
from pdfem_mpi.kernels.exact_sums import SIZE
from pdfem_mpi.parallel.comm import largest, sum_integers, world
from pdfem_mpi.parallel.slabs import gather_rows
from pdfem_mpi.parallel.traffic import TRAFFIC, join
from pdfem_mpi.peridynamics.bond_forces import interior_halves
from pdfem_mpi.solvers.preconditioner.nested_grids import grid_counts, halved
from pdfem_mpi.solvers.preconditioner.preconditioner import make_preconditioner
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import bar_of_cubes, build
from support.counting import CountingComm
from support.helpers import assert_all

pytestmark = pytest.mark.mpi
#: Bytes of the largest reduction: exact sums of twelve dot products at the end of a step, of four in an iteration.
MOST_BYTES = 12 * 8 * SIZE


@pytest.mark.parametrize("coupled", [False, True], ids=["bonds", "coupled"])
def test_an_iteration_reduces_little_and_sends_to_neighbours(coupled):
    counted = CountingComm(world())
    body = build(bar_of_cubes(counted.size, 3 * counted.size if coupled else 0), counted)
    solve = make_solver(body.scene, body.share, body.forces, body.case, lambda text: None)
    counted.reset()
    TRAFFIC.clear()
    (row,) = follow_load_program(body.scene, solve, None, body.state, body.case)
    assert_all(counted, 0 < counted.largest <= MOST_BYTES, f"a reduction of {counted.largest} bytes")
    assert_all(counted, row.convergence.residual <= 1e-3)
    own = TRAFFIC.copy()
    same = own.sent_bytes, own.messages, own.reductions, own.largest_reduction
    assert_all(
        counted, same == (counted.sent, counted.calls["Isend"], counted.calls["Allreduce"], counted.largest), f"{same}"
    )
    found = join(counted, own, 1e3 + own.waited, row.convergence.evaluations)
    assert_all(counted, (found is None) == (counted.rank > 0 or counted.size == 1))
    assert_all(counted, found is None or (found["imbalance"] == 1.0 and found["messages_per_evaluation"]["mean"] > 1.0))


def test_an_iteration_of_conjugate_gradients_reduces_twice():
    """Its dot products with all votes on bounds, and the norm of the next residual: what more iterations add.

    Once in a solve its bounds are lowered to what was met, by one more.
    """
    counted, counts = CountingComm(world()), []
    for tolerance in (1e-2, 1e-6):
        body = build(bar_of_cubes(2, 6, tolerance), counted)
        solve = make_solver(body.scene, body.share, body.forces, body.case, lambda text: None)
        counted.reset()
        (row,) = follow_load_program(body.scene, solve, None, body.state, body.case)
        counts.append((row.convergence.evaluations, counted.calls["Allreduce"]))
    more, reductions = np.diff(counts, axis=0)[0]
    assert_all(counted, more >= 5 and reductions <= 2 * more + 1, f"{reductions} reductions for {more} iterations")


def test_forces_travel_while_interior_rows_are_swept():
    """As many of them come after the forces on ghosts were sent as before; all before, where the rank is alone."""
    comm = world()
    forces = build(bar_of_cubes(comm.size), comm, loaded=False).forces.of_bonds
    called = [getattr(phase, "func", phase).__name__ for _, phase in forces.phases(None, 0.0, np.zeros(2))]
    sent = called.index("start_reverse")
    assert_all(comm, called[sent:] == ["start_reverse", "_sweep"][: comm.size], f"{called}")
    start = forces.bonds.interior.start
    before, after = (int(start[part.stop] - start[part.start]) for part in interior_halves(forces))
    assert_all(comm, comm.size == 1 or 0.9 * after < before < 1.1 * after, f"{before} rows and {after}")


def test_a_small_coarse_grid_is_on_the_first_rank_alone():
    """Others know the grid nodes around their own nodes: as many on any number of ranks."""
    comm = world()
    body = build(bar_of_cubes(comm.size), comm)
    grid = make_preconditioner(body.share, body.model, body.case).grid
    whole = int(sum_integers(comm, np.array([grid.down[0].halo.n_owned]))[0])
    assert_all(comm, whole == np.prod(grid_counts(body.share)[0] + 1), f"{whole} grid nodes are owned")
    assert_all(comm, not grid.levels and (grid.last.factor is None) == (comm.rank > 0))
    seen = (6 // 2 + 3) * (6 // 2 + 1) ** 2  # of a cube, with the layer on each side
    assert_all(comm, comm.rank == 0 or grid.down[0].halo.n_ghost <= seen, f"{grid.down[0].halo.n_ghost} seen")


@pytest.mark.usefixtures("small_last_grids")
def test_levels_of_the_coarse_grid_are_dealt_out():
    """Each rank has the nodes of its part of the body, of coarser grids one rank in four, of the last the first."""
    comm = world()
    body = build(bar_of_cubes(comm.size), comm)
    grid = make_preconditioner(body.share, body.model, body.case).grid
    counts, n_halvings = grid_counts(body.share)
    assert_all(comm, len(grid.levels) == n_halvings)
    for k, level in enumerate(grid.levels):
        owned = len(level.nodes)
        whole = int(sum_integers(comm, np.array([owned]))[0])
        assert_all(comm, whole == np.prod(halved(counts, k) + 1), f"{whole} nodes of level {k} are owned")
        most = np.prod(halved(np.array([4, 4, 4]), k) + 1) * min(4**k, comm.size)
        assert_all(comm, owned <= most and (owned == 0 or comm.rank % 4**k == 0), f"{owned} nodes of level {k}")
    assert_all(comm, (len(grid.last.nodes) > 0) == (comm.rank == 0))


def test_shares_are_those_that_one_rank_would_cut():
    """Ranks share out the measuring of cells and the counting of neighbours: the same owners, the same quality."""
    comm = world()
    scene = bar_of_cubes(comm.size, 3 * comm.size)
    whole, share = discretize(scene), share_of(scene, comm)
    owner = partition(whole, comm.size)
    assert_all(comm, share.quality == whole.quality, f"{share.quality}")
    assert_all(comm, (share.cell_owner == owner[share.mesh.cell_id]).all(), "other owners")
    cells = gather_rows(comm, share.mesh.cell_id[share.is_owned], share.mesh.cell_id[share.is_owned], len(owner))
    assert_all(comm, cells is None or (cells == np.arange(len(owner))).all(), "cells without an owner")


@pytest.mark.mpi(min_size=2)
@pytest.mark.parametrize("coupled", [False, True], ids=["bonds", "coupled"])
def test_a_rank_makes_its_cells_and_those_around_them(coupled):
    """Of a bar, layers to both sides: within the cutoff radius, a cell more, and what overlap and nodes depend on."""
    comm = world()
    scene = bar_of_cubes(comm.size, 3 * comm.size if coupled else 0)
    sight = see(scene, comm)
    seen, own = len(sight.owner), np.count_nonzero(sight.owner == comm.rank)
    beside = 36 * (math.ceil(sight.body.cutoff + 1.0) + 3 + coupled)
    layers = own // 36 + 2  # a rank's cells may begin and end within a layer
    assert_all(comm, seen <= 36 * layers + 2 * beside, f"{seen} cells are made for {own}")
    (most,) = largest(comm, np.array([cells_seen(scene, comm)]))
    # what is foretold is of the mean; elements cost less, so that a rank of a coupled bar may have more cells
    assert_all(comm, most <= 2 * 6 * 36 + 2 * beside, f"{most} foretold")
    assert_all(comm, seen <= 1.5 * most * max(1.0, own / 216), f"{seen} seen, {most} foretold")
    (total,) = sum_integers(comm, np.array([own])).tolist()
    assert_all(comm, total == 216 * comm.size, f"{total} cells")
