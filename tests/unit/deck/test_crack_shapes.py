"""Discs and half-planes as initial cracks: the polygons that stand for them, and the bonds they cut."""

import math

import numpy as np
import pytest
from pydantic import ValidationError

from pdfem_mpi.deck.cracks import DISC_CORNERS, DiscCrack, HalfPlaneCrack
from pdfem_mpi.deck.peridynamics import Crack, polygon_normal
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.peridynamics.bonds import total_bonds
from support.bodies import bond_list, build, make_scene
from support.tiny import TINY

CELLS = (6, 5, 4)
POLYGON = 4e-5  # relative, of radii of a polygon of 256 corners: pi^2 / 256^2 / 4
BOX = (0.0, 0.0, 0.0), tuple(map(float, CELLS))


def bonds_of(cracks):
    """Ends of all bonds in the deck's units, shape (n, 2, 3), and how many each crack cuts."""
    body = build(make_scene(CELLS, correction="none", cracks=cracks, loads=()))
    x, i, j, _ = bond_list(body)
    x = x * body.model.units.length + body.model.units.origin
    return np.stack([x[i], x[j]], axis=1), body.model.cut, total_bonds(body.model.comm, body.model.bonds)


def crossings(ends, point, normal):
    """Whether bonds cross a plane, and where."""
    height = (ends - point) @ normal
    crosses = height[:, 0] * height[:, 1] < 0.0
    share = height[crosses, 0] / (height[crosses, 0] - height[crosses, 1])
    return crosses, ends[crosses, 0] + share[:, None] * (ends[crosses, 1] - ends[crosses, 0])


def test_a_disc_cuts_the_bonds_through_it():
    """The distance of the crossing from the centre decides, within what a polygon differs from its circle by."""
    centre, normal, radius = (3.1, 2.4, 2.0), (0.0, 0.0, 2.0), 1.7
    whole, _, total = bonds_of(())
    cracked, cut, _ = bonds_of((DiscCrack(kind="disc", centre=centre, normal=normal, radius=radius),))
    _, at = crossings(whole, centre, normal)
    distance = np.linalg.norm(at - centre, axis=1)
    least, most = (np.count_nonzero(distance < radius * (1.0 + sign * POLYGON)) for sign in (-1, 1))
    assert 0 < least <= cut[0] <= most < 1.01 * least
    assert len(cracked) == total - cut[0] > 0


def test_the_polygon_of_a_disc_lies_about_its_circle():
    """Corners outside and middles of edges inside by the same ratio, in the plane of the disc."""
    disc = DiscCrack(kind="disc", centre=(1.0, 2.0, 3.0), normal=(1.0, -2.0, 0.5), radius=0.7)
    corners = np.array(disc.corners(*BOX))
    outer = np.linalg.norm(corners - disc.centre, axis=1)
    inner = np.linalg.norm(0.5 * (corners + np.roll(corners, 1, axis=0)) - disc.centre, axis=1)
    assert len(corners) == DISC_CORNERS
    assert outer.max() - outer.min() < 1e-14 and outer.max() < 0.7 * (1 + POLYGON)
    np.testing.assert_allclose(outer * inner, 0.7**2, rtol=1e-12)
    assert np.abs((corners - disc.centre) @ (np.array(disc.normal) / math.hypot(*disc.normal))).max() < 1e-14


def test_a_half_plane_goes_through_the_body_from_its_front():
    """A slanted front in a slanted plane; the direction need not be normal to the front."""
    crack = HalfPlaneCrack(kind="half_plane", point=(2.9, 2.6, 2.1), normal=(0.3, 1.0, 0.1), direction=(-1.0, 0.4, 0.2))
    point, normal, direction = (np.array(vector) for vector in (crack.point, crack.normal, crack.direction))
    whole, _, total = bonds_of(())
    _, cut, _ = bonds_of((crack,))
    crosses, at = crossings(whole, point, normal)
    into = direction - (direction @ normal) / (normal @ normal) * normal
    expected = np.count_nonzero((at - point) @ into > 0.0)
    assert cut == (expected,) and 0 < expected < np.count_nonzero(crosses) < total


def test_a_half_plane_far_away_cuts_all_or_nothing():
    crack = HalfPlaneCrack(kind="half_plane", point=(1e4, 2.5, 0.0), normal=(0.0, 1.0, 0.0), direction=(-1.0, 0.0, 0.0))
    back = crack.model_copy(update={"direction": (1.0, 0.0, 0.0)})
    whole, _, _ = bonds_of(())
    crosses, _ = crossings(whole, np.array([0.0, 2.5, 0.0]), np.array([0.0, 1.0, 0.0]))
    _, cut, _ = bonds_of((crack, back))
    assert cut == (np.count_nonzero(crosses), 0)


def test_the_polygon_of_a_half_plane_has_its_normal():
    crack = HalfPlaneCrack(kind="half_plane", point=(1.0, 2.0, 3.0), normal=(1.0, 2.0, 2.0), direction=(1.0, 0.0, 0.0))
    normal, _ = polygon_normal(crack.corners(*BOX))
    np.testing.assert_allclose(np.abs(normal), np.array([1.0, 2.0, 2.0]) / 3.0, atol=1e-14)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: DiscCrack(kind="disc", centre=(0, 0, 0), normal=(0, 0, 0), radius=1.0), "has no direction"),
        (
            lambda: HalfPlaneCrack(kind="half_plane", point=(0, 0, 0), normal=(0, 1, 0), direction=(0, 3, 0)),
            "is normal to the crack's plane",
        ),
        (
            lambda: HalfPlaneCrack(kind="half_plane", point=(0, 0, 0), normal=(0, 1, 0), direction=(0, 0, 0)),
            "has no direction",
        ),
    ],
)
def test_shapes_without_a_plane_are_named(make, says):
    with pytest.raises(ValidationError, match=says):
        make()


def test_a_table_without_kind_is_a_polygon():
    """Decks that were written before there were other shapes."""
    polygon = "polygon = [[3.0, 0.0, 0.0], [3.0, 1.0, 0.0], [3.0, 1.0, 2.0]]"
    scene = parse_deck(f'{TINY}\n[[cracks]]\n{polygon}\n[[cracks]]\nkind = "polygon"\n{polygon}', "deck.toml")
    assert scene.cracks[0] == scene.cracks[1] and isinstance(scene.cracks[0], Crack)
