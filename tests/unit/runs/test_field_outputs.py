"""Fields that a deck asks for by name: in its files, in Python, after a restart, and wrong names."""

import numpy as np
import pytest

import pdfem_mpi as pdfem
from pdfem_mpi.deck.toml import parse_deck
from support.tiny import TINY

ASKED = ("displacement", "stress", "von_mises", "stress_at_gauss_points")
SINGLE = 1e-6  # files hold single precision


def tiny(*overrides):
    return parse_deck(TINY, "tiny.toml", (*overrides, "output.figures=false"))


@pytest.fixture(scope="module")
def scene():
    return tiny(f"output.fields={list(ASKED)}", "stepping.load_factors=[0.5, 1.0]")


@pytest.fixture(scope="module")
def folder(scene, tmp_path_factory):
    return pdfem.run(scene, tmp_path_factory.mktemp("fields") / "run")


def test_files_hold_what_the_deck_asks_for(folder):
    assert folder.points.names == sorted(("displacement", "stress", "von_mises"))
    assert folder.nodes.names == ["displacement"]
    assert folder.nodes.cell_names == sorted(("stress", "stress_at_gauss_points", "von_mises"))


def test_files_hold_the_fields_of_the_simulation(scene, folder):
    simulation = pdfem.Simulation(scene)
    for frame, factor in enumerate(scene.stepping.load_factors):
        simulation.solve(factor)
        fields = simulation.fields(*ASKED[1:])
        pairs = [(folder.points.field(name, frame), fields.of_points[name]) for name in ("stress", "von_mises")]
        pairs += [(folder.nodes.of_cells(name, frame), fields.of_cells[name]) for name in ASKED[1:]]
        for stored, computed in pairs:
            np.testing.assert_allclose(stored, computed, rtol=SINGLE, atol=SINGLE)


def test_means_of_cells_are_those_of_their_gauss_points(scene):
    simulation = pdfem.Simulation(scene)
    simulation.solve(1.0)
    fields = simulation.fields("strain", "strain_at_gauss_points")
    gauss = fields.of_cells["strain_at_gauss_points"].reshape(-1, 8, 6)  # of cubes: points of one volume
    np.testing.assert_allclose(fields.of_cells["strain"], gauss.mean(axis=1), rtol=0, atol=1e-15)


def test_a_restart_goes_on_with_the_fields(scene, folder, tmp_path):
    """Stopped after the first step and gone on with, the files are those of the run in one go."""
    first = pdfem.run(tiny(f"output.fields={list(ASKED)}", "stepping.load_factors=[0.5]"), tmp_path / "run")
    resumed, whole = pdfem.resume(first.path, {"stepping.load_factors": [0.5, 1.0]}), folder
    for frame in (0, 1):
        for frames in ("points", "nodes"):
            one, other = getattr(resumed, frames), getattr(whole, frames)
            for name in one.names:
                assert np.array_equal(one.field(name, frame), other.field(name, frame))
            for name in one.cell_names:
                assert np.array_equal(one.of_cells(name, frame), other.of_cells(name, frame))


def test_fields_that_are_not_asked_for_are_not_computed(monkeypatch, tmp_path):
    def never(*arguments):
        raise AssertionError("stresses were computed")

    monkeypatch.setattr("pdfem_mpi.measure.recovered.mechanics_of_bonds", never)
    monkeypatch.setattr("pdfem_mpi.measure.recovered.mechanics_of_elements", never)
    folder = pdfem.run(tiny(), tmp_path / "run")
    assert folder.points.names == ["displacement"]


@pytest.mark.parametrize(
    ("value", "sentence"),
    [
        ('["displacement", "stres"]', 'output.fields has "stres", which is not a field. Did you mean stress?'),
        ('["foo"]', 'output.fields has "foo", which is not a field. The fields are displacement, damage, strain'),
        ("3", "output.fields = 3 is not true or false or a list of names."),
        ('"stress"', 'output.fields = "stress" is not true or false or a list of names.'),
    ],
)
def test_what_is_no_list_of_fields_is_told(value, sentence):
    with pytest.raises(pdfem.DeckError) as error:
        tiny(f"output.fields={value}")
    assert sentence in str(error.value)


def test_a_wrong_name_in_python_is_told(scene):
    with pytest.raises(ValueError, match="Did you mean von_mises"):
        pdfem.Simulation(scene).fields("von_misses")
    assert tiny("output.fields=true").output.names == ("displacement",)
    assert tiny("output.fields=false").output.names == ()


def test_damage_may_be_asked_for_by_name(tmp_path):
    scene = tiny('output.fields=["damage"]')
    folder = pdfem.run(scene, tmp_path / "run")
    assert folder.points.names == ["damage"]
    assert folder.nodes.names == []
    with pytest.raises(pdfem.DeckError, match="no region has any"):
        tiny('output.fields=["damage"]', 'regions=[{name="a", model="finite_elements"}]')
