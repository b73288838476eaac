"""The cells that hold a place, where the cell with the nearest middle does not."""

import numpy as np
import pytest

from pdfem_mpi.body.locating import _reference_coordinates, interpolation, locate
from pdfem_mpi.kernels.hex8 import gauss_positions
from support.mixed_cells import MESHES, beside_crack, body_of, oblique, places_in, shaken

ROUND_OFF = 1e-11  # of places up to 50 away, by Newton's method and eight products


def read(body, holders):
    """The mean of the positions that the holders interpolate."""
    mesh, found = body.mesh, []
    for holder in holders:
        corners = mesh.nodes[mesh.cells[holder.cell]]
        values = corners if holder.nodes is not None else gauss_positions(corners[None])[0]
        found.append(interpolation(holder) @ values)
    return np.mean(found, axis=0)


@pytest.mark.parametrize("with_nodes", [True, False], ids=["elements", "peridynamics"])
@pytest.mark.parametrize("name", MESHES)
def test_every_place_of_the_body_is_held(name, with_nodes):
    """By a cell that interpolates its position: the place itself, on the side of the crack that it was drawn on."""
    mesh = MESHES[name]()
    body = body_of(mesh, np.full(len(mesh.cells), with_nodes))
    for cell, place in zip(*places_in(mesh, 200, 7), strict=True):
        holders, outside = locate(body, place)
        assert outside <= ROUND_OFF
        if with_nodes or name != "shaken":  # where faces are bent, positions are no field of points
            np.testing.assert_allclose(read(body, holders), place, rtol=0, atol=ROUND_OFF)
        assert [holder.cell for holder in holders] == [cell]


def test_small_cells_across_a_crack_do_not_hold_a_place():
    body = body_of(beside_crack())
    for height in (0.02, 0.1, 0.2, 0.3):
        (holder,), outside = locate(body, np.array([0.5, height, 0.7]))
        assert outside <= ROUND_OFF and body.mesh.centroids[holder.cell].tolist() == [0.5, 1.0, 0.5]


@pytest.mark.parametrize("x", [1.0, 2.0, 2.0 + 1e-7, 4.0])
def test_all_peridynamic_cells_that_meet_hold_a_place(x):
    """Also where the cell with the nearest middle shares nodes with none of them, or with one."""
    mesh = beside_crack()
    holders, outside = locate(body_of(mesh, np.zeros(len(mesh.cells), bool)), np.array([x, 0.1, 1.0]))
    middles = sorted(mesh.centroids[holder.cell].tolist() for holder in holders)
    assert outside <= mesh.tolerance
    assert middles == [[round(x) + a, 1.0, 1.0 + b] for a in (-0.5, 0.5) for b in (-0.5, 0.5)]


@pytest.mark.parametrize(
    ("make", "place", "distance"),
    [
        (oblique, (-0.5, 0.0, 0.5), 0.5),
        (oblique, (4.0, -3.0, 0.5), 3.0),
        (oblique, (22.0, 9.0, 1.5), 1.0),
        (beside_crack, (0.5, 4.25, 0.5), 0.25),
        (beside_crack, (2.5, -1.5, 2.0), 0.5),
    ],
)
def test_outside_of_the_body_the_distance_is_told(make, place, distance):
    _, outside = locate(body_of(make()), np.array(place))
    assert outside == pytest.approx(distance, rel=1e-12)


def test_apart_the_company_of_other_cells_does_not_matter():
    """Newton's method ends for each cell by itself: the same bits alone and among others, which rounding would tell."""
    mesh = shaken()
    corners, (_, places) = mesh.nodes[mesh.cells], places_in(mesh, 20, 8)
    for place in places:
        among = _reference_coordinates(corners, place, apart=True)
        alone = [_reference_coordinates(corners[[k]], place, apart=True)[0] for k in range(len(corners))]
        assert np.array_equal(among, alone, equal_nan=True)
    assert (_reference_coordinates(corners, places[-1], apart=False) != among).any()
