"""Parts of the body do not depend on the number of ranks, nor on who owns what."""

import numpy as np
import pytest

from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.model.mechanisms import describe_motion
from pdfem_mpi.model.parts import describe_unsupported, find_parts, find_unsupported
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.parallel.slabs import gather_rows
from support.bodies import build, make_scene
from support.helpers import assert_all
from support.owners import deal_out_by

pytestmark = pytest.mark.mpi(min_size=2)


def torn(comm, n_elements):
    """A bar in three pieces, held at one end, from which single points come off as well."""
    polygons = [((x, -1.0, -1.0), (x, 4.0, -1.0), (x, 4.0, 4.0), (x, -1.0, 4.0)) for x in (6.0, 8.0)]
    support = Support(face="x-", x=0.0, y=0.0, z=0.0)
    cracks = tuple(Crack(polygon=polygon) for polygon in polygons)
    body = build(make_scene((10, 3, 2), n_elements, cracks=cracks, loads=(), supports=(support,)), comm)
    model = body.model
    number = 8 * np.repeat(model.points.cell_number, 8) + np.tile(np.arange(8), len(model.points.cell_number))
    lost = number % 37 == 0
    for rows in model.bonds.rows:  # both ends of a bond decide, so every rank cuts the same
        data, first = rows.data.reshape(-1, 4), np.repeat(np.arange(len(rows.start) - 1), np.diff(rows.start))
        other = rows.offset[: len(first)].astype(int)[:, None] // 9 + np.arange(4)
        data[: len(first)][lost[first][:, None] | lost[other]] = 0.0
    return body


def found(body):
    """Parts by cell in global order, and all that is said of them. Collective."""
    parts = find_parts(body.model)
    unsupported = find_unsupported(body.model, parts, body.case.fixed)
    points = body.model.points
    table = gather_rows(
        body.model.comm, body.share.free_row[body.share.subdomain.free],
        parts.of[: 8 * points.n_free].reshape(-1, 8), body.share.counts.free_cells,
    )  # fmt: skip
    motion = body.of_positions(lambda x: np.where(x[:, :1] > 2.0, x[:, [1, 0, 2]] * [-1.0, 1.0, 0.0], 0.0))
    told = [parts.count, describe_unsupported(parts, unsupported), describe_motion(body.model, motion)]
    return told + [part.motions.tolist() for part in unsupported], None if table is None else table.tolist()


@pytest.mark.parametrize("n_elements", [0, 4])
@pytest.mark.parametrize("owners", ["bisection", "random"])
def test_parts_are_the_same_on_any_number_of_ranks(comm, monkeypatch, owners, n_elements):
    expected, table = found(torn(mpi().COMM_SELF, n_elements))
    if owners == "random":
        deal_out_by(
            monkeypatch,
            lambda d, n, neighbours: np.random.default_rng(1).permutation(len(d.mesh.cells)).astype(np.int32) % n,
        )
    told, rows = found(torn(comm, n_elements))
    assert_all(comm, expected[0] > 3, "nothing came off")
    assert_all(comm, told == expected, "parts differ from those of one rank")
    assert_all(comm, rows is None or rows == table, "points are in other parts")
