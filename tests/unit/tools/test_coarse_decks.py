"""The coarse form of every deck of ``jobs/``, which benchmarks run, is a deck: a new one has its settings there."""

import pytest

from pdfem_mpi.deck.toml import read_deck
from support.helpers import ROOT
from tools.benchmarks import decks

MOST_CELLS = 20_000


@pytest.mark.parametrize("name", decks.names())
def test_coarse_decks_are_decks_of_few_cells(name):
    overrides = [setting.removeprefix("--set=") for setting in decks.settings(name)]
    mesh = read_deck(ROOT / "jobs" / f"{name}.toml", overrides).mesh
    if hasattr(mesh, "lower"):  # else it is a small file
        edges = [upper - lower for lower, upper in zip(mesh.lower, mesh.upper, strict=True)]
        assert edges[0] * edges[1] * edges[2] / mesh.spacing**3 <= MOST_CELLS
