"""Texts of a deck are printed and drawn as they are, whatever a terminal or a figure would take them for."""

import json
import shutil

import pytest

from pdfem_mpi.deck.outputs import BarProbe, LineProbe, Output
from pdfem_mpi.deck.table import Units
from pdfem_mpi.deck.toml import parse_deck, write_deck
from pdfem_mpi.results import plots
from pdfem_mpi.results.labels import MOST, as_it_is, attempt
from pdfem_mpi.runs.outputs import Outputs
from support.bodies import make_scene
from support.helpers import run_pdfem
from support.reporters import Listener
from support.restarts import alone
from support.tiny import TINY

FINISHED = 0
#: Marks of a terminal that close nothing, links, and what looks like a formula and is none.
MARKED = "[bold]x[/red] [/] [link=http://x] :smile:"
FORMULA = r"$x_{ $ \frac{$ \$ $\frac{$"


def small(**tables):
    """A coupled bar with a line and an exact answer, so that all figures of an intact body are drawn."""
    probes = (
        LineProbe(kind="line", name="l", start=(0.0, 0.5, 0.5), stop=(4.0, 0.5, 0.5), n=5),
        BarProbe(kind="bar", stress=1.0),
    )
    tables = {"probes": probes, "output": Output(fields=False)} | tables
    return make_scene((4, 2, 2), 2, correction="none", solver="cg", **tables)


def test_marks_of_a_terminal_in_title_names_and_units_are_printed(tmp_path):
    """The command line, whose tables go through rich: `[mm]` stood nowhere, and `[/red]` ended the finished run."""
    deck = tmp_path / "deck.toml"
    deck.write_text(write_deck(small(title=MARKED, units=Units(length="[mm]", force="[/N]"), output=Output(fields=False,
                                     figures=False))), encoding="utf-8")  # fmt: skip
    result = run_pdfem("run", deck, "--out", tmp_path / "[x]", COLUMNS="150")
    assert result.returncode == FINISHED, result.stdout + result.stderr
    assert result.stdout.count(MARKED) >= 2 and "[mm]" in result.stdout
    assert json.loads((tmp_path / "[x]" / "summary.json").read_text())["title"] == MARKED
    info = run_pdfem("info", tmp_path / "[x]", COLUMNS="150")
    assert info.returncode == FINISHED and "[x]" in info.stdout


@pytest.mark.slow
def test_a_terminal_without_the_characters_of_a_title(tmp_path):
    deck = tmp_path / "deck.toml"
    deck.write_text(write_deck(small(title="Zugstab, Länge 10 µm", output=Output(fields=False, figures=False))))
    result = run_pdfem("run", deck, "--out", tmp_path / "run", PYTHONIOENCODING="ascii")
    assert result.returncode == FINISHED, result.stderr
    assert r"L\xe4nge" in result.stdout


def test_what_looks_like_a_formula_is_drawn_as_it_is(tmp_path):
    reporter = Listener()
    scene = small(title=FORMULA, units=Units(length=r"$\frac{$", force="$"))
    assert alone(scene, tmp_path / "run", reporter=reporter) == FINISHED
    assert not reporter.said("was not drawn")
    assert (tmp_path / "run" / "figures" / "line_l.png").stat().st_size > 10_000
    assert (tmp_path / "run" / "figures" / "axial_displacement.png").stat().st_size > 10_000


@pytest.mark.parametrize("text", [FORMULA, "$a$", "a$b", r"\$", "$" * 7, "100 %", r"a\n", "{", "^_"])
def test_texts_reach_a_figure_unchanged(text):
    """matplotlib's own parser says what it would draw: no formula, and the very characters."""
    from matplotlib.text import Text

    drawn, is_formula = Text()._preprocess_math(as_it_is(text))
    if is_formula:  # it draws \$ as $ there too, and all else outside of $...$ as it is
        assert drawn.replace(r"\$", "").count("$") == 0
        drawn = drawn.replace(r"\$", "$")
    assert drawn == text


def test_long_titles_are_shortened():
    assert len(as_it_is("x" * 100_000)) == MOST


def test_a_figure_that_cannot_be_drawn_is_a_warning(tmp_path, monkeypatch):
    def fails(*arguments, **options):
        raise ValueError("no font\nfor this")

    monkeypatch.setattr(plots, "displacement_along_line", fails)
    reporter = Listener()
    assert alone(small(), tmp_path / "run", reporter=reporter) == FINISHED
    assert reporter.said("warning: the figure line_l.png was not drawn (ValueError: no font for this)")
    assert (tmp_path / "run" / "summary.json").exists()
    assert (tmp_path / "run" / "figures" / "axial_displacement.png").exists()


def test_a_folder_for_figures_that_cannot_be_made_is_a_warning(tmp_path, monkeypatch):
    close = Outputs.close

    def occupied(self):
        (self.place.written.folder / "figures").write_text("in the way")
        close(self)

    monkeypatch.setattr(Outputs, "close", occupied)
    reporter = Listener()
    assert alone(small(), tmp_path / "run", reporter=reporter) == FINISHED
    assert reporter.said("warning: the figure", "was not drawn")


@pytest.mark.slow
def test_a_damaged_history_is_no_traceback_of_plot(tmp_path):
    (tmp_path / "deck.toml").write_text(write_deck(small()), encoding="utf-8")
    (tmp_path / "history.csv").write_text("step,event,load_factor,broken_bonds\n1,step,1.0,x7\n")
    result = run_pdfem("plot", tmp_path)
    assert result.returncode == 65 and "history.csv or points.vtkhdf is damaged" in result.stderr


def test_attempt_returns_what_was_drawn(tmp_path):
    said = []
    assert attempt(lambda: None, tmp_path / "a.png", said.append) == [tmp_path / "a.png"] and not said
    assert attempt(lambda: 1 / 0, tmp_path / "a.png", said.append) == [] and "division" in said[0]


@pytest.mark.slow
@pytest.mark.parametrize("name", ["title_rich", "mathtext_line"])
def test_decks_whose_texts_ended_a_run(tmp_path, name):
    """Once and again: the second one failed at every resume as well."""
    deck = tmp_path / f"{name}.toml"
    deck.write_text(DECKS[name], encoding="utf-8")
    result = run_pdfem("run", deck, "--out", tmp_path / "run", COLUMNS="150")
    assert result.returncode == FINISHED, result.stdout + result.stderr
    assert parse_deck(DECKS[name], "deck").title in result.stdout
    assert "was not drawn" not in result.stdout
    shutil.rmtree(tmp_path / "run" / "figures", ignore_errors=True)
    assert run_pdfem("resume", tmp_path / "run", COLUMNS="150").returncode == FINISHED


LINE = '[[probes]]\nkind = "line"\nname = "l"\nstart = [0.0, 1.0, 1.0]\nstop = [4.0, 1.0, 1.0]\n'
DECKS = {
    "title_rich": f'title = "[bold]x[/red] [/] [link=http://x]"\n[units]\nlength = "mm"\nforce = "N"\n{TINY}',
    "mathtext_line": f'title = "$x_{{ $"\n[units]\nlength = "$\\\\frac{{$"\nforce = "N"\n{TINY}{LINE}',
}
