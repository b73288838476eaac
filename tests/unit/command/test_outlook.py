"""How far a run is, in words; lines that fit a terminal, and colours only where there is one."""

import io

import pytest

from pdfem_mpi.command import outlook
from pdfem_mpi.command.console import ConsoleReporter
from pdfem_mpi.command.outlook import Outlook, clock, fitted
from pdfem_mpi.command.paint import RED, painted
from pdfem_mpi.deck.programs import Events, Steps
from support.bodies import make_scene

ROW = {
    "step": 3, "event": "critical", "load_factor": 0.25, "reaction": 80.0, "broken_bonds": 1234, "new_broken_bonds": 10,
    "evaluations": 40, "wall_seconds": 1.0, "crack_x_min": 0.0, "crack_x_max": 0.5, "crack_y_min": 1.0,
    "crack_y_max": 4.0, "crack_z_min": 0.0, "crack_z_max": 1.0,
}  # fmt: skip


class Terminal(io.StringIO):
    def isatty(self):
        return True


def scene(stepping):
    return make_scene((4, 2, 2)).model_copy(update={"stepping": stepping})


def test_peak_and_crack_are_told():
    seen = Outlook(scene(Events(kind="events")))
    assert seen.parts(ROW | {"reaction": 100.0}) == ["crack 3"]
    assert seen.parts(ROW) == ["80 % of peak", "crack 3"]
    assert seen.parts(ROW | {name: None for name in ROW if name.startswith("crack")}) == ["80 % of peak"]


def test_share_and_time_left_of_a_program_with_an_end(monkeypatch):
    now = [100.0]
    monkeypatch.setattr(outlook.time, "monotonic", lambda: now[0])
    seen = Outlook(scene(Events(kind="events", end_load_factor=1.0)))
    assert seen.parts(ROW)[-1] == "25 % done"  # one row tells no speed
    now[0] += 60.0
    assert seen.parts(ROW | {"load_factor": 0.5})[-2:] == ["50 % done", "~02:00 left"]
    assert seen.parts(ROW | {"load_factor": 1.0})[-1] == "100 % done"
    assert Outlook(scene(Steps(load_factors=(0.1, 0.2, 0.3, 0.4)))).share(ROW) == 0.75


@pytest.mark.parametrize(("seconds", "text"), [(5.0, "00:05"), (61.0, "01:01"), (7325.0, "2:02:05")])
def test_clock(seconds, text):
    assert clock(seconds) == text


@pytest.mark.parametrize("width", [1, 20, 60, 79, 200])
def test_no_line_is_wider_than_the_terminal(monkeypatch, width):
    stream = Terminal()
    monkeypatch.setattr("sys.stdout", stream)
    monkeypatch.setenv("COLUMNS", str(width))
    monkeypatch.setenv("NO_COLOR", "1")
    reporter = ConsoleReporter(scene(Events(kind="events")))
    reporter.row(ROW)
    reporter._beat(1e9, "row 123456  iteration 1234567  residual 1.23e-04 and much more of this")
    for line in stream.getvalue().replace("\r", "\n").split("\n"):
        assert len(line) < max(width, 2)


def test_the_first_parts_stay():
    assert fitted(["abc", "def", "ghi"], 9) == "abc  def"
    assert fitted(["abcdef"], 4) == "abcd"
    assert fitted(["abc", "def"], None) == "abc  def"


def test_colours_only_on_a_terminal(monkeypatch):
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")
    assert painted("warning: x", Terminal()) == "\x1b[33mwarning: x\x1b[0m"
    assert painted("deck: wrong", Terminal(), RED) == "\x1b[31mdeck: wrong\x1b[0m"
    assert painted("pdfem: note: x", Terminal(), RED) == "pdfem: note: x" == painted("pdfem: note: x", io.StringIO())
    assert painted("warning: x", io.StringIO()) == "warning: x"
    monkeypatch.setenv("NO_COLOR", "1")
    assert painted("warning: x", Terminal()) == "warning: x"
