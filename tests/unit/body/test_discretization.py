"""What the cells of a mesh carry: regions, overlap, numbers, model units; and what is refused."""

import re

import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.deck.peridynamics import Peridynamics
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import SceneError
from support.bodies import make_scene

CELLS = 6, 2, 1


def refused(scene):
    """All sentences of a scene that cannot be discretized."""
    with pytest.raises(SceneError) as caught:
        discretize(scene)
    return caught.value.messages


def regions(*boxes):
    """Regions of (name, model, first layer, layer after the last) along x."""
    return tuple(
        Region(name=name, model=model, lower=(float(first), 0.0, 0.0), upper=(float(last), 2.0, 1.0))
        for name, model, first, last in boxes
    )


FE, PD = "finite_elements", "peridynamics"


def layers(flags):
    """Cells of 6 x 2 x 1 that are chosen, as the indices of their layers along x; whole layers only."""
    table = flags.reshape(2, 6)
    np.testing.assert_array_equal(table[0], table[1])
    return np.flatnonzero(table[0]).tolist()


@pytest.mark.parametrize("overlap", [1, 2])
def test_reading_b_gives_the_overlap_points_and_no_stiffness(overlap):
    """Sec. 3.2, sentence under eq. 26: overlap cells lie on the elements' side and carry points."""
    found = discretize(make_scene(CELLS, 4, overlap=overlap))
    assert layers(found.is_overlap) == list(range(4 - overlap, 4))
    assert layers(found.has_points) == list(range(4 - overlap, 6))
    assert layers(found.has_stiffness) == list(range(4 - overlap))
    assert layers(found.has_nodes) == [0, 1, 2, 3]


def test_reading_a_keeps_the_stiffness_of_the_overlap():
    """Eq. 18: elements of the overlap keep their internal force."""
    found = discretize(make_scene(CELLS, 4, coupling="paper_a"))
    assert layers(found.has_stiffness) == [0, 1, 2, 3]
    assert layers(found.is_overlap) == [3]


def test_overlap_on_both_sides_of_a_peridynamic_middle():
    scene = make_scene(CELLS, regions=regions(("l", FE, 0, 2), ("m", PD, 2, 4), ("r", FE, 4, 6)), loads=())
    found = discretize(scene)
    assert layers(found.is_overlap) == [1, 4]
    assert layers(found.region == 2) == [4, 5]


@pytest.mark.parametrize(("n_elements", "n_points", "n_nodes"), [(0, 96, 0), (6, 0, 42), (4, 48, 30)])
def test_numbers_of_cells_with_points_and_of_nodes(n_elements, n_points, n_nodes):
    """Consecutive in the order of the mesh; nodes that only peridynamic cells touch have none."""
    found = discretize(make_scene(CELLS, n_elements))
    assert (8 * found.n_point_cells, found.n_nodes) == (n_points, n_nodes)
    np.testing.assert_array_equal(found.point_row[found.has_points], np.arange(n_points // 8))
    np.testing.assert_array_equal(found.node_row[found.node_row >= 0], np.arange(n_nodes))
    assert (found.point_row[~found.has_points] == -1).all()
    assert (found.node_row[found.mesh.cells[found.has_nodes]] >= 0).all()


def test_model_units():
    """Lengths in units of l, from the centre of the box; stresses in units of E; the cutoff is inclusive."""
    scene = make_scene(CELLS).model_copy(update={"peridynamics": Peridynamics(internal_length=0.8, cutoff_radius=2.0)})
    found = discretize(scene)
    assert (found.units.length, found.units.stress) == (0.8, 1000.0)
    assert found.units.force == pytest.approx(640.0)
    np.testing.assert_allclose(found.nodes.min(axis=0), [-3.75, -1.25, -0.625])
    np.testing.assert_allclose(found.nodes.max(axis=0), [3.75, 1.25, 0.625])
    assert 2.5 < found.cutoff < 2.5 * (1 + 1e-5)  # above by a guard that is far below any difference of lengths


def test_without_peridynamics_there_is_no_cutoff():
    assert discretize(make_scene(CELLS, 6)).cutoff == 0.0


def test_regions_that_overlap_name_both_and_the_first_cells():
    (sentence,) = refused(make_scene(CELLS, regions=regions(("a", FE, 0, 4), ("b", PD, 3, 6)), loads=()))
    assert sentence.startswith("regions.b overlaps regions.a in 2 cells, the first 3 at (3.5, 0.5, 0.5)")


def test_cells_left_out_are_counted_and_named():
    (sentence,) = refused(make_scene(CELLS, regions=regions(("a", FE, 0, 2), ("b", PD, 3, 6)), loads=()))
    assert sentence.startswith("regions leave out 2 of 12 cells, the first 2 at (2.5, 0.5, 0.5)")


def test_empty_region_is_told_where_the_centroids_are():
    scene = make_scene(CELLS, regions=regions(("a", FE, 0, 6), ("b", PD, 7, 9)), loads=())
    (sentence,) = refused(scene)
    assert sentence.startswith("regions.b contains no cell")
    assert "[0.5, 5.5] x [0.5, 1.5] x [0.5, 0.5]" in sentence


def test_all_problems_of_regions_are_told_at_once():
    boxes = ("a", FE, 0, 2), ("b", PD, 1, 3), ("c", PD, 7, 9)
    sentences = refused(make_scene(CELLS, regions=regions(*boxes), loads=()))
    starts = "regions.b overlaps", "regions.c contains no cell", "regions leave out 6 of 12"
    assert len(sentences) == 3
    assert all(sentence.startswith(start) for sentence, start in zip(sentences, starts, strict=True))


@pytest.mark.parametrize(("n_elements", "overlap", "largest"), [(4, 4, 3), (4, 6, 3), (2, 2, 1)])
def test_overlap_that_takes_all_elements_is_told_the_largest_that_fits(n_elements, overlap, largest):
    (sentence,) = refused(make_scene(CELLS, n_elements, overlap=overlap))
    assert sentence.startswith(f"coupling.overlap = {overlap} ")
    assert re.search(rf"Use at most {largest}\b", sentence)
    assert discretize(make_scene(CELLS, n_elements, overlap=largest)).has_stiffness.any()


@pytest.mark.parametrize("overlap", [1, 3])
def test_one_layer_of_elements_is_too_thin_for_any_overlap(overlap):
    """The sentence prints the overlap of the deck, and the remedy is a larger region."""
    (sentence,) = refused(make_scene(CELLS, 1, overlap=overlap))
    assert sentence.startswith(f"coupling.overlap = {overlap} ")
    assert "Enlarge them" in sentence
