"""Studies: members from a deck and values, what is kept and what is run, and what a person is told."""

import csv
import json
import os
import re
import shlex
import signal
import sys
import threading
import time
from itertools import pairwise
from pathlib import Path

import matplotlib.image
import pytest

from pdfem_mpi.command.study import (
    Interruption,
    StudyError,
    changed_members,
    figure,
    make_members,
    parse_axes,
    run_study,
    running,
)
from pdfem_mpi.deck.toml import read_deck
from pdfem_mpi.results.run_folder import numbers_of
from support.helpers import ROOT, run_pdfem

DECK = ROOT / "jobs" / "bar_pd.toml"
SPACINGS = "mesh.spacing=0.2,0.1"


@pytest.fixture
def no_picture(monkeypatch):
    """Leave out what takes most of the time."""
    monkeypatch.setattr(figure, "draw_study", lambda *arguments: None)


def members_of(*texts, overrides=(), deck=DECK):
    return make_members(deck, parse_axes(texts), overrides)


def messages(make):
    with pytest.raises(StudyError) as caught:
        make()
    return caught.value.messages


def summary_of(member, code=0, **more):
    n = float(member.scene.mesh.spacing)
    return {
        "exit_code": code,
        "reason": None if code == 0 else "the residual rests at 3e-3",
        "deck_sha256": member.sha256,
        "solve": {"evaluations": 12},
        "probes": {"end_displacement": 10 * n, "right_end": [n, 1e-12, -n]},
        "seconds": {"total": 1.5},
        **more,
    }


class Runs:
    """A stand-in for the runs: writes summaries, and fails members as told."""

    def __init__(self, fail=None):
        self.fail = fail or {}
        self.started = []

    def __call__(self, member, folder, overwrite):
        self.started.append((member.label, overwrite))
        code = self.fail.get(member.values[0][1], 0)
        if code >= 0 and code != 64:
            folder.mkdir(parents=True, exist_ok=True)
            (folder / "deck.toml").write_text(member.text)
            (folder / "summary.json").write_text(json.dumps(summary_of(member, code)))
        return code, "bar.toml: mesh is broken. Mend it."


def go(folder, runs, *texts, report=None, overrides=(), **options):
    axes = parse_axes(texts)
    members = make_members(DECK, axes, overrides)
    return run_study(members, axes, folder, runs, report or (lambda text: None), **options)


