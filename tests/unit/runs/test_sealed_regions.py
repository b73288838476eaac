"""Bands that may fail between cells that never do: which of them cannot part, and that a deck is told."""

import itertools

import pytest

from pdfem_mpi import read_deck
from pdfem_mpi.runs.sanity import doubts
from pdfem_mpi.runs.sealed_regions import describe_sealed_regions, sealed_regions
from pdfem_mpi.solvers.convergence import NotConverged
from support.bodies import local_share
from support.failing import followed

LENGTH = 14.0


def banded(*walls, never=(0, 2), **tables):
    """A bar of cubes with a region of bonds from each of the walls to the next; of the ``never`` ones none breaks."""
    ends = [-1.0, *walls, LENGTH + 1.0]
    regions = [
        {
            "name": f"part {k}", "model": "peridynamics", "lower": [low, 0.0, 0.0], "upper": [high, 3.0, 3.0],
            **({"may_fail": False} if k in never else {}),
        }
        for k, (low, high) in enumerate(itertools.pairwise(ends))
    ]  # fmt: skip
    return read_deck({
        "mesh": {"lower": [0.0, 0.0, 0.0], "upper": [LENGTH, 2.0, 2.0], "spacing": 1.0},
        "material": {"youngs_modulus": 1000.0, "critical_stretch": 0.004},
        "peridynamics": {"surface_correction": "virial", "kinematics": "linear"},
        "regions": regions,
        "supports": [{"face": "x-", "x": 0.0, "y": 0.0, "z": 0.0}, {"face": "x+", "x": 0.05}],
        "stepping": {"kind": "events"},
        **tables,
    })  # fmt: skip


def sealed(scene):
    return sealed_regions(scene, local_share(scene))


@pytest.mark.parametrize(("width", "found"), [(1, [1]), (2, [1]), (3, [1]), (4, []), (5, []), (6, [])])
def test_bands_that_bonds_hold_together_from_both_sides(width, found):
    """Bonds reach 2.5 cells; a band of 4 has the weakest of them alone in its middle, and parts."""
    assert sealed(banded(5.0, 5.0 + width)) == found


def test_a_band_at_an_end_parts_from_what_never_breaks():
    assert sealed(banded(5.0, never=(0,))) == []
    assert sealed(banded(13.0, never=(0,))) == []


def test_a_narrow_band_beside_a_wide_one_parts_there():
    assert sealed(banded(5.0, 6.0, 11.0, never=(0, 3))) == []
    assert sealed(banded(5.0, 6.0, 7.0, never=(0, 3))) == [1, 2]


def test_a_deck_is_told_before_anything_is_solved():
    scene = banded(6.0, 8.0)
    (text,) = (text for text in doubts(scene, local_share(scene), {}) if "cannot part" in text)
    assert text.startswith("warning: regions.1, part 1, cannot part: bonds to cells with may_fail = false never break")
    assert "wider than twice the cutoff radius, 5, or" in text
    free = banded(6.0, 8.0, never=())
    assert not list(describe_sealed_regions(free, local_share(free)))


def test_a_body_that_others_hold_when_all_that_may_have_broken_is_named():
    """The bonds of a band of one cell break, and bonds over it go on to carry: no word of another load alone."""
    with pytest.raises(NotConverged, match=r"others hold the body together.*may_fail = false.*wider"):
        followed(banded(6.0, 7.0))
