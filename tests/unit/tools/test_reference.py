"""The pages of docs/reference: up to date, whole, and no link of any page leads nowhere."""

import itertools
import json
import re

import h5py
import pytest

import pdfem_mpi as pdfem
from pdfem_mpi.runs import history_rows
from tools.docs import links, pages
from tools.docs.command_page import commands
from tools.docs.deck_tables import deck_tables
from tools.docs.examples import example_of, is_valid
from tools.docs.result_pages import exit_code_names, undocumented, words

#: Softens and breaks, has every field and a probe of each kind but one; nothing of it needs to be a good model.
BREAKING = """
title = "Everything"
[mesh]
lower = [0.0, 0.0, 0.0]
upper = [5.0, 2.0, 2.0]
spacing = 1.0
[material]
youngs_modulus = 1000.0
tensile_strength = 2.0
fracture_energy = 0.05
[materials.stiff]
youngs_modulus = 2000.0
[[regions]]
name = "fe"
model = "finite_elements"
material = "stiff"
upper = [2.0, 2.0, 2.0]
[[regions]]
name = "pd"
model = "peridynamics"
lower = [2.0, 0.0, 0.0]
[peridynamics]
surface_correction = "none"
kinematics = "linear"
[[supports]]
name = "wall"
face = "x-"
x = 0.0
y = 0.0
z = 0.0
[[supports]]
face = "x+"
x = 0.02
[stepping]
times = [1.0]
[solver]
tolerance = 1e-3
[[probes]]
kind = "displacement"
name = "end"
point = [5.0, 1.0, 1.0]
[[probes]]
kind = "bar"
stress = 2.0
[[probes]]
kind = "line"
name = "along"
start = [0.0, 1.0, 1.0]
stop = [5.0, 1.0, 1.0]
n = 5
[[probes]]
kind = "point"
name = "place"
point = [0.5, 1.0, 1.0]
[[probes]]
kind = "set"
name = "bonds"
region = "pd"
[[probes]]
kind = "cut"
name = "plane"
point = [3.2, 1.0, 1.0]
normal = [1.0, 0.0, 0.0]
[[probes]]
kind = "opening"
name = "gap"
one = [1.0, 1.0, 1.0]
two = [5.0, 1.0, 1.0]
[output]
figures = false
fields = [
    "displacement", "damage", "strain", "stress", "principal_strains", "principal_stresses", "principal_axes",
    "von_mises", "energy_density", "strain_at_gauss_points", "stress_at_gauss_points",
]
"""


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A run folder with everything that a small run can have in it."""
    deck = tmp_path_factory.mktemp("everything") / "deck.toml"
    deck.write_text(BREAKING)
    run = pdfem.run(pdfem.read_deck(deck), deck.parent / "run")
    assert run.summary["failure"]["softened_bonds"]
    return deck.parent / "run"


def test_pages_are_up_to_date():
    """After a change of keys, columns, results or commands: tools/docs/reference."""
    assert not pages.outdated(), "run tools/docs/reference, which writes them"


@pytest.mark.parametrize("table", deck_tables(), ids=lambda table: table.title)
def test_every_key_has_a_meaning_and_an_example(table):
    """Meanings are those of the docstring of the table's class; an example is one that the key takes."""
    for name, field, meaning in table.keys:
        assert meaning, f"{table.model.__name__}.{name}: the docstring of its class does not say what it means"
        line = example_of(table, name, field)
        assert is_valid(field, line), f"{table.header}: {line} is refused. Correct tools/docs/words/examples.toml."


def test_columns_of_the_history(folder):
    known = [name for name, *_ in words("history")["columns"]]
    found = (folder / "history.csv").read_text().splitlines()[0].split(",")
    assert not undocumented(found, known), "add them to tools/docs/words/history.toml"
    tuples = [names for name, names in vars(history_rows).items() if name.endswith("HISTORY")]
    plain = {"time", "wall_seconds", *itertools.chain(*tuples)}
    assert {name for name in known if "<" not in name} == plain, "columns that are not there, or not described"


#: Tables of summary.json that the deck of these tests does not ask for.
OF_OTHER_DECKS = {"adaptive"}


def test_keys_of_the_summary(folder):
    known = [path for path, *_ in words("summary")["keys"]]
    found = list(paths_of(json.loads((folder / "summary.json").read_text())))
    assert not undocumented(found, known), "add them to tools/docs/words/summary.toml"
    assert {path.split(".")[0] for path in known} - OF_OTHER_DECKS == {path.split(".")[0] for path in found}


def test_datasets_of_the_fields(folder):
    known = words("fields")
    found, attributes = set(), set()

    def visit(name, item):
        place = name.removeprefix("VTKHDF/")
        attributes.update(f"{name}:{one}" for one in item.attrs)
        if isinstance(item, h5py.Dataset):
            found.add(place)

    for path in folder.glob("*.vtkhdf"):
        with h5py.File(path, locking=False) as file:
            attributes.update(file.attrs)
            file.visititems(visit)
    assert {path.name for path in folder.glob("*.vtkhdf")} == {name for name, _ in known["files"]}
    assert not undocumented(sorted(found), [name for name, *_ in known["datasets"]]), "words/fields.toml lacks them"
    assert {name for name, *_ in known["datasets"] if "<" not in name} <= found, "datasets that are not there"
    assert attributes == {name for name, _ in known["attributes"]}


def test_exit_codes():
    assert set(words("exit_codes")) == set(exit_code_names())


def test_commands():
    """That every command and option has words; the page itself is made from them."""
    for name, command in commands().items():
        assert command.help, name
        assert all(one.help for one in command.params if "--help" not in one.opts), name


def test_environment_variables():
    """Those that begin with the program's name, wherever the package reads them."""
    sources = [path.read_text("utf-8") for path in (links.ROOT / "pdfem_mpi").rglob("*.py")]
    found = {name for text in sources for name in re.findall(r"\"(PDFEM_[A-Z_]+)\"", text)}
    assert found and found <= {name for name, *_ in words("environment")["variables"]}


@pytest.mark.parametrize("page", links.pages(), ids=lambda page: page.relative_to(links.ROOT).as_posix())
def test_links_and_paths_lead_somewhere(page):
    assert not links.broken_links(page)


@pytest.mark.parametrize(
    "text",
    ["[a](nothing.md)", "[a](deck.md#nothing)", "![a](../figures/nothing.png)", "see `jobs/nothing.toml`"],
)
def test_broken_links_are_found(text, tmp_path, monkeypatch):
    monkeypatch.setattr(links, "ROOT", tmp_path)
    (tmp_path / "deck.md").write_text("# Deck: keys\n\n## There `x`\n")
    page = tmp_path / "page.md"
    page.write_text(f"{text} [b](deck.md#there-x)\n\n    [c](in_a_block.md)\n\n`[d](in_code.md)`\n")
    assert len(links.broken_links(page)) == 1


def paths_of(value, path=""):
    """Dotted paths of all keys that are no tables."""
    if isinstance(value, dict) and value:
        for name, item in value.items():
            yield from paths_of(item, f"{path}.{name}" if path else name)
    else:
        yield path
