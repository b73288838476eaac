"""No deck passes `check` and is refused by `run`: decks of jobs with one to three of their values changed at random."""

import copy
import itertools
import tomllib

import numpy as np
import pytest

from pdfem_mpi.deck.table import DeckError, SceneError
from pdfem_mpi.deck.toml import read_deck
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.checking import check_scene
from pdfem_mpi.runs.simulation import Simulation
from support.helpers import ROOT

JOBS = sorted((ROOT / "jobs").glob("*.toml")) + sorted((ROOT / "jobs" / "hard").glob("*.toml"))
FEW = ("hard/notched_beam", "hard/supports", "hard/eight_cells", "hard/twin_cracks")
#: Cells four times as wide, so that a set-up takes a part of a second; and most cells of what is tried.
WIDER, MOST_CELLS = 4.0, 4000
MUTANTS, MORE_MUTANTS = 4, 25
FACTORS = (0.0, -1.0, 0.5, 1.5, 1e3, 1e-3)
WORDS = (
    "x-",
    "y+",
    "z",
    "peridynamics",
    "finite_elements",
    "cg",
    "adr",
    "steps",
    "events",
    "ramp",
    "virial",
    "none",
    "",
)


def name_of(path):
    return path.relative_to(ROOT / "jobs").with_suffix("").as_posix()


def leaves(value, path=()):
    """Paths of all values in nested tables and lists."""
    if isinstance(value, dict | list) and value:
        items = value.items() if isinstance(value, dict) else enumerate(value)
        return list(itertools.chain.from_iterable(leaves(item, (*path, key)) for key, item in items))
    return [path]


def mutated(deck, rng):
    """A copy with one value changed, a key taken out, or a table doubled or dropped."""
    deck = copy.deepcopy(deck)
    path = leaves(deck)[rng.integers(len(leaves(deck)))]
    owner = deck
    for key in path[:-1]:
        owner = owner[key]
    value, key = owner[path[-1]], path[-1]
    way = rng.integers(6)
    if way == 0:
        del owner[key]
    elif way == 1:
        tables = [name for name, entry in deck.items() if isinstance(entry, list) and entry]
        if tables:
            chosen = deck[tables[rng.integers(len(tables))]]
            index = int(rng.integers(len(chosen)))
            chosen.insert(index, chosen[index]) if rng.integers(2) else chosen.pop(index)
    elif isinstance(value, bool):
        owner[key] = not value
    elif isinstance(value, int | float):
        owner[key] = type(value)(value * FACTORS[rng.integers(len(FACTORS))]) if value else float(rng.integers(-2, 3))
    elif isinstance(value, str):
        owner[key] = WORDS[rng.integers(len(WORDS))]
    return deck


def scene_of(deck):
    """The scene of a deck; None where its tables are refused, or where it is too large to be tried."""
    try:
        scene = read_deck(deck)
    except DeckError:
        return None
    cells = getattr(scene.mesh, "n_cells", (1,))
    return scene if np.prod(cells, dtype=float) <= MOST_CELLS else None


def refusals(make):
    try:
        make()
    except SceneError as error:
        return error.messages
    return []


def tried(path, count):
    """How many mutants of a deck were made ready and refused, by `check` and by a run alike."""
    deck = tomllib.loads(path.read_text(encoding="utf-8"))
    if path.parent.name == "jobs" and "spacing" in deck["mesh"]:
        deck["mesh"]["spacing"] *= WIDER
    if "path" in deck["mesh"]:
        deck["mesh"]["path"] = str(path.parent / deck["mesh"]["path"])
    rng, comm, seen, refused = np.random.default_rng([22, JOBS.index(path)]), mpi().COMM_SELF, 0, 0
    for _ in range(20 * count):
        mutant = deck
        for _ in range(rng.integers(1, 4)):
            mutant = mutated(mutant, rng)
        if (scene := scene_of(mutant)) is None:
            continue
        run = refusals(lambda: Simulation(scene, comm).prepare_solver())
        assert refusals(lambda: check_scene(scene, comm)) == run, mutant
        seen, refused = seen + 1, refused + bool(run)
        if seen == count:
            break
    return seen, refused


@pytest.mark.parametrize("name", FEW)
def test_no_deck_passes_check_and_is_refused_by_a_run(name):
    seen, _ = tried(ROOT / "jobs" / f"{name}.toml", MUTANTS)
    assert seen == MUTANTS


@pytest.mark.slow
@pytest.mark.parametrize("path", JOBS, ids=name_of)
def test_no_deck_of_many_passes_check_and_is_refused_by_a_run(path):
    tried(path, MORE_MUTANTS)
