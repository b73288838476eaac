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
from pdfem_mpi.parallel.comm import broadcast, largest, sum_integers, world
from pdfem_mpi.parallel.slabs import gather_rows
from pdfem_mpi.parallel.traffic import TRAFFIC, join
from pdfem_mpi.peridynamics.bond_forces import interior_halves
from pdfem_mpi.solvers.preconditioner import nested_grids
from pdfem_mpi.solvers.preconditioner.nested_grids import grid_counts, halved
from pdfem_mpi.solvers.preconditioner.preconditioner import make_preconditioner
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import build, make_scene
from support.counting import CountingComm
from support.helpers import assert_all
from support.walking import entries_by_path

pytestmark = pytest.mark.mpi
#: Bytes of the largest reduction: exact sums of twelve dot products at the end of a step, of four in an iteration.
MOST_BYTES = 12 * 8 * SIZE
#: Entries of arrays whose number says nothing about the body: numbers of ranks, of materials, of loads.
FEW = 64


def scene_of(ranks, n_elements=0, tolerance=1e-3):
    """A bar of cubes of 6 x 6 x 6 cells."""
    return make_scene((6 * ranks, 6, 6), n_elements, correction="none", solver="cg", tolerance=tolerance)


@pytest.mark.parametrize("coupled", [False, True], ids=["bonds", "coupled"])
def test_an_iteration_reduces_little_and_sends_to_neighbours(coupled):
    counted = CountingComm(world())
    body = build(scene_of(counted.size, 3 * counted.size if coupled else 0), counted)
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
        body = build(scene_of(2, 6, tolerance), counted)
        solve = make_solver(body.scene, body.share, body.forces, body.case, lambda text: None)
        counted.reset()
        (row,) = follow_load_program(body.scene, solve, None, body.state, body.case)
        counts.append((row.convergence.evaluations, counted.calls["Allreduce"]))
    more, reductions = np.diff(counts, axis=0)[0]
    assert_all(counted, more >= 5 and reductions <= 2 * more + 1, f"{reductions} reductions for {more} iterations")


def test_forces_travel_while_interior_rows_are_swept():
    """As many of them come after the forces on ghosts were sent as before; all before, where the rank is alone."""
    comm = world()
    forces = build(scene_of(comm.size), comm, loaded=False).forces.of_bonds
    called = [getattr(phase, "func", phase).__name__ for _, phase in forces.phases(None, 0.0, np.zeros(2))]
    sent = called.index("start_reverse")
    assert_all(comm, called[sent:] == ["start_reverse", "_sweep"][: comm.size], f"{called}")
    start = forces.bonds.interior.start
    before, after = (int(start[part.stop] - start[part.start]) for part in interior_halves(forces))
    assert_all(comm, comm.size == 1 or 0.9 * after < before < 1.1 * after, f"{before} rows and {after}")


#: Cubes of 8 and 32 ranks along x, y and z, and what a rank sends at most, in the mean of ranks and evaluations:
#: messages and KiB. Found were 25.1 and 121 of 8 ranks with cg, 10.7 and 103 with adr, and of 32 ranks 36.9 and 165,
#: 16.2 and 138.
BLOCKS = {8: (2, 2, 2), 32: (4, 4, 2)}
MOST_SENT = {("cg", 8): (27, 140), ("cg", 32): (40, 200), ("adr", 8): (12, 120), ("adr", 32): (18, 160)}
#: Rows of the busiest rank over the mean: 1.007 to 1.038 were found.
BALANCED = 1.05


@pytest.mark.parametrize("solver", ["cg", "adr"])
def test_ranks_of_a_block_send_little_and_share_the_rows_evenly(solver):
    """Also to those at edges and corners: half of those messages go one way."""
    comm = world()
    if comm.size not in BLOCKS:
        pytest.skip("a block of cubes has 8 or 32 of them")
    cells, tolerance = tuple(6 * n for n in BLOCKS[comm.size]), {"cg": 1e-3, "adr": 0.3}[solver]
    body = build(make_scene(cells, 0, correction="none", solver=solver, tolerance=tolerance), comm)
    solve = make_solver(body.scene, body.share, body.forces, body.case, lambda text: None)
    TRAFFIC.clear()
    (row,) = follow_load_program(body.scene, solve, None, body.state, body.case)
    found = broadcast(comm, join(comm, TRAFFIC.copy(), 1e3, row.convergence.evaluations))
    sent = found["messages_per_evaluation"]["mean"], found["bytes_per_evaluation"]["mean"] / 2**10
    most = MOST_SENT[solver, comm.size]
    assert_all(comm, sent[0] <= most[0] and sent[1] <= most[1], f"{sent} messages and KiB, {most} at most")
    rows = sum(len(part.offset) - 1 for part in body.model.bonds.rows)
    uneven = rows * comm.size / int(sum_integers(comm, np.array([rows]))[0])
    assert_all(comm, uneven <= BALANCED, f"{uneven} times the mean of the rows")


