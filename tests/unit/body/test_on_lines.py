"""Lines through elements, bonds and both: each stretch of a line has its length of a force, a spring or a support."""

import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.on_lines import share_line
from pdfem_mpi.body.selection import select_places
from pdfem_mpi.deck.loads import Force, Support
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.removals import RemovedBox
from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.mesh.generators import box
from pdfem_mpi.mesh.hexmesh import HexMesh
from support.bodies import make_scene

ROUND_OFF = 1e-13
BESIDE = 0.5 - 0.5 / np.sqrt(3.0)  # a row of points from the edge of its cells, along both axes across


def along(line, cells, n_elements=0, removed=(), regions=None):
    """Places and parts of a force on a line: of nodes, then of points."""
    scene = scene_of(
        cells, n_elements, removed, regions, loads=(Force(kind="force", line=line, total=(0.0, 1.0, 0.0)),)
    )
    body = discretize(scene)
    (chosen,) = select_places(scene, body).loads
    x = np.concatenate([body.mesh.nodes[chosen.nodes], points_of(body, chosen.points)])
    parts = np.concatenate([chosen.node_parts, chosen.point_parts])
    assert parts.sum() == pytest.approx(1.0, rel=ROUND_OFF)
    return x, parts, len(chosen.nodes)


def scene_of(cells, n_elements, removed=(), regions=None, **tables):
    mesh = BoxMesh(
        lower=(0.0, 0.0, 0.0),
        upper=tuple(map(float, cells)),
        spacing=1.0,
        remove=tuple(RemovedBox(kind="box", lower=lower, upper=upper) for lower, upper in removed),
    )
    return make_scene(cells, n_elements, mesh=mesh, regions=regions, **tables)


def points_of(body, points):
    return gauss_positions(body.mesh.nodes[body.mesh.cells[points[:, 0]]])[np.arange(len(points)), points[:, 1]]


STEP = ((0.0, 0.0, 0.0), (4.0, 1.0, 3.0))
EDGE = ((0.0, 1.0, 1.0), (8.0, 1.0, 1.0))


def test_a_line_along_a_step_in_bonds_is_loaded_as_a_whole():
    """One straight row, though cells at lower coordinates are along half of the line alone."""
    x, parts, n_nodes = along(EDGE, (8, 3, 3), removed=[STEP])
    assert n_nodes == 0
    np.testing.assert_allclose(parts, 1 / 16, rtol=ROUND_OFF)
    np.testing.assert_allclose(np.unique(np.floor(x[:, 0])), np.arange(8.0))
    np.testing.assert_allclose(x[:, 1:], [[1.0 + BESIDE, 1.0 - BESIDE]] * 16, rtol=ROUND_OFF)


def test_where_no_side_has_all_of_a_line_each_stretch_has_one():
    """The lower side goes first where both have as much of it, and the other has what is left."""
    removed = [((0.0, 0.0, 0.0), (4.0, 1.0, 3.0)), ((4.0, 1.0, 0.0), (8.0, 3.0, 1.0))]
    x, parts, _ = along(((0.0, 1.0, 0.0), (8.0, 1.0, 0.0)), (8, 3, 3), removed=removed)
    np.testing.assert_allclose(parts, 1 / 16, rtol=ROUND_OFF)
    np.testing.assert_allclose(np.unique(np.floor(x[:, 0])), np.arange(8.0))
    np.testing.assert_allclose(x[:, 1], np.where(x[:, 0] < 4.0, 1.0 + BESIDE, 1.0 - BESIDE), rtol=ROUND_OFF)