def rows_of(folder):
    with open(folder / "study.csv", newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


def test_studies_in_the_comments_of_decks_are_sound():
    """Commands that a reader copies from jobs/: every member is a deck without problems."""
    counts = []
    for deck in sorted((ROOT / "jobs").glob("*.toml")):
        lines = deck.read_text(encoding="utf-8").splitlines()
        comment = "\n".join(line.lstrip("# ") for line in lines if line.startswith("#"))
        for command in re.findall(r"pdfem study .*", comment.replace("\\\n", " ")):
            words = shlex.split(command)
            axes = parse_axes([after for word, after in pairwise(words) if word == "--vary"])
            overrides = [after for word, after in pairwise(words) if word == "--set"]
            counts.append(len(make_members(ROOT / words[2], axes, overrides)))
    assert len(counts) >= 3 and min(counts) >= 2  # those of appendix B


def test_all_combinations_the_last_axis_fastest():
    members = members_of(SPACINGS, "peridynamics.surface_correction=none,appendix_a")
    assert [member.overrides for member in members] == [
        [f"mesh.spacing={h}", f"peridynamics.surface_correction={c}"]
        for h in ("0.2", "0.1")
        for c in ("none", "appendix_a")
    ]
    assert [member.scene.mesh.spacing for member in members] == [0.2, 0.2, 0.1, 0.1]
    assert members[1].scene == read_deck(DECK, members[1].overrides)


def test_keys_that_change_together():
    values = "mesh.lower:mesh.upper=[-5.0,-0.2,-0.1]:[5.0,0.2,0.1],[-5.0,-0.2,-0.2]:[5.0,0.2,0.2]"
    members = members_of(values, overrides=["mesh.spacing=0.1"])
    assert [member.scene.mesh.upper for member in members] == [(5.0, 0.2, 0.1), (5.0, 0.2, 0.2)]
    assert [member.scene.mesh.lower for member in members] == [(-5.0, -0.2, -0.1), (-5.0, -0.2, -0.2)]
    places = members_of("mesh.lower.2:mesh.upper.2=-0.1:0.1,-0.2:0.2", overrides=["mesh.spacing=0.1"])
    assert [member.scene for member in places] == [member.scene for member in members]


def test_folders_have_names_of_their_own():
    members = members_of('title="a b","a_b","a/b",' + ",".join(f'"{"long" * 30}{k}"' for k in range(2)))
    names = [member.name for member in members]
    assert len(set(names)) == len(names)
    assert all(len(name) < 255 and "/" not in name and " " not in name for name in names)


@pytest.mark.parametrize(
    ("texts", "overrides", "words"),
    [
        (["mesh.spacing"], [], ["--vary mesh.spacing: must read key=value1,value2"]),
        (["mesh.spacing=0.1,,0.2"], [], ["must read key=value1,value2"]),
        (["a:b=1:2,3"], [], ["--vary a:b=1:2,3: 3 has 1 values for 2 keys"]),
        ([SPACINGS, "mesh.spacing=0.4"], [], ["--vary mesh.spacing: this key is varied twice"]),
        ([SPACINGS], ["mesh.spacing=0.4"], ["--set mesh.spacing=0.4: --vary changes this key too"]),
        (["mesh.spacing=0.2,0.20"], [], ["members mesh.spacing=0.2 and mesh.spacing=0.20 are the same deck"]),
        (
            ["mesh.spacing=0.2,0.07,-1"], [],
            ["= 0.07 does not divide", "(member mesh.spacing=0.07)", "= -1 is out of range"],
        ),
        (["mesh.spcing=0.2"], [], ["Did you mean spacing?"]),
        (["solver.max_evaluations=" + ",".join(map(str, range(1, 1002)))], [], ["makes 1,001 members"]),
    ],
    ids=["no value", "empty", "uneven", "twice", "set too", "same", "bad values", "typo", "too many"],
)  # fmt: skip
def test_bad_variations_are_told_all_at_once(texts, overrides, words):
    found = messages(lambda: members_of(*texts, overrides=overrides))
    for word in words:
        assert any(word in message for message in found), found
    assert len(set(found)) == len(found)


def test_finished_members_are_kept_and_the_rest_is_run(tmp_path, no_picture):
    """A study that stopped goes on with the members that are left; other values join the finished ones."""
    first = Runs()
    assert go(tmp_path, first, "mesh.spacing=0.2") == 0
    second, told = Runs(), []
    assert go(tmp_path, second, "mesh.spacing=0.1,0.2,0.05", report=told.append) == 0
    assert second.started == [("mesh.spacing=0.1", False), ("mesh.spacing=0.05", False)]
    assert told[1] == "2/3 mesh.spacing=0.2: finished before"
    assert told[0] == "1/3 mesh.spacing=0.1: finished, 12 evaluations, 1.5 s"
    assert [row["mesh.spacing"] for row in rows_of(tmp_path)] == ["0.1", "0.2", "0.05"]
    third = Runs()
    assert go(tmp_path, third, "mesh.spacing=0.1,0.2,0.05") == 0
    assert third.started == []


def test_a_failed_member_is_listed_and_the_rest_goes_on(tmp_path, no_picture):
    told = []
    runs = Runs({"0.1": 74, "0.05": 64, "0.04": -9})
    code = go(tmp_path, runs, "mesh.spacing=0.1,0.2,0.05,0.04", report=told.append)
    assert code == 74  # of the first that failed
    rows = rows_of(tmp_path)
    assert [row["status"] for row in rows] == ["not converged", "finished", "refused", "failed"]
    assert [row["exit_code"] for row in rows] == ["74", "0", "64", "-9"]
    assert rows[0]["reason"] == "the residual rests at 3e-3"
    assert rows[2]["reason"] == "bar.toml: mesh is broken. Mend it."
    assert rows[3]["reason"].startswith("ended by signal 9")
    assert [row["end_displacement"] for row in rows] == ["", "2.0", "", ""]
    assert told[2] == "3/4 mesh.spacing=0.05: refused (bar.toml: mesh is broken. Mend it.)"
    again = Runs()
    assert go(tmp_path, again, "mesh.spacing=0.1,0.2,0.05,0.04") == 0
    assert again.started == [("mesh.spacing=0.1", True), ("mesh.spacing=0.05", False), ("mesh.spacing=0.04", False)]


def test_a_member_that_was_stopped_is_not_overwritten(tmp_path, no_picture):
    """Exit 75 leaves a checkpoint: the same run goes on."""
    assert go(tmp_path, Runs({"0.1": 75}), SPACINGS) == 75
    again = Runs()
    assert go(tmp_path, again, SPACINGS) == 0
    assert again.started == [("mesh.spacing=0.1", False)]


def test_a_changed_deck_is_told_with_its_keys(tmp_path, no_picture):
    assert go(tmp_path, Runs(), SPACINGS) == 0
    changed = members_of(SPACINGS, overrides=["solver.tolerance=1e-3"])
    found = changed_members(changed, tmp_path)
    assert len(found) == 2
    assert "members/mesh.spacing=0.2: was run with another deck" in found[0]
    assert "(solver.tolerance = 1e-06, now 0.001)" in found[0] and "--overwrite" in found[0]
    assert changed_members(members_of(SPACINGS), tmp_path) == []
    runs = Runs()  # with --overwrite
    assert go(tmp_path, runs, SPACINGS, overrides=["solver.tolerance=1e-3"]) == 0
    assert runs.started == [("mesh.spacing=0.2", True), ("mesh.spacing=0.1", True)]


def test_a_deck_that_changes_under_way_is_told(tmp_path, no_picture):
    def start(member, folder, overwrite):
        folder.mkdir(parents=True)
        (folder / "summary.json").write_text(json.dumps(summary_of(member) | {"deck_sha256": "another"}))
        return 0, ""

    assert go(tmp_path, start, "mesh.spacing=0.2") == 70
    assert rows_of(tmp_path)[0]["reason"] == "its deck was changed while the study ran"


def test_the_table_is_there_after_every_member(tmp_path, no_picture):
    seen = []

    def start(member, folder, overwrite):
        seen.append([row["status"] for row in rows_of(tmp_path)])
        return Runs()(member, folder, overwrite)

    go(tmp_path, start, "mesh.spacing=0.2,0.1,0.05")
    assert seen == [["waiting"] * 3, ["finished", "waiting", "waiting"], ["finished", "finished", "waiting"]]
    assert list(rows_of(tmp_path)[0])[-1] == "seconds.total"
    assert not list(tmp_path.glob("*.tmp"))


def test_results_of_a_summary_are_flat():
    (member,) = members_of("mesh.spacing=0.2")
    found = numbers_of(
        summary_of(member, later={"n": 3, "deep": {"x": [1.0, 2.0, 3.0]}, "of_ranks": [7, 8, 9]}, ranks=3)
    )
    assert found == {
        "solve.evaluations": 12, "end_displacement": 2.0, "right_end_x": 0.2, "right_end_y": 1e-12, "right_end_z": -0.2,
        "later.n": 3, "later.deep.x_x": 1, "later.deep.x_y": 2, "later.deep.x_z": 3, "seconds.total": 1.5,
    }  # fmt: skip
    assert list(found)[-1] == "seconds.total"


def test_figure_has_a_panel_for_each_probe_and_a_curve_for_each_other_value(tmp_path, monkeypatch):
    drawn = []
    monkeypatch.setattr(figure, "draw_study", lambda *arguments: drawn.append(arguments))
    go(tmp_path, Runs(), SPACINGS, "peridynamics.surface_correction=none,appendix_a")
    path, series, along, units, title, note = drawn[0]
    assert path == tmp_path / "study.png" and along == "mesh.spacing (in)" and "peridynamics only" in title
    corrections = ("none", "appendix_a")
    assert [curve.label for curve in series] == [f"peridynamics.surface_correction = {c}" for c in corrections]
    assert series[0].x == ["0.2", "0.1"]
    # a component that symmetry makes 0 is left out
    assert series[0].results == {"end_displacement": [2.0, 1.0], "right_end_x": [0.2, 0.1], "right_end_z": [-0.2, -0.1]}
    assert units == {"end_displacement": "in", "right_end_x": "in", "right_end_z": "in"} and note == ""


def test_figure_with_failed_members_and_words_on_the_axis(tmp_path):
    go(tmp_path, Runs({"none": 74}), "peridynamics.surface_correction=none,appendix_a", SPACINGS)
    picture = matplotlib.image.imread(tmp_path / "study.png")
    assert min(picture.shape[:2]) > 300
    assert (tmp_path / "study.png").stat().st_size < 200_000


def test_unknown_result_to_plot_is_told_and_the_table_is_kept(tmp_path):
    found = messages(lambda: go(tmp_path, Runs(), SPACINGS, wanted=["end_dis"]))
    assert "--plot end_dis: no such result" in found[0] and "end_displacement" in found[0]
    assert len(rows_of(tmp_path)) == 2


STAND_IN = """#!{python}
import signal, sys, time
def stop(number, frame):
    sys.exit(75)
if {minds}:
    signal.signal(signal.SIGTERM, stop)
    signal.signal(signal.SIGUSR1, stop)
open({ready!r}, "w").close()
time.sleep(60)
"""


@pytest.mark.parametrize("minds", [True, False], ids=["writes a checkpoint", "is killed by it"])
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGUSR1, signal.SIGINT], ids=lambda n: n.name)
def test_a_signal_is_passed_on_and_ends_the_study(tmp_path, monkeypatch, number, minds):
    """The member that runs is asked to stop, no other is started, and the exit code says that it can go on."""
    program, ready = tmp_path / "python", tmp_path / "ready"
    program.write_text(STAND_IN.format(python=sys.executable, ready=str(ready), minds=minds))
    program.chmod(0o755)
    monkeypatch.setattr(running.sys, "executable", str(program))

    def interrupt():
        deadline = time.monotonic() + 20
        while not ready.exists() and time.monotonic() < deadline:
            time.sleep(0.01)
        os.kill(os.getpid(), number)

    thread = threading.Thread(target=interrupt)
    thread.start()
    interruption = Interruption()
    before = signal.getsignal(number)
    code = go(tmp_path, running.starter(DECK, [], None, interruption), SPACINGS, interruption=interruption)
    thread.join()
    assert code == 75
    assert [row["status"] for row in rows_of(tmp_path)] == ["stopped", "waiting"]
    assert signal.getsignal(number) is before


