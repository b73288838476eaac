"""Mirror planes: the reflections that matter for a box, and the rigid motions that planes leave."""

import numpy as np
import pytest

from pdfem_mpi.mesh.mirrors import Mirrors, mirrors_at

LOWER, UPPER = np.zeros(3), np.array([4.0, 2.0, 1.0])


def images(faces, reach):
    """Images of the box from 0 to (4, 2, 1) that come within ``reach`` of it, as intervals by axis."""
    mirrors = mirrors_at(faces, LOWER, UPPER)
    sign, shift = mirrors.reflections((LOWER, UPPER), (LOWER - reach, UPPER + reach))
    return sorted(map(tuple, np.sort([sign * LOWER + shift, sign * UPPER + shift], axis=0).transpose(1, 2, 0).tolist()))


def test_without_planes_there_is_nothing_but_the_identity():
    assert not mirrors_at((), LOWER, UPPER)
    assert images((), 1e9) == []


def test_one_plane_makes_one_image_at_any_distance():
    assert images(("y+",), 0.5) == [([0.0, 4.0], [2.0, 4.0], [0.0, 1.0])]
    assert images(("y+",), 1e9) == images(("y+",), 0.5)


def test_planes_of_three_axes_make_seven_images():
    found = images(("x-", "y+", "z-"), 0.1)
    assert len(found) == len({str(box) for box in found}) == 7
    assert ([-4.0, 0.0], [2.0, 4.0], [-1.0, 0.0]) in found


@pytest.mark.parametrize(("reach", "cells"), [(0.5, [-1, 1]), (1.5, [-2, -1, 1, 2]), (2.5, [-3, -2, -1, 1, 2, 3])])
def test_two_planes_across_an_axis_reflect_each_others_images(reach, cells):
    """A slab of thickness 1 between two planes is repeated; images beyond the reach are left out."""
    found = images(("z-", "z+"), reach)
    assert [box[2] for box in found] == [[float(k), k + 1.0] for k in cells]


def test_a_reflection_of_two_planes_keeps_or_reverses_order():
    """Even cells of the repeated slab are shifted, odd ones reversed."""
    mirrors = mirrors_at(("z-", "z+"), LOWER, UPPER)
    sign, shift = mirrors.reflections((LOWER, UPPER), (LOWER - 2.5, UPPER + 2.5))
    point = np.sort(sign[:, 2] * 0.25 + shift[:, 2])
    assert point.tolist() == [-2.25, -1.75, -0.25, 1.75, 2.25, 3.75]


@pytest.mark.parametrize(
    ("faces", "kept"),
    [
        ((), (1, 1, 1, 1, 1, 1)),
        (("x-",), (0, 1, 1, 1, 0, 0)),
        (("z-", "z+"), (1, 1, 0, 0, 0, 1)),
        (("x-", "y-"), (0, 0, 1, 0, 0, 0)),
        (("x-", "y-", "z+"), (0, 0, 0, 0, 0, 0)),
    ],
)
def test_rigid_motions_that_planes_leave(faces, kept):
    assert mirrors_at(faces, LOWER, UPPER).kept_motions.astype(int).tolist() == list(kept)


def test_components_normal_to_a_plane():
    mirrors = Mirrors(((0.0,), (), (1.0, 3.0)))
    x = np.array([[0.0, 0.0, 0.0], [1e-7, 5.0, 1.0], [0.1, 0.0, 3.0 + 1e-7]])
    assert mirrors.normal_components(x, 1e-6).astype(int).tolist() == [[1, 0, 0], [1, 0, 1], [0, 0, 1]]