def test_a_small_coarse_grid_is_on_the_first_rank_alone():
    """Others know the grid nodes around their own nodes: as many on any number of ranks."""
    comm = world()
    body = build(scene_of(comm.size), comm)
    grid = make_preconditioner(body.share, body.model, body.case).grid
    whole = int(sum_integers(comm, np.array([grid.down[0].halo.n_owned]))[0])
    assert_all(comm, whole == np.prod(grid_counts(body.share)[0] + 1), f"{whole} grid nodes are owned")
    assert_all(comm, not grid.levels and (grid.last.factor is None) == (comm.rank > 0))
    seen = (6 // 2 + 3) * (6 // 2 + 1) ** 2  # of a cube, with the layer on each side
    assert_all(comm, comm.rank == 0 or grid.down[0].halo.n_ghost <= seen, f"{grid.down[0].halo.n_ghost} seen")


@pytest.fixture
def small_last_grids(monkeypatch):
    """Grids have several levels, as those of large bodies."""
    monkeypatch.setattr(nested_grids, "MOST_UNKNOWNS", 300)


@pytest.mark.usefixtures("small_last_grids")
def test_levels_of_the_coarse_grid_are_dealt_out():
    """Each rank has the nodes of its part of the body, of coarser grids one rank in four, of the last the first."""
    comm = world()
    body = build(scene_of(comm.size), comm)
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


def walked(ranks, n_elements, comm):
    """Entries of the arrays of a body of so many cubes on as many ranks, the largest at each path. Collective."""
    body = build(scene_of(ranks, n_elements * ranks, tolerance=0.1), comm)
    solve = make_solver(body.scene, body.share, body.forces, body.case, lambda text: None)
    list(follow_load_program(body.scene, solve, None, body.state, body.case))
    found = entries_by_path(share=body.share, forces=body.forces, case=body.case, state=body.state, solve=solve)
    table = {}
    for own in comm.allgather(found):
        for path, n in own.items():
            table[path] = max(n, table.get(path, 0))
    return table


def at(path, table):
    """Entries at a path or, where there is none, the most at those that begin like it: a slice takes a list's place."""
    while path and path not in table:
        path = path[: max(path.rfind("."), path.rfind("["), 0)]
        inside = [n for other, n in table.items() if other.startswith(path)]
        if inside:
            return max(inside)
    return table.get(path, 0)


#: Paths whose arrays may grow: the last grid, which has so many unknowns at most, and what is in it.
WHOLE = ".last."
#: Between two others a rank owns the nodes on none, one or both of its ends: ghosts of both only exist in longer rows.
ENDS = ".nodes.halo._buffers"


@pytest.mark.usefixtures("small_last_grids")
@pytest.mark.parametrize("n_elements", [0, 6], ids=["bonds", "elements"])
def test_no_array_grows_with_the_body(n_elements):
    """Those of four times, or twice, the ranks with as many cells each have at most 1.5 times the entries.

    Ghosts of nodes may have twice as many between four and eight ranks, and no more on 32.
    """
    everyone = world()
    if everyone.size < 8:
        pytest.skip("inner ranks of a row are alike from four ranks on")
    few = max(everyone.size // 4, 4)
    group = everyone.Split(int(everyone.rank >= few))
    smaller = walked(few, n_elements, group) if everyone.rank < few else {}
    group.Free()
    larger = walked(everyone.size, n_elements, everyone)
    smaller = broadcast(everyone, smaller)
    limits = {path: (2.0 if ENDS in path else 1.5) * at(path, smaller) + FEW for path in larger}
    grown = {path: (at(path, smaller), n) for path, n in larger.items() if n > limits[path]}
    assert_all(everyone, len(larger) > 100, f"{len(larger)} arrays were found")
    assert_all(everyone, not [path for path in grown if WHOLE not in path], f"{grown}")


def test_shares_are_those_that_one_rank_would_cut():
    """Ranks share out the measuring of cells and the counting of neighbours: the same owners, the same quality."""
    comm = world()
    scene = scene_of(comm.size, 3 * comm.size)
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
    scene = scene_of(comm.size, 3 * comm.size if coupled else 0)
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
