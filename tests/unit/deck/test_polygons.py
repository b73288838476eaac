"""Polygons whose edges cross, and those that only touch themselves."""

import pytest

from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.polygons import crossing_edges
from pdfem_mpi.deck.removals import RemovedPrism

SQUARE = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
BOW_TIE = ((2.0, 0.0), (5.0, 2.0), (5.0, 0.0), (2.0, 2.0))
UNEVEN = ((2.0, 0.0), (5.0, 2.0), (5.0, 1.0), (2.0, 2.0))
STAR = ((0.0, 3.0), (2.0, -3.0), (-3.0, 1.0), (3.0, 1.0), (-2.0, -3.0))
NOTCHED = ((0.0, 0.0), (4.0, 0.0), (4.0, 3.0), (2.0, 1.0), (0.0, 3.0))
#: A frame whose outline and hole are joined by a seam that is gone along twice, its ends a last digit apart.
SEAM = (
    (0.0, 0.0), (3.0, 0.0), (3.0, 3.0), (0.0, 3.0), (0.0, 0.0), (1.0, 1.0), (1.0, 2.0), (2.0, 2.0), (2.0, 1.0),
    (1.0 + 2.0**-52, 1.0),
)  # fmt: skip
SIMPLE = (SQUARE, SQUARE[:3], (*SQUARE, SQUARE[0]), (SQUARE[0], SQUARE[1], *SQUARE[1:]), NOTCHED, SEAM)


@pytest.mark.parametrize("scale", [1.0, 1e-9, 1e9])
def test_edges_that_cross(scale):
    for corners, found in ((BOW_TIE, (0, 2)), (UNEVEN, (0, 2)), (STAR, (0, 2))):
        assert crossing_edges([(scale * x, scale * y) for x, y in corners]) == found
    for corners in SIMPLE:
        assert crossing_edges([(scale * x, scale * y) for x, y in corners]) is None


def in_space(corners, axis, slope=0.0):
    """The corners in a plane normal to an axis, or a little off it."""
    placed = []
    for x, y in corners:
        corner = [x, y]
        corner.insert(axis, 4.5 + slope * x)
        placed.append(tuple(corner))
    return tuple(placed)


@pytest.mark.parametrize("axis", [0, 1, 2])
@pytest.mark.parametrize("slope", [0.0, 0.5])
def test_cracks_that_cross_themselves_are_refused(axis, slope):
    for corners in (BOW_TIE, UNEVEN, STAR):
        placed = in_space(corners, axis, slope)
        with pytest.raises(ValueError, match="polygon has edges that cross: the one from") as error:
            Crack(polygon=placed)
        shown = ["[" + ", ".join(map(repr, placed[k])) + "]" for k in (0, 1, 2, 3)]
        text = "the one from {} to {}, and the one from {} to {}. Give the corners in the order of its outline."
        assert text.format(*shown) in str(error.value)
    for corners in SIMPLE:
        Crack(polygon=in_space(corners, axis, slope))


def test_prisms_that_cross_themselves_are_refused():
    for corners in (BOW_TIE, UNEVEN, STAR):
        with pytest.raises(ValueError, match="polygon has edges that cross: the one from"):
            RemovedPrism(kind="prism", axis="z", polygon=corners)
    for corners in SIMPLE:
        RemovedPrism(kind="prism", axis="z", polygon=corners)


def test_corners_on_a_line_have_no_area():
    line = ((0.0, 0.0), (1.0, 1.0), (3.0, 3.0))
    for make in (
        lambda: Crack(polygon=in_space(line, 2)),
        lambda: RemovedPrism(kind="prism", axis="z", polygon=line),
    ):
        with pytest.raises(ValueError, match="has no area"):
            make()