def test_a_roller_along_a_step_in_bonds_holds_all_of_the_line():
    roller = Support(line=((4.0, 1.0, 0.0), (4.0, 1.0, 3.0)), y=0.0)
    scene = scene_of((8, 4, 3), 0, [((0.0, 0.0, 0.0), (8.0, 1.0, 1.0))], supports=(roller,), loads=())
    body = discretize(scene)
    (chosen,) = select_places(scene, body).supports
    x = points_of(body, chosen.points)
    np.testing.assert_allclose(np.sort(x[:, 2]), np.arange(6) // 2 + np.tile([BESIDE, 1.0 - BESIDE], 3))
    np.testing.assert_allclose(x[:, :2], [[4.0 - BESIDE, 1.0 + BESIDE]] * 6, rtol=ROUND_OFF)


def test_a_line_across_elements_bonds_and_elements_is_loaded_evenly():
    """What is beyond a cut, and its moment about it, are those of an even load."""
    regions = (
        Region(name="a", model="finite_elements", upper=(4.0, 3.0, 3.0)),
        Region(name="b", model="peridynamics", lower=(4.0, 0.0, 0.0), upper=(14.0, 3.0, 3.0)),
        Region(name="c", model="finite_elements", lower=(14.0, 0.0, 0.0)),
    )
    x, parts, n_nodes = along(((0.0, 3.0, 0.0), (24.0, 3.0, 0.0)), (24, 3, 3), regions=regions)
    assert 0 < n_nodes < len(x)
    for cut in (0.5, 2.5, 6.0, 9.0, 12.0, 15.5, 20.5):  # between two nodes, or two cells of bonds
        assert parts[x[:, 0] > cut].sum() == pytest.approx((24.0 - cut) / 24.0, rel=ROUND_OFF)
    assert (parts * x[:, 0]).sum() == pytest.approx(12.0, rel=ROUND_OFF)
    assert (parts * x[:, 0] ** 2).sum() == pytest.approx(24.0**2 / 3.0, rel=1e-3)


@pytest.mark.parametrize("n_elements", [0, 8])
def test_what_a_line_passes_over_at_a_notch_nobody_has(n_elements):
    """Three cells on one side of the notch, two on the other: rims have half a cell, no more."""
    notch = ((3.0, 2.0, 0.0), (6.0, 3.0, 3.0))
    x, parts, _ = along(((0.0, 3.0, 1.0), (8.0, 3.0, 1.0)), (8, 3, 3), n_elements, [notch])
    order = np.argsort(x[:, 0])
    expected = np.array([1.0, 2.0, 2.0, 1.0, 1.0, 2.0, 1.0] if n_elements else [1.0] * 10) / 10.0
    np.testing.assert_allclose(parts[order], expected, rtol=ROUND_OFF)


def test_a_line_between_elements_and_bonds_is_that_of_the_nodes():
    """Points beside it would clamp a roller, and make a load turn."""
    x, parts, n_nodes = along(((3.0, 2.0, 0.0), (3.0, 2.0, 2.0)), (6, 2, 2), 3)
    assert n_nodes == len(x)
    np.testing.assert_allclose(parts, [0.25, 0.5, 0.25], rtol=ROUND_OFF)


def test_nodes_of_which_no_two_are_of_one_cell_have_half_of_the_ways_between():
    """A line at a slope of 1 : 2 through the faces of cells, on which it meets every second plane of nodes."""
    x, parts, _ = along(((0.0, 0.0, 1.0), (6.0, 3.0, 1.0)), (8, 3, 3), 8)
    np.testing.assert_allclose(x[:, 0], [0.0, 2.0, 4.0, 6.0])
    np.testing.assert_allclose(parts, np.array([1.0, 2.0, 2.0, 1.0]) / 6.0, rtol=ROUND_OFF)


@pytest.mark.parametrize("of_bonds", [(), (0,), (1,), (0, 1)])
def test_two_bodies_with_other_cells_on_a_line_share_it(of_bonds):
    """Blocks that touch without a common node, one in cells twice as long; each stretch counts once."""
    fine, coarse = box((0.0, 0.0, 0.0), (8.0, 1.0, 1.0), (8, 1, 1)), box((0.0, 1.0, 0.0), (8.0, 2.0, 1.0), (4, 1, 1))
    mesh = HexMesh(np.concatenate([fine.nodes, coarse.nodes]), np.concatenate([fine.cells, coarse.cells + 36]))
    free = np.isin(np.repeat([0, 1], [8, 4]), of_bonds)
    carries = np.zeros(len(mesh.nodes), bool)
    carries[mesh.cells[~free]] = True
    line = ((0.0, 1.0, 0.0), (8.0, 1.0, 0.0))
    on = (mesh.nodes[:, 1] == 1.0) & (mesh.nodes[:, 2] == 0.0)
    of_nodes, points, of_points = share_line(mesh, on, carries, free, line, 1e-3)
    assert of_nodes.sum() + of_points.sum() == pytest.approx(64.0, rel=ROUND_OFF)
    if of_bonds == ():
        np.testing.assert_allclose(of_nodes[:36][on[:36]].sum(), 32.0)
    assert (len(points) > 0) == (len(of_bonds) == 2)
    assert not of_nodes[~carries].any()


def test_a_line_that_is_along_no_edge_and_no_diagonal_of_bonds_is_told():
    """It meets nodes, which bonds have not. A diagonal of cells serves, and so does the same line in elements."""
    oblique = ((0.0, 0.0, 2.0), (4.0, 2.0, 2.0))
    scene = scene_of((4, 4, 2), 0, loads=(Force(kind="force", line=oblique, total=(0.0, 0.0, 1.0)),))
    chosen = select_places(scene, discretize(scene))
    assert "loads.0.line has no peridynamic point along it" in chosen.problems["loads"][0][0]
    assert along(((0.0, 0.0, 2.0), (4.0, 4.0, 2.0)), (4, 4, 2))[2] == 0
    assert along(oblique, (4, 4, 2), n_elements=4)[2] == 3
