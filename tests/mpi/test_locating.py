"""Ranks that see parts of a mesh find the cells that one rank finds which sees all of it, in every bit."""

from dataclasses import replace

import numpy as np
import pytest

from pdfem_mpi.body.locating import locate
from pdfem_mpi.mesh.everywhere import Everywhere
from pdfem_mpi.mesh.part import take_part
from support.helpers import assert_all
from support.mixed_cells import MESHES, body_of, places_in

pytestmark = pytest.mark.mpi(min_size=2)


def of_part(mesh, has_nodes, owner, comm):
    """The body of a rank's own cells and those that share nodes with them."""
    seen = mesh.neighbours(owner == comm.rank)
    part = take_part(mesh, seen)
    return body_of(replace(part, everywhere=Everywhere(comm, owner[seen] == comm.rank)), has_nodes[seen])


@pytest.mark.parametrize("dealt", ["by height", "anyhow"])
@pytest.mark.parametrize("name", MESHES)
def test_the_same_cells_hold_a_place_on_any_ranks(comm, name, dealt):
    """Within the body, on faces between its cells, and outside; the holder and the nearest middle on other ranks."""
    mesh = MESHES[name]()
    rng = np.random.default_rng(3)
    n = len(mesh.cells)
    order = np.argsort(mesh.centroids[:, 1], kind="stable") if dealt == "by height" else rng.permutation(n)
    owner = np.empty(n, int)
    owner[order] = np.arange(n) * comm.size // n
    has_nodes = mesh.centroids[:, 0] < 3.0
    whole, part = body_of(mesh, has_nodes), of_part(mesh, has_nodes, owner, comm)
    _, inside = places_in(mesh, 40, 4)
    beyond = mesh.lower + rng.uniform(-0.2, 1.2, (15, 3)) * (mesh.upper - mesh.lower)
    wrong, crossing = [], 0
    for place in np.concatenate([inside, mesh.nodes[::9], beyond]):
        (holders, outside), (expected, distance) = locate(part, place), locate(whole, place)
        crossing += owner[expected[0].cell] != owner[mesh.boxes.nearest(place)[1]]
        same = outside == distance and len(holders) == len(expected)
        for one, other in zip(holders, expected, strict=False):
            same &= one.cell == other.cell and one.outside == other.outside
            same &= np.array_equal(one.coordinates, other.coordinates) and np.array_equal(one.nodes, other.nodes)
        if not same:
            wrong.append((place, holders, expected))
    assert_all(comm, not wrong, f"{wrong[:1]}")
    assert_all(comm, crossing > 0 or comm.size == 1 or dealt != "anyhow")
