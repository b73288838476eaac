"""Structured meshes: topology, conformity, symmetry and grading of the plate with a hole; quality of cells."""

import math

import numpy as np
import pytest

from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.kernels.hex8 import gauss_volumes
from pdfem_mpi.mesh.generators import box, plate_with_hole
from pdfem_mpi.mesh.hexmesh import FACES, HexMesh
from pdfem_mpi.mesh.quality import measure

ROUND_OFF = 1e-12  # of coordinates of order 1, and of sums of some thousand volumes
PAPER = (-4.5, -1.5, -0.1), (4.5, 1.5, 0.1), 0.4  # sec. 4.2, in

# Plates from the corner 0: cells along x, y and z, radius in cells. Odd counts, odd beside even, an offset, the
# smallest hole and the narrowest ligament that decks may ask for, and two rings at the hole.
PLATES = {
    "even": ((24, 16, 2), 4.0),
    "odd": ((25, 17, 1), 4.3),
    "odd by even": ((21, 24, 3), 5.0),
    "smallest hole": ((12, 13, 1), 2.0),
    "narrow": ((40, 20, 1), 8.0),
    "two rings": ((60, 50, 1), 14.0),
}
SMALLEST_JACOBIAN = 0.8  # measured: .84 to .95; .5 would do for elements and points
GRADED = (0.15, 1.5)  # edges over spacing, measured: .19 (smallest hole) to 1.48 (narrow)
ROOMY = {"even", "odd", "two rings"}
ROOMY_GRADED = (0.4, 1.4)


@pytest.fixture(scope="module", params=PLATES)
def plate(request):
    """Name, mesh of unit spacing, cells, radius."""
    n_cells, radius = PLATES[request.param]
    return request.param, plate_with_hole((0.0, 0.0, 0.0), tuple(map(float, n_cells)), radius, 1.0), n_cells, radius


def faces_of(mesh):
    """All faces of all cells, nodes sorted, and how many cells share each."""
    return np.unique(np.sort(mesh.cells[:, FACES].reshape(-1, 4), axis=1), axis=0, return_counts=True)


def n_edges(mesh):
    pairs = [(0, 1), (1, 2), (2, 3), (3, 0), (4, 5), (5, 6), (6, 7), (7, 4), (0, 4), (1, 5), (2, 6), (3, 7)]
    return len(np.unique(np.sort(mesh.cells[:, pairs].reshape(-1, 2), axis=1), axis=0))


def on_circle(mesh, n_cells, radius):
    distance = np.hypot(mesh.nodes[:, 0] - n_cells[0] / 2, mesh.nodes[:, 1] - n_cells[1] / 2)
    return np.abs(distance - radius) <= ROUND_OFF * radius


def test_faces_are_shared_by_two_cells_or_lie_on_the_boundary(plate):
    """Conforming: no hanging node, no cell twice; every face of one cell lies on the box or on the hole."""
    _, mesh, n_cells, radius = plate
    faces, count = faces_of(mesh)
    assert set(count) == {1, 2}
    corners = mesh.nodes[faces[count == 1]]
    on_box = [
        (np.abs(corners[:, :, d] - value) <= ROUND_OFF).all(axis=1) for d in range(3) for value in (0.0, n_cells[d])
    ]
    on_hole = on_circle(mesh, n_cells, radius)[faces[count == 1]].all(axis=1)
    assert (np.sum([*on_box, on_hole], axis=0) == 1).all()


def test_boundary_is_closed(plate):
    """Each edge of the boundary belongs to two boundary faces."""
    _, mesh, _, _ = plate
    every = mesh.cells[:, FACES].reshape(-1, 4)
    _, where, count = np.unique(np.sort(every, axis=1), axis=0, return_inverse=True, return_counts=True)
    boundary = every[count[where.reshape(-1)] == 1]
    edges = np.sort(np.concatenate([boundary[:, [k, (k + 1) % 4]] for k in range(4)]), axis=1)
    assert set(np.unique(edges, axis=0, return_counts=True)[1]) == {2}


def test_euler_characteristic_of_a_body_with_one_hole(plate):
    """V - E + F - C = 0 for a solid ring (1 for a solid without a hole); every node belongs to a cell."""
    _, mesh, _, _ = plate
    assert np.array_equal(np.unique(mesh.cells), np.arange(len(mesh.nodes)))
    assert len(mesh.nodes) - n_edges(mesh) + len(faces_of(mesh)[0]) - len(mesh.cells) == 0


