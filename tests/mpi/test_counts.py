"""What ranks send and hold, on 8 and on 32 of them, oversubscribed: 216 cells a rank. By default, as they are few."""

from time import sleep

import numpy as np
import pytest

from pdfem_mpi.kernels.exact_sums import SIZE
from pdfem_mpi.parallel.comm import broadcast, sum_integers, world
from pdfem_mpi.parallel.traffic import TRAFFIC, join
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import build, make_scene
from support.helpers import assert_all
from support.walking import entries_by_path

pytestmark = pytest.mark.mpi
#: Cubes of 8 and 32 ranks along x, y and z.
BLOCKS = {8: (2, 2, 2), 32: (4, 4, 2)}
#: What a rank sends at most, in the mean of ranks and evaluations: messages and KiB.
MOST_SENT = {
    ("cg", 8): (24, 125), ("cg", 32): (40, 200),
    ("cg, half elements", 8): (25, 95), ("cg, half elements", 32): (40, 200),
    ("adr", 8): (12, 120), ("adr", 32): (18, 160),
}  # fmt: skip
#: Rows of the busiest rank over the mean.
BALANCED = {"cg": 1.05, "cg, half elements": 1.2, "adr": 1.05}
#: Bytes of the largest reduction: exact sums of twelve dot products at the end of a step, of four in an iteration.
MOST_BYTES = 12 * 8 * SIZE


@pytest.mark.parametrize("case", BALANCED)
def test_ranks_of_a_block_send_little_and_share_the_rows_evenly(case, record_property):
    """Also to those at edges and corners: half of those messages go one way."""
    comm = world()
    if comm.size not in BLOCKS:
        pytest.skip("a block of cubes has 8 or 32 of them")
    cells, solver = tuple(6 * n for n in BLOCKS[comm.size]), case[: case.find(",")] if "," in case else case
    n_elements = cells[0] // 2 if "elements" in case else 0
    tolerance = {"cg": 1e-3, "adr": 0.3}[solver]
    body = build(make_scene(cells, n_elements, correction="none", solver=solver, tolerance=tolerance), comm)
    solve = make_solver(body.scene, body.share, body.forces, body.case, lambda text: None)
    TRAFFIC.clear()
    (row,) = follow_load_program(body.scene, solve, None, body.state, body.case)
    found = broadcast(comm, join(comm, TRAFFIC.copy(), 1e3, row.convergence.evaluations))
    sent = found["messages_per_evaluation"]["mean"], found["bytes_per_evaluation"]["mean"] / 2**10
    most = MOST_SENT[case, comm.size]
    record_property("messages and KiB", sent)
    assert_all(comm, sent[0] <= most[0] and sent[1] <= most[1], f"{sent} messages and KiB, {most} at most")
    assert_all(comm, found["largest_reduction_bytes"] <= MOST_BYTES, f"{found}")
    rows = sum(len(part.offset) - 1 for part in body.model.bonds.rows)
    uneven = rows * comm.size / int(sum_integers(comm, np.array([rows]))[0])
    assert_all(comm, uneven <= BALANCED[case], f"{uneven} times the mean of the rows")


def walked(ranks, n_elements, comm):
    """Entries of the arrays of a body of so many cubes on as many ranks, the largest at each path. Collective."""
    cells = SMALL * ranks, SMALL, SMALL
    body = build(make_scene(cells, n_elements * ranks, correction="none", solver="cg", tolerance=0.1), comm)
    solve = make_solver(body.scene, body.share, body.forces, body.case, lambda text: None)
    list(follow_load_program(body.scene, solve, None, body.state, body.case))
    found = entries_by_path(share=body.share, forces=body.forces, case=body.case, state=body.state, solve=solve)
    table = {}
    for own in comm.allgather(found):
        for path, n in own.items():
            table[path] = max(n, table.get(path, 0))
    return table


def wait_asleep(comm):
    """Until all are here. Who waits in MPI takes turns with who works, on fewer cores than ranks. Collective."""
    over = comm.Ibarrier()
    while not over.Test():
        sleep(0.02)


def at(path, table):
    """Entries at a path or, where there is none, the most at those that begin like it: a slice takes a list's place."""
    while path and path not in table:
        path = path[: max(path.rfind("."), path.rfind("["), 0)]
        inside = [n for other, n in table.items() if other.startswith(path)]
        if inside:
            return max(inside)
    return table.get(path, 0)


#: Cells along an edge of a rank's cube in a row: more than the cutoff radius, so that a rank has bonds beside it only.
SMALL = 4
#: Paths whose arrays may grow: the last grid, which has so many unknowns at most, and what is in it.
WHOLE = ".last."
#: Entries of arrays whose number says nothing about the body: numbers of ranks, of materials, of loads.
FEW = 64
#: Buffers for nodes of others. A rank of a row owns the nodes on none, one or both of its ends, and of four ranks none
#: has those of both from others: from 4 to 8 ranks they may double, and from 8 to 32 grow as little as all else.
ENDS = ".nodes.halo._buffers"


@pytest.mark.usefixtures("small_last_grids")
@pytest.mark.parametrize("n_elements", [0, SMALL], ids=["bonds", "elements"])
def test_no_array_grows_with_the_body(n_elements):
    """Of 8 and 32 ranks in a row, and of 4 and 8, with as many cells each: at most 1.5 times the entries."""
    everyone = world()
    if everyone.size < 8:
        pytest.skip("inner ranks of a row are alike from four ranks on")
    few = max(everyone.size // 4, 4)
    group = everyone.Split(int(everyone.rank >= few))
    smaller = walked(few, n_elements, group) if everyone.rank < few else {}
    group.Free()
    wait_asleep(everyone)
    larger = walked(everyone.size, n_elements, everyone)
    smaller = broadcast(everyone, smaller)
    limits = {path: (2.0 if few == 4 and ENDS in path else 1.5) * at(path, smaller) + FEW for path in larger}
    grown = {path: (at(path, smaller), n) for path, n in larger.items() if n > limits[path]}
    assert_all(everyone, len(larger) > 100, f"{len(larger)} arrays were found")
    assert_all(everyone, not [path for path in grown if WHOLE not in path], f"{grown}")
