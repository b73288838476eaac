"""Decks to begin with: each is sound as it is written, and nothing that is there is written over."""

import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.command.beginning import TEMPLATES, NotBegun, begin
from pdfem_mpi.deck.schema import SCHEMA_FILE
from pdfem_mpi.deck.toml import read_deck
from support.helpers import run_pdfem


@pytest.mark.parametrize("template", TEMPLATES)
def test_every_deck_is_sound(tmp_path, template):
    files = begin(tmp_path / "a deck", template)
    deck = tmp_path / "a deck.toml"
    assert deck in files and (tmp_path / SCHEMA_FILE) in files
    text = deck.read_text("utf-8")
    assert text.startswith(f"#:schema {SCHEMA_FILE}\n") and "NAME" not in text and "MESH" not in text
    scene = read_deck(deck)
    assert scene.solver.kind == "cg" and scene.peridynamics.surface_correction == "virial"
    assert scene.kinematics == "linear" and scene.is_coupled
    assert len(discretize(scene).mesh.cells) < 2000  # a run of a minute
    if scene.can_fail:
        assert scene.output.damage and any(region.may_fail is False for region in scene.regions)


def test_what_is_there_is_left_alone(tmp_path):
    begin(tmp_path / "part", "bracket")
    (tmp_path / "part.toml").unlink()
    before = (tmp_path / "part.inp").read_bytes()
    with pytest.raises(NotBegun, match=r"part\.inp is there already"):
        begin(tmp_path / "part", "bracket")
    assert (tmp_path / "part.inp").read_bytes() == before and not (tmp_path / "part.toml").exists()


def test_a_schema_that_is_there_stays(tmp_path):
    (tmp_path / SCHEMA_FILE).write_text("{}")
    begin(tmp_path / "bar.toml", "bar")
    assert (tmp_path / SCHEMA_FILE).read_text() == "{}"


@pytest.mark.parametrize(
    ("arguments", "code", "words"),
    [
        (("part", "--from", "braket"), 64, "Did you mean bracket?"),
        (("part", "--from", "frame"), 64, "is none of bar, plate, bending, bracket, experiment."),
        (("file/part",), 73, "cannot be written ("),
    ],
)
def test_bad_input_is_a_sentence(tmp_path, arguments, code, words):
    (tmp_path / "file").write_text("")
    result = run_pdfem("init", *arguments, cwd=tmp_path)
    assert result.returncode == code and words in result.stderr and "Traceback" not in result.stderr


def test_the_command_writes_and_says_what_is_next(tmp_path):
    result = run_pdfem("init", "my bar", cwd=tmp_path)
    assert result.returncode == 0
    assert result.stdout.splitlines()[-1] == "next: pdfem check 'my bar.toml', pdfem run 'my bar.toml'"