def test_command_runs_members_and_says_where_the_table_is(tmp_path):
    """A small run from the command line that does not converge is in the table, and its code is the study's."""
    folder = tmp_path / "runs" / "small"
    command = ["study", DECK, "--set", "solver.kind=cg", "--set", "mesh.spacing=0.4", "--out", folder]
    command += ["--set", "peridynamics.surface_correction=none", "--vary", "solver.max_evaluations=2"]
    done = run_pdfem(*command, timeout=110)  # a first run compiles the kernels
    assert done.returncode == 74, done.stderr
    lines = done.stdout.splitlines()
    assert lines[0].startswith("1/1 solver.max_evaluations=2: not converged (")
    assert lines[1] == f"pdfem: study finished, members failed; results in {folder / 'study.csv'}"
    (row,) = rows_of(folder)
    assert row["status"] == "not converged" and "max_evaluations" in row["reason"]
    assert "max_evaluations" in (folder / "logs" / f"{Path(row['folder']).name}.log").read_text(encoding="utf-8")


def test_command_refuses_bad_values_before_anything_runs(tmp_path):
    done = run_pdfem("study", DECK, "--vary", "mesh.spacing=0.1,0.07", "--out", tmp_path / "new")
    assert done.returncode == 64
    assert "does not divide" in done.stderr and "Traceback" not in done.stderr
    assert not (tmp_path / "new").exists()


def test_command_refuses_to_start_under_a_launcher(tmp_path):
    done = run_pdfem("study", DECK, "--vary", SPACINGS, "--out", tmp_path, PMI_SIZE="2", PMI_RANK="0")
    assert done.returncode == 64
    assert "PMI_SIZE is set" in done.stderr
    assert not list(Path(tmp_path).iterdir())
