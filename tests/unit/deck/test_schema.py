"""The schema of decks: editors find every key with words, and accept the decks that the program accepts."""

import json
import tomllib

import pytest

from pdfem_mpi.deck.schema import SCHEMA_FILE, deck_schema
from support.helpers import ROOT
from support.tiny import TINY

jsonschema = pytest.importorskip("jsonschema", reason="the oracle of these tests (extra: test)")
JOBS = ROOT / "jobs"
DECKS = sorted(path.relative_to(JOBS).as_posix() for path in JOBS.glob("**/*.toml"))


@pytest.fixture(scope="module")
def validator():
    schema = deck_schema()
    jsonschema.Draft7Validator.check_schema(schema)
    return jsonschema.Draft7Validator(schema)


def test_the_decks_of_jobs_are_accepted(validator):
    assert len(DECKS) > 30
    for name in DECKS:
        validator.validate(tomllib.loads((JOBS / name).read_text("utf-8")))


@pytest.mark.parametrize(
    ("old", "new"),
    [
        ("youngs_modulus = 1000.0", "youngs_modulos = 1000.0"),
        ("youngs_modulus = 1000.0", 'youngs_modulus = "1000 MPa"'),
        ("spacing = 1.0", "spacing = -1.0"),
        ('model = "peridynamics"', 'model = "peridynamic"'),
        ('face = "x+"', 'face = "right"'),
        ("total = [1.0, 0.0, 0.0]", "total = [1.0, 0.0]"),
        ('kind = "body_force"\n', ""),
        ('kind = "box"', 'kind = "file"'),
        ("[solver]", "[solvers]"),
    ],
)
def test_what_the_program_refuses_by_key_and_value_is_refused(validator, old, new):
    assert old in TINY
    validator.validate(tomllib.loads(TINY))
    with pytest.raises(jsonschema.ValidationError):
        validator.validate(tomllib.loads(TINY.replace(old, new)))


def test_every_key_has_words():
    schema = deck_schema()
    tables = {**schema["definitions"], "the deck": schema}
    silent = [
        f"{name}.{key}"
        for name, table in tables.items()
        for key, value in table["properties"].items()
        if "description" not in value and "$ref" not in value
    ]
    assert not silent and all(table["description"] for table in tables.values())


def test_the_schema_beside_the_decks_is_that_of_the_program():
    """After a change of keys: pdfem schema > jobs/pdfem-schema.json."""
    assert json.loads((JOBS / SCHEMA_FILE).read_text("utf-8")) == deck_schema()


def test_decks_name_their_schema():
    for name in DECKS:
        first = (JOBS / name).read_text("utf-8").splitlines()[0]
        marker, _, path = first.partition(" ")
        assert marker == "#:schema" and ((JOBS / name).parent / path).resolve() == JOBS / SCHEMA_FILE, name