def test_no_two_nodes_share_a_place(plate):
    _, mesh, _, _ = plate
    assert len(np.unique(np.rint(mesh.nodes / 1e-6), axis=0)) == len(mesh.nodes)


def test_hole_is_a_regular_polygon_on_the_circle(plate):
    """All nodes of the hole lie on the circle at equal angles, once per layer of nodes."""
    _, mesh, n_cells, radius = plate
    hole = mesh.nodes[on_circle(mesh, n_cells, radius)]
    in_plane = hole[hole[:, 2] == 0.0]
    angle = np.sort(np.arctan2(in_plane[:, 1] - n_cells[1] / 2, in_plane[:, 0] - n_cells[0] / 2))
    assert len(hole) == len(in_plane) * (n_cells[2] + 1)
    np.testing.assert_allclose(np.diff(angle), 2 * math.pi / len(angle), rtol=0, atol=ROUND_OFF)


def test_volume_is_that_of_the_box_less_the_polygon(plate):
    """A polygon of N corners on the circle has the area N r^2 sin(2 pi / N) / 2."""
    _, mesh, n_cells, radius = plate
    sides = np.count_nonzero(on_circle(mesh, n_cells, radius)) // (n_cells[2] + 1)
    polygon = 0.5 * sides * radius**2 * math.sin(2 * math.pi / sides)
    exact = math.prod(n_cells) - n_cells[2] * polygon
    assert math.fsum(gauss_volumes(mesh.nodes[mesh.cells]).reshape(-1)) == pytest.approx(exact, rel=ROUND_OFF)


def test_quality_and_grading(plate):
    name, mesh, _, _ = plate
    quality = measure(mesh)
    low, high = ROOMY_GRADED if name in ROOMY else GRADED
    assert quality.smallest_scaled_jacobian >= SMALLEST_JACOBIAN
    assert low <= quality.shortest_edge and quality.longest_edge <= high
    assert quality.smallest_gauss_volume > 0.0


def test_far_cells_are_the_regular_grid(plate):
    """Beyond max(2 radii, radius + 5 cells) from the centre nodes are those of the box, to round-off."""
    _, mesh, n_cells, radius = plate
    reach = max(2.0 * radius, radius + 5.0) + 1.0
    offset = np.abs(mesh.nodes[:, :2] - np.array(n_cells[:2]) / 2)
    far = mesh.nodes[(offset >= reach).any(axis=1)]
    np.testing.assert_allclose(far, np.rint(far), rtol=0, atol=ROUND_OFF)
    edge = np.isin(mesh.nodes, (0.0, *map(float, n_cells))).any(axis=1)
    assert np.count_nonzero(edge) >= 2 * (n_cells[0] + n_cells[1])  # the plate's edges are exact


def test_layers_through_the_thickness_are_alike(plate):
    _, mesh, n_cells, _ = plate
    layers = mesh.nodes.reshape(n_cells[2] + 1, -1, 3)
    for k, layer in enumerate(layers):
        np.testing.assert_array_equal(layer[:, :2], layers[0, :, :2])
        assert (layer[:, 2] == k).all()


@pytest.mark.parametrize("axis", [0, 1])
@pytest.mark.parametrize("spacing", [0.1, 0.05])
def test_mirror_images_of_the_papers_plate_have_the_same_bits(axis, spacing):
    """About the centre 0: x -> -x and y -> -y give the same set of coordinates, bit for bit."""
    nodes = plate_with_hole(*PAPER, spacing).nodes
    mirrored = nodes.copy()
    mirrored[:, axis] *= -1.0
    nodes, mirrored = nodes + 0.0, mirrored + 0.0  # no -0.0
    order, other = np.lexsort(nodes.T), np.lexsort(mirrored.T)
    np.testing.assert_array_equal(nodes[order], mirrored[other])


def test_cells_near_the_papers_hole_are_about_as_wide_as_the_spacing():
    """Sec. 4.2: "hexahedron shaped with edge lengths of approximately 0.05 in"; four through the thickness."""
    mesh = plate_with_hole(*PAPER, 0.05)
    quality = measure(mesh)
    assert quality.shortest_edge / 0.05 >= 0.6 and quality.longest_edge / 0.05 <= 1.3
    assert quality.smallest_scaled_jacobian >= 0.9
    assert len(mesh.cells) % 4 == 0
    # 180 x 60 cells a layer, less the area of the hole; cells at it are a tenth smaller in the mean
    assert len(mesh.cells) == pytest.approx(4 * (180 * 60 - math.pi * 64), rel=0.01)


