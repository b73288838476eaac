"""Displacements along a line: sampling, parts outside of the body, and the file."""

import csv

import numpy as np
import pytest

from pdfem_mpi.deck.meshes import PlateWithHoleMesh
from pdfem_mpi.deck.outputs import LineProbe
from pdfem_mpi.measure.displacement import displacement_at
from pdfem_mpi.measure.line import measure_line
from pdfem_mpi.results.lines import COLUMNS, write_line
from support.bodies import fields_of_positions, geometry_of, make_scene

ROUND_OFF = 1e-13  # of Newton's method and of eight products, as in test_probes
CELLS = 6, 2, 2
GRADIENT = np.array([[1.0, 0.5, -0.25], [0.125, -0.5, 2.0], [-1.0, 0.75, 0.25]]) * 1e-3


def linear(x):
    return x @ GRADIENT.T


def line(start, stop, n):
    return LineProbe(kind="line", name="a", start=start, stop=stop, n=n)


@pytest.fixture(scope="module")
def coupled():
    return geometry_of(make_scene(CELLS, 3, loads=()))


@pytest.mark.parametrize(
    ("start", "stop"),
    [((0.0, 0.0, 1.0), (6.0, 0.0, 1.0)), ((0.0, 0.0, 0.0), (6.0, 2.0, 2.0)), ((5.0, 0.3, 0.3), (0.1, 0.3, 0.3))],
    ids=["edge", "diagonal", "backward"],
)
def test_linear_field_along_a_line_is_exact(coupled, start, stop):
    found = measure_line(coupled, fields_of_positions(coupled, linear), line(start, stop, 13))
    np.testing.assert_allclose(found.position, np.linspace(start, stop, 13), rtol=0, atol=ROUND_OFF)
    np.testing.assert_allclose(found.distance, np.linspace(0.0, np.linalg.norm(np.subtract(stop, start)), 13))
    np.testing.assert_allclose(found.displacement, linear(found.position), rtol=0, atol=ROUND_OFF)


def test_coordinates_across_the_line_are_the_decks():
    """No round-off in what does not change: y = -0.1 stays -0.1."""
    body = geometry_of(make_scene(CELLS, 6, loads=()))
    found = measure_line(body, fields_of_positions(body, linear), line((0.0, 0.1, 0.7), (6.0, 0.1, 0.7), 7))
    assert (found.position[:, 1:] == [0.1, 0.7]).all()


def test_models_are_told_apart(coupled):
    """The overlap and the interface count as finite elements, whose nodes they have."""
    found = measure_line(coupled, fields_of_positions(coupled, linear), line((0.5, 1.0, 1.0), (5.5, 1.0, 1.0), 11))
    elements = found.position[:, 0] <= 3.0
    assert set(found.kind[elements]) == {"finite elements"}
    assert set(found.kind[~elements]) == {"peridynamics"}


def test_where_peridynamic_cells_meet_their_mean_is_taken():
    """Points of a cell moved by a number of their own: 1 on one side of the face, 3 on the other, 2 on it."""
    body = geometry_of(make_scene((2, 1, 1), 0, loads=()))
    fields = fields_of_positions(body, lambda x: np.where(x[:, :1] < 1.0, 1.0, 3.0) * np.ones(3))
    assert displacement_at(body, fields, (0.7, 0.5, 0.5)) == pytest.approx(1.0, abs=ROUND_OFF)
    assert displacement_at(body, fields, (1.0, 0.5, 0.5)) == pytest.approx(2.0, abs=ROUND_OFF)


def test_samples_outside_of_the_body_are_empty():
    """A line across the hole of a plate and past its ends."""
    scene = make_scene(CELLS, 6, loads=())
    plate = PlateWithHoleMesh(
        kind="plate_with_hole", lower=(0.0, 0.0, 0.0), upper=(8.0, 8.0, 1.0), hole_radius=2.0, spacing=1.0
    )
    body = geometry_of(scene.model_copy(update={"mesh": plate, "regions": scene.regions}))
    found = measure_line(body, fields_of_positions(body, linear), line((-1.0, 4.0, 0.5), (9.0, 4.0, 0.5), 21))
    x = found.position[:, 0]
    inside = (x >= 0.0) & (x <= 8.0) & (np.abs(x - 4.0) >= 2.0 - 1e-9)
    np.testing.assert_array_equal(found.kind == "finite elements", inside)
    assert np.isnan(found.displacement[~inside]).all()
    np.testing.assert_allclose(found.displacement[inside], linear(found.position[inside]), rtol=0, atol=ROUND_OFF)


def test_file_reads_back_the_same_bits(tmp_path):
    third = 1.0 / 3.0
    write_line(tmp_path / "a.csv", [(0.0, (0.0, 0.0, third), (third, -1e-300, 0.1), "peridynamics")])
    with open(tmp_path / "a.csv", newline="", encoding="utf-8") as file:
        (row,) = csv.DictReader(file)
    assert tuple(row) == COLUMNS
    assert [float(row[name]) for name in ("z", "u_x", "u_y", "u_z")] == [third, third, -1e-300, 0.1]
    assert row["model"] == "peridynamics"


def test_file_leaves_unknown_displacements_empty(tmp_path):
    write_line(tmp_path / "a.csv", [(0.5, (0.5, 0.0, 0.0), None, "")])
    assert (tmp_path / "a.csv").read_text() == "distance,x,y,z,u_x,u_y,u_z,model\n0.5,0.5,0.0,0.0,,,,\n"
