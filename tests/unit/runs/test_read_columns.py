"""Probes and named supports are columns of history.csv."""

import csv
import json

import numpy as np
import pytest

from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.run import run
from pdfem_mpi.runs.simulation import Simulation
from support.reporters import Listener, Silence
from support.restarts import alone
from support.tiny import TINY

ROUND_OFF = 1e-12  # of sums of eight products
PROBES = """
[[probes]]
kind = "displacement"
name = "tip"
point = [4.0, 2.0, 2.0]
[[probes]]
kind = "displacement"
name = "two words"
point = [1.5, 0.3, 0.7]
[[probes]]
kind = "opening"
name = "stretch"
one = [0.0, 1.0, 1.0]
two = [4.0, 1.0, 1.0]
[[probes]]
kind = "set"
name = "all"
lower = [0.0, 0.0, 0.0]
fields = ["displacement", "stress"]
[output]
fields = false
figures = false
[stepping]
load_factors = [0.5, 1.0]
"""
NAMED = TINY.replace('face = "x-"\n', 'face = "x-"\nname = "wall"\n')
NAMED = NAMED.replace('face = "x+"\n', 'face = "x+"\nname = "pull"\n')


def rows_of(folder):
    with (folder / "history.csv").open(newline="") as file:
        return list(csv.DictReader(file))


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    out = tmp_path_factory.mktemp("gauges") / "run"
    text = NAMED + PROBES
    assert run(parse_deck(text, "deck.toml"), mpi().COMM_SELF, out, text, True, Silence()) == 0
    return out


def test_columns_are_called_by_their_probes(folder):
    columns = list(rows_of(folder)[0])
    named = [f"{name}.u_{axis}" for name in ("tip", "two words") for axis in "xyz"]
    named += ["stretch.opening", *(f"all.u_{axis}" for axis in "xyz")]
    named += [f"{name}.force_{axis}" for name in ("wall", "pull") for axis in "xyz"]
    assert columns[13:] == [*named, "wall_seconds"]


def test_columns_are_what_the_summary_has(folder):
    """The last row: the same interpolation on gathered fields, in another order of sums."""
    probes, last = json.loads((folder / "summary.json").read_text())["probes"], rows_of(folder)[-1]
    for name in ("tip", "two words"):
        found = [float(last[f"{name}.u_{axis}"]) for axis in "xyz"]
        assert found == pytest.approx(probes[name], rel=ROUND_OFF, abs=1e-18)
    assert probes["stretch"] == float(last["stretch.opening"]) > 0.0


def test_a_named_support_is_the_reaction(folder):
    """It is the only one; the load is 1 along x."""
    for row in rows_of(folder):
        for axis in "xyz":
            assert row[f"wall.force_{axis}"] == row[f"reaction_{axis}"]
        assert float(row["wall.force_x"]) == pytest.approx(-float(row["load_factor"]), rel=1e-5)


def test_a_named_load_is_its_force(folder):
    for row in rows_of(folder):
        assert float(row["pull.force_x"]) == pytest.approx(float(row["load_factor"]), rel=ROUND_OFF)
        assert float(row["pull.force_y"]) == float(row["pull.force_z"]) == 0.0


def test_the_mean_over_a_set_is_that_of_its_volume(folder):
    """Of a linear field exactly, on elements, on bonds and across both; in the summary, as the last row has it."""
    simulation = Simulation(parse_deck(NAMED + PROBES, "deck.toml"), mpi().COMM_SELF)
    gradient = np.array([[1.0, 0.5, -0.25], [0.125, -0.5, 2.0], [-1.0, 0.75, 0.25]])
    simulation.displace(lambda x: 1.0 + x @ gradient.T)
    gauges, state = simulation.gauges.of_displacements, simulation.state
    found = [gauges[f"all.u_{axis}"].read(simulation.comm, state.u) * simulation.share.units.length for axis in "xyz"]
    assert found == pytest.approx(1.0 + gradient @ (2.0, 1.0, 1.0), rel=ROUND_OFF)
    probe = json.loads((folder / "summary.json").read_text())["probes"]["all"]
    assert probe["displacement"]["mean"] == [float(rows_of(folder)[-1][f"all.u_{axis}"]) for axis in "xyz"]
    assert set(probe) == {"displacement", "stress"}


def test_a_simulation_has_the_same_columns():
    simulation = Simulation(parse_deck(NAMED + PROBES, "deck.toml"), mpi().COMM_SELF)
    row = simulation.solve(1.0)
    assert {"tip.u_x", "stretch.opening", "wall.force_x"} <= set(row)


def test_a_run_that_goes_on_with_more_probes_has_more_columns(tmp_path):
    """They are empty in the rows before."""
    plain = TINY + PROBES[PROBES.index("[output]") :].replace("[0.5, 1.0]", "[0.5]")
    assert alone(parse_deck(plain, "deck.toml"), tmp_path / "run") == 0
    reporter = Listener()
    scene = parse_deck(NAMED + PROBES, "deck.toml")
    assert alone(scene, tmp_path / "run", reporter=reporter, resume="continue") == 0, reporter.lines
    first, last = rows_of(tmp_path / "run")
    assert (first["tip.u_x"], first["step"]) == ("", "1") and float(last["tip.u_x"]) > 0.0
    assert float(first["wall_seconds"]) > 0.0 and not list((tmp_path / "run").glob("history.csv.*"))


@pytest.mark.parametrize(
    ("old", "new", "says"),
    [
        ('name = "wall"', 'name = "tip"', 'supports.0.name = "tip" is the name of probes.0 already'),
        ('name = "wall"', 'name = "my wall"', 'supports.0.name = "my wall" names columns of history.csv. Use letters'),
        ('name = "two words"', 'name = "two\\nlines"', "has a line break"),
        ('name = "stretch"', 'name = "a.b"', 'probes.2.name = "a.b" names columns'),
    ],
)
def test_names_that_columns_cannot_have_are_refused(old, new, says):
    with pytest.raises(Exception, match=says):
        parse_deck((NAMED + PROBES).replace(old, new), "deck.toml")