def test_volume_of_the_papers_plate_converges_with_the_square_of_the_spacing():
    """The area between polygon and circle falls by 4 when the spacing is halved."""
    exact = 0.2 * (9.0 * 3.0 - math.pi * 0.4**2)
    errors = []
    for spacing in (0.1, 0.05):
        mesh = plate_with_hole(*PAPER, spacing)
        errors.append(math.fsum(gauss_volumes(mesh.nodes[mesh.cells]).reshape(-1)) - exact)
    rate = math.log2(errors[0] / errors[1])
    assert rate == pytest.approx(2.0, abs=0.5), f"observed rate {rate:.2f}"  # 32 and 56 edges: log2 of their square


def test_plate_far_from_the_origin_is_moved_only():
    near, far = (plate_with_hole((x, 0.0, 0.0), (x + 16.0, 12.0, 1.0), 3.0, 1.0) for x in (0.0, 1024.0))
    np.testing.assert_array_equal(near.cells, far.cells)
    np.testing.assert_allclose(far.nodes - [1024.0, 0.0, 0.0], near.nodes, rtol=0, atol=1e-12)


# --- quality ----------------------------------------------------------------------------------------------


def test_quality_of_a_box_is_exact():
    quality = measure(box((0.0, 0.0, 0.0), (2.0, 6.0, 12.0), (2, 3, 3)))
    assert (quality.shortest_edge, quality.longest_edge) == (1.0, 4.0)
    assert quality.smallest_scaled_jacobian == pytest.approx(1.0, abs=ROUND_OFF)
    assert quality.smallest_gauss_volume == pytest.approx(1.0, abs=ROUND_OFF)  # 1 x 2 x 4 / 8


def test_scaled_jacobian_of_a_parallelepiped_is_the_sine_of_its_angle():
    angle = math.radians(40.0)
    mesh = box((0.0, 0.0, 0.0), (1.0, 1.0, 1.0), (1, 1, 1))
    shear = np.array([[1.0, math.cos(angle), 0.0], [0.0, math.sin(angle), 0.0], [0.0, 0.0, 1.0]])
    quality = measure(HexMesh(mesh.nodes @ shear.T, mesh.cells))
    assert quality.smallest_scaled_jacobian == pytest.approx(math.sin(angle), abs=ROUND_OFF)


@pytest.mark.parametrize(
    ("spoil", "count", "places"),
    [
        pytest.param(
            lambda nodes, cell: nodes.__setitem__(cell[6], nodes[cell[0]]), 1, "26 at (2.375, ", id="pushed through"
        ),
        pytest.param(
            lambda nodes, cell: nodes.__setitem__(cell[6], nodes[cell[5]]), 1, "26 at (2.5, ", id="two nodes at a place"
        ),
        pytest.param(
            lambda nodes, cell: nodes.__setitem__((cell[4:], 2), nodes[cell[0], 2]), 4, "22 at (1.5, ", id="flat"
        ),  # its three neighbours share one upper node or two, and lose a corner
    ],
)
def test_bad_cells_are_refused_with_count_ids_and_places(spoil, count, places):
    mesh = box((0.0, 0.0, 0.0), (3.0, 3.0, 3.0), (3, 3, 3))
    nodes = mesh.nodes.copy()
    spoil(nodes, mesh.cells[26])
    with pytest.raises(SceneError) as caught:
        measure(HexMesh(nodes, mesh.cells))
    (message,) = caught.value.messages
    assert message.startswith(f"mesh has {count} of 27 cells that are flat or inside out")
    assert f"the first {places}" in message
    assert message.endswith("Use another spacing, or correct the order of their nodes.")


def test_mirrored_cells_are_all_refused_and_three_are_named():
    mesh = box((0.0, 0.0, 0.0), (2.0, 2.0, 2.0), (2, 2, 2))
    with pytest.raises(SceneError, match="mesh has 8 of 8 cells") as caught:
        measure(HexMesh(mesh.nodes * [-1.0, 1.0, 1.0], mesh.cells))
    assert "the first 0 at (-0.5, 0.5, 0.5), 1 at (-1.5, 0.5, 0.5), 2 at" in caught.value.messages[0]
    assert ", 3 at" not in caught.value.messages[0]
