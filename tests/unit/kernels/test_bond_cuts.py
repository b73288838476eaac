"""Initial cracks: which bonds a plane polygon cuts."""

from itertools import pairwise

import numpy as np
import pytest

from pdfem_mpi.deck.peridynamics import Crack, polygon_normal
from pdfem_mpi.peridynamics.bonds import total_bonds
from pdfem_mpi.peridynamics.clusters import point_rows
from pdfem_mpi.peridynamics.cracks import cut_bonds
from support.bodies import build, make_scene

CELLS = (3, 3, 2)
# corners in model units: the origin is the body's centre
SQUARE = np.array([[0.0, -3.0, -3.0], [0.0, 0.4, -3.0], [0.0, 0.4, 3.0], [0.0, -3.0, 3.0]])
SLANTED = np.array([[-0.7, -0.6, -9.0], [0.9, 0.7, -9.0], [0.9, 0.7, 9.0], [-0.7, -0.6, 9.0]])
# an L: its notch must stay whole
CONCAVE = np.array(
    [[0.0, -3.1, -3.2], [0.0, 3.3, -3.4], [0.0, 3.5, 0.17], [0.0, 0.13, 0.11], [0.0, 0.19, 3.6], [0.0, -3.7, 3.8]]
)


def live_pairs(body):
    """All bonds with stored numbers that are not 0, as pairs of point rows, and the positions."""
    model = body.model
    stride = 8 if model.bonds.finite else 4
    x, pairs = point_rows(model.points.x), set()
    for rows in model.bonds.rows:
        for i in range(len(rows.start) - 1):
            for row in range(rows.start[i], rows.start[i + 1]):
                for k in range(4):
                    if rows.data[row * stride + k]:
                        pairs.add((i, 4 * (int(rows.offset[row]) // 36) + k))
    return x, pairs


def crosses(a, b, polygon):
    """Whether the segment passes through the polygon, by triangles of a fan and Moeller-Trumbore; slow, independent."""
    count = 0
    for p, q in pairwise(polygon[1:]):
        m = np.stack([b - a, polygon[0] - p, polygon[0] - q], axis=1)
        if abs(np.linalg.det(m)) < 1e-14:
            continue
        t, v, w = np.linalg.solve(m, polygon[0] - a)
        count += 0 <= t <= 1 and v >= 0 and w >= 0 and v + w <= 1
    return count % 2 == 1


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
@pytest.mark.parametrize("polygon", [SQUARE, SLANTED, CONCAVE], ids=["square", "slanted", "concave"])
def test_cuts_the_bonds_that_cross(polygon, kinematics):
    """The set of bonds cut is that of an independent test of all bonds."""
    body = build(make_scene(CELLS, kinematics=kinematics, correction="none"))
    x, before = live_pairs(body)
    normal = np.array(polygon_normal(tuple(map(tuple, polygon)))[0])
    cut = cut_bonds(body.model.comm, body.model.points, body.model.bonds, polygon, normal)
    _, after = live_pairs(body)
    assert before - after == {(i, j) for i, j in before if crosses(x[i], x[j], polygon)}
    assert cut == len(before) - len(after) > 0


def test_a_second_cut_finds_nothing():
    """Bonds are cut once."""
    body = build(make_scene(CELLS, correction="none"))
    model = body.model
    normal = np.array([1.0, 0.0, 0.0])
    assert cut_bonds(model.comm, model.points, model.bonds, SQUARE, normal) > 0
    assert cut_bonds(model.comm, model.points, model.bonds, SQUARE, normal) == 0


def test_a_crack_of_the_deck_is_in_its_units():
    """A scene's crack between the first and second layer of cells cuts what the kernel cuts in model units."""
    crack = Crack(polygon=((1.0, -9.0, -9.0), (1.0, 9.0, -9.0), (1.0, 9.0, 9.0), (1.0, -9.0, 9.0)))
    body = build(make_scene(CELLS, correction="none", cracks=(crack,), loads=()))
    x, pairs = live_pairs(body)
    side = x[:, 0] < -0.5  # the plane x = 1 of a body centred at 1.5
    assert pairs
    assert all(side[i] == side[j] for i, j in pairs)
    assert body.model.cut == (total_bonds(body.model.comm, body.model.bonds) - len(pairs),)


def test_a_crack_ends_the_same_on_either_side():
    """Bonds that pass through an edge of the polygon are cut: on planes between cells, mirror images cut as many."""
    body = build(make_scene((6, 4, 1), correction="none", loads=()))
    model, normal = body.model, np.array([0.0, 1.0, 0.0])
    left = np.array([[-9.0, 0.0, -9.0], [-1.0, 0.0, -9.0], [-1.0, 0.0, 9.0], [-9.0, 0.0, 9.0]])
    cuts = [
        cut_bonds(model.comm, model.points, model.bonds, polygon, normal)
        for polygon in (left, left * np.array([-1.0, 1.0, 1.0]))
    ]
    assert cuts[0] == cuts[1] > 0
