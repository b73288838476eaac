"""A run that ends anywhere goes on as if it had not: kills, full disks, damaged files, on one rank."""

import errno
import json
import os
import shutil
from unittest.mock import patch

import numpy as np
import pytest

from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.outputs import Checkpoint, DisplacementProbe, Output
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.results import checkpoint, vtkhdf
from pdfem_mpi.results.checkpoint import check
from pdfem_mpi.results.checkpoint_files import list_checkpoints
from pdfem_mpi.system import faults
from pdfem_mpi.system.lock import Lock
from support.reporters import Listener
from support.restarts import FACTORS, StopAt, alone, differing, in_child, often, outcome, relaxed

FINISHED, USAGE, NO_CHECKPOINT, NOT_WRITTEN, NOT_CONVERGED, STOPPED = 0, 64, 65, 73, 74, 75
MIDDLE = 100  # a safe point in the second of three steps
KILLS, CYCLES = 20, 200


@pytest.fixture(scope="module")
def straight(tmp_path_factory):
    """What the uninterrupted run gives."""
    out = tmp_path_factory.mktemp("straight") / "run"
    assert alone(often(), out) == FINISHED
    return outcome(out)


@pytest.fixture(scope="module")
def stopped(tmp_path_factory):
    """A run that was stopped in its second step, with three checkpoints."""
    out = tmp_path_factory.mktemp("stopped") / "run"
    assert alone(often(), out, requests=StopAt(MIDDLE)) == STOPPED
    assert len(list_checkpoints(out / "checkpoints")) == 3
    return out


@pytest.fixture
def out(stopped, tmp_path):
    """A copy of it to spoil."""
    return shutil.copytree(stopped, tmp_path / "run")


def files(out):
    return [path for _, path in list_checkpoints(out / "checkpoints")]


def summary(out):
    return json.loads((out / "summary.json").read_text(encoding="utf-8"))


def has_ended(out):
    return (out / "summary.json").exists() and summary(out)["status"] == "finished"


def place(path):
    state = check(path)["state"]
    return state["step"], state["iteration"]


def mostly_slow(names, few):
    """All of them with --all, a few by default."""
    return [name if name in few else pytest.param(name, marks=pytest.mark.slow) for name in names]


# --- kills ------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("phase", mostly_slow(faults.PHASES, ("write", "replace")))
def test_a_process_that_ends_in_any_phase_of_a_checkpoint_loses_nothing(tmp_path, straight, phase):
    """The fifth checkpoint is interrupted: three older ones are sound, and the same command goes on."""
    out = tmp_path / "run"
    assert in_child(lambda: alone(often(), out), PDFEM_CRASH_AT=f"{phase}:5") == faults.CRASHED
    assert all(check(path) for path in files(out))
    assert len(files(out)) == (4 if phase in ("outcome", "rotate") else 3)
    reporter = Listener()
    assert alone(often(), out, reporter=reporter) == FINISHED
    assert reporter.said("did not end by itself") and reporter.said("going on from")
    assert not differing(outcome(out), straight)
    assert not list(out.glob("checkpoints/*.tmp.*"))


@pytest.mark.parametrize("seed", mostly_slow(range(KILLS), (0,)))
def test_kills_at_random_times_lose_nothing(tmp_path, straight, seed):
    """Killed until a start survives, the last one unharmed: the same bits. Always a sound file or a fresh start.

    A kill may come when a run has said its last word and its process is not yet gone: then it has survived.
    """
    rng, out = np.random.default_rng(seed), tmp_path / "run"
    for _ in range(3):
        code = in_child(lambda: alone(often(), out), kill_after=rng.uniform(0.0, 0.6))
        if code == FINISHED or has_ended(out):
            break
        assert all(check(path) for path in files(out))
    else:
        assert alone(often(), out) == FINISHED
    assert not differing(outcome(out), straight)


@pytest.mark.slow
def test_a_run_killed_before_its_first_checkpoint_starts_again(tmp_path, straight):
    out, reporter = tmp_path / "run", Listener()
    assert in_child(lambda: alone(often(), out), PDFEM_CRASH_AT="agree:1") == faults.CRASHED
    assert alone(often(), out, reporter=reporter, resume="continue") == FINISHED
    assert reporter.said("there is no checkpoint yet")
    assert not differing(outcome(out), straight)


# --- stops ------------------------------------------------------------------------------------------------


def in_pieces(scene, out, length, **ways):
    """Stop at every n-th safe point, and go on, to the end; return how often."""
    stops = 0
    while (code := alone(scene, out, requests=StopAt(length), **ways)) == STOPPED:
        stops += 1
        assert summary(out)["exit_code"] == STOPPED and summary(out)["status"] == "stopped"
    assert code == FINISHED
    return stops


def test_stops_in_all_steps_change_nothing(tmp_path, straight):
    out = tmp_path / "run"
    stops = in_pieces(relaxed(), out, 37)
    assert stops >= 3
    assert not differing(outcome(out), straight)
    assert len(summary(out)["restarts"]) == stops


@pytest.mark.slow
def test_a_start_for_every_iteration_is_one_run(tmp_path, straight):
    """Some hundred starts and stops of one iteration each."""
    out = tmp_path / "run"
    assert in_pieces(relaxed(), out, 2) > 0.5 * CYCLES
    assert not differing(outcome(out), straight)


@pytest.mark.slow
def test_every_checkpoint_of_a_run_leads_to_the_same_end(tmp_path, straight):
    """One after each iteration and step is kept aside; each is gone on from."""
    out, aside = tmp_path / "run", tmp_path / "aside"
    scene = relaxed(checkpoint=Checkpoint(iterations=1, steps=1, keep=1000))
    assert alone(scene, out) == FINISHED
    paths = files(out)
    assert len(paths) > 100
    for path in paths:
        shutil.rmtree(aside, ignore_errors=True)
        shutil.copytree(out, aside)
        (aside / "summary.json").unlink()
        assert alone(relaxed(), aside, resume=str(aside / "checkpoints" / path.name)) == FINISHED
        assert not differing(outcome(aside), straight), path.name


@pytest.mark.parametrize("kind", mostly_slow(["cg linear", "cg finite", "elements", "peridynamics"], ["elements"]))
def test_other_scenes_go_on_too(tmp_path, kind):
    """Conjugate gradients stop between steps; parts that a scene has not are not in its files."""
    tables = {"stepping": Steps(load_factors=FACTORS), "output": Output(figures=False)}
    from support.bodies import make_scene

    scene = {
        "cg linear": lambda: make_scene((9, 3, 2), 4, solver="cg", **tables),
        "cg finite": lambda: make_scene((9, 3, 2), 4, solver="cg", kinematics="finite", **tables),
        "elements": lambda: make_scene((5, 2, 2), 5, tolerance=1e-3, **tables),
        "peridynamics": lambda: make_scene((5, 2, 2), 0, tolerance=1e-3, **tables),
    }[kind]()
    assert alone(scene, tmp_path / "straight") == FINISHED
    assert in_pieces(scene, tmp_path / "run", 2 if "cg" in kind else 25) >= 2
    assert not differing(outcome(tmp_path / "run"), outcome(tmp_path / "straight"))


@pytest.mark.slow
def test_relaxation_after_a_breakdown_of_conjugate_gradients_goes_on(tmp_path):
    """Not with conjugate gradients from the middle, which would be another path."""
    from pdfem_mpi.solvers import cg
    from pdfem_mpi.solvers.convergence import Breakdown

    def break_down(*arguments, **options):
        raise Breakdown("for a test.")

    scene = relaxed(solver="cg")
    with patch.object(cg, "solve", break_down):
        assert alone(scene, tmp_path / "straight") == FINISHED
        assert alone(scene, tmp_path / "run", requests=StopAt(MIDDLE)) == STOPPED
    with patch.object(cg, "solve", side_effect=AssertionError("conjugate gradients")) as solver:
        assert alone(scene, tmp_path / "run", requests=StopAt(2)) == STOPPED
    assert not solver.called
    with patch.object(cg, "solve", break_down):
        assert alone(scene, tmp_path / "run") == FINISHED
    assert not differing(outcome(tmp_path / "run"), outcome(tmp_path / "straight"))


@pytest.mark.slow
def test_a_stop_before_the_first_step_is_a_checkpoint_of_the_beginning(tmp_path, straight):
    out = tmp_path / "run"
    assert alone(often(), out, requests=StopAt(1)) == STOPPED
    assert place(files(out)[0]) == (0, 0)
    assert alone(often(), out, requests=StopAt(1)) == STOPPED
    assert len(files(out)) == 1  # the same state is not written again
    assert alone(often(), out) == FINISHED
    assert not differing(outcome(out), straight)


def test_a_stop_while_a_checkpoint_is_written_waits_for_the_next_safe_point(tmp_path, straight):
    out, requests = tmp_path / "run", StopAt(10**9)

    def during(phase, begin=faults.begin):
        if phase == "verify":
            requests.n = 0
        begin(phase)

    with patch.object(faults, "begin", during):
        assert alone(often(), out, requests=requests) == STOPPED
    assert [place(path) for path in files(out)] == [(0, 21), (0, 20)]
    assert alone(often(), out) == FINISHED
    assert not differing(outcome(out), straight)


# --- damaged checkpoints ----------------------------------------------------------------------------------


def flipped(path):
    data = bytearray(path.read_bytes())
    data[len(data) // 2] ^= 16
    path.write_bytes(data)


def cut(path):
    path.write_bytes(path.read_bytes()[:-1])


def folder_instead(path):
    path.unlink()
    path.mkdir()


SPOILED = {
    "flipped": (flipped, "damaged or cut off"),
    "cut": (cut, "damaged or cut off"),
    "empty": (lambda path: path.write_bytes(b""), "it is empty"),
    "folder": (folder_instead, "it is not a file"),
    "text": (lambda path: path.write_text("x" * 5000), "no checkpoint of pdfem_mpi"),
}


@pytest.mark.parametrize("how", mostly_slow(SPOILED, ("flipped", "folder")))
def test_the_one_before_a_spoiled_one_serves_and_it_is_said_why(out, straight, how):
    spoil, reason = SPOILED[how]
    newest, before = files(out)[:2]
    spoil(newest)
    (out / "checkpoints" / "ckpt-000099.h5.tmp.1").write_bytes(b"torn")
    reporter = Listener()
    assert alone(often(), out, reporter=reporter) == FINISHED
    assert reporter.said(newest.name, "is passed over", reason) and reporter.said(f"going on from {before.name}")
    assert newest.with_name(f"{newest.name}.damaged").exists()
    assert not list(out.glob("checkpoints/*.tmp.*"))
    assert any(reason in note for note in summary(out)["restarts"][-1]["notes"])
    assert not differing(outcome(out), straight)


@pytest.mark.slow
def test_a_missing_newest_one_is_not_missed(out, straight):
    files(out)[0].unlink()
    assert alone(often(), out) == FINISHED
    assert not differing(outcome(out), straight)


def test_no_sound_checkpoint_is_65_and_nothing_is_touched(out):
    for path in files(out):
        flipped(path)
    before = sorted(path.name for path in out.rglob("*"))
    reporter = Listener()
    assert alone(often(), out, reporter=reporter) == NO_CHECKPOINT
    assert all(reporter.said(path.name) for path in files(out)) and reporter.said("--overwrite")
    assert sorted(path.name for path in out.rglob("*")) == before
    assert alone(often(), out, overwrite=True) == FINISHED


def test_a_newer_format_is_refused_and_not_passed_over(out, monkeypatch):
    monkeypatch.setattr(checkpoint._seal_of, "__defaults__", (checkpoint.FORMAT + 1,))
    checkpoint._seal(files(out)[0])
    monkeypatch.undo()
    reporter = Listener()
    assert alone(often(), out, reporter=reporter) == NO_CHECKPOINT
    assert reporter.said("of a newer pdfem_mpi")


# --- results beside the checkpoint ------------------------------------------------------------------------


def test_rows_and_frames_after_the_checkpoint_are_not_there_twice(tmp_path, straight):
    """Killed between two checkpoints, after a step: its row and frames are cut off and written again."""
    out = tmp_path / "run"
    scene = relaxed(checkpoint=Checkpoint(iterations=45))
    assert in_child(lambda: alone(scene, out), PDFEM_CRASH_AT="agree:2") == faults.CRASHED
    assert place(files(out)[0]) == (0, 45)
    assert len((out / "history.csv").read_text().splitlines()) == 2
    assert alone(scene, out) == FINISHED
    assert not differing(outcome(out), straight)


def torn_row(path):
    with path.open("ab") as file:
        file.write(b"2,0.5,1")


def torn_frame(path):
    """Data of a frame whose count was not written yet."""
    with vtkhdf.guarded(path, "r+") as file:
        values = file["VTKHDF/PointData/displacement"]
        values.resize(len(values) + 7, axis=0)


@pytest.mark.parametrize(("name", "tear"), [("history.csv", torn_row), ("points.vtkhdf", torn_frame)])
def test_torn_results_are_cut_back(out, straight, name, tear):
    tear(out / name)
    assert alone(often(), out) == FINISHED
    assert not differing(outcome(out), straight)


def fewer_rows(out):
    path = out / "history.csv"
    path.write_text("".join(path.read_text().splitlines(keepends=True)[:-1]))


def fewer_frames(out):
    vtkhdf.truncate(out / "elements.vtkhdf", 0)


@pytest.mark.parametrize(
    ("shorten", "name"),
    [(fewer_rows, "history.csv"), pytest.param(fewer_frames, "elements.vtkhdf", marks=pytest.mark.slow)],
)
def test_results_shorter_than_the_checkpoint_says_step_aside_and_it_serves(tmp_path, straight, shorten, name):
    """Not an older one: deleting the file would let the newest go on as well."""
    out = tmp_path / "run"
    scene = relaxed(checkpoint=Checkpoint(iterations=45))
    assert alone(scene, out, requests=StopAt(MIDDLE)) == STOPPED
    newest = files(out)[0]
    shorten(out)
    reporter = Listener()
    assert alone(scene, out, reporter=reporter) == FINISHED
    assert reporter.said("warning", name, "begins anew") and reporter.said(f"going on from {newest.name}")
    assert (out / f"{name}.damaged").exists()
    assert not [line for line in differing(outcome(out), straight) if not line.startswith(name.partition(".")[0])]


@pytest.mark.parametrize("name", ["history.csv", "points.vtkhdf"])
@pytest.mark.parametrize("how", mostly_slow(["missing", "damaged"], ["damaged"]))
def test_unreadable_results_step_aside(out, straight, name, how):
    """The run goes on to the same end; rows and frames of before are in the damaged file, if at all."""
    path = out / name
    if how == "missing":
        path.unlink()
    else:
        path.write_bytes(b"\0" * path.stat().st_size)
    reporter = Listener()
    assert alone(often(), out, reporter=reporter) == FINISHED
    assert reporter.said("warning", name, "begins anew")
    assert path.with_name(f"{name}.damaged").exists() == (how == "damaged")
    assert any("begins anew" in note for note in summary(out)["restarts"][-1]["notes"])
    found = outcome(out)
    assert found["fields"] == straight["fields"] and found["checkpoint"] == straight["checkpoint"]
    others = [line for line in differing(found, straight) if not line.startswith(("history", "points"))]
    assert not others


# --- checkpoints that cannot be written -------------------------------------------------------------------


class Failing:
    """``os.replace`` of checkpoints fails, some times."""

    def __init__(self, times, number=errno.ENOSPC):
        self.times, self.number, self.call = times, number, os.replace

    def __call__(self, source, target):
        if "ckpt-" in str(source) and self.times:
            self.times -= 1
            raise OSError(self.number, os.strerror(self.number))
        self.call(source, target)


@pytest.mark.parametrize("number", mostly_slow([errno.ENOSPC, errno.EIO], [errno.EIO]))
@pytest.mark.parametrize("times", mostly_slow([1, 2], [2]))
def test_one_or_two_failures_are_warnings(tmp_path, straight, monkeypatch, times, number):
    reporter = Listener()
    monkeypatch.setattr(os, "replace", Failing(times, number))
    assert alone(often(), tmp_path / "run", reporter=reporter) == FINISHED
    assert sum("warning" in line and os.strerror(number) in line for line in reporter.lines) == times
    assert summary(tmp_path / "run")["checkpoints"]["failed"] == times
    assert not differing(outcome(tmp_path / "run"), straight)


@pytest.mark.slow
def test_three_failures_in_a_row_are_73_and_the_run_can_go_on(out, straight, monkeypatch):
    reporter = Listener()
    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", Failing(3))
        assert alone(often(), out, reporter=reporter) == NOT_WRITTEN
    assert reporter.said("3 times in a row")
    assert alone(often(), out) == FINISHED
    assert not differing(outcome(out), straight)


def test_a_stop_that_cannot_be_kept_is_73(out, straight, monkeypatch):
    with monkeypatch.context() as patched:
        patched.setattr(os, "replace", Failing(1))
        assert alone(often(), out, requests=StopAt(5)) == NOT_WRITTEN
    assert summary(out)["status"] == "stopped without a checkpoint"
    assert alone(often(), out) == FINISHED
    assert not differing(outcome(out), straight)


@pytest.mark.parametrize("name", mostly_slow(["points.vtkhdf", "history.csv"], ["points.vtkhdf"]))
def test_results_that_cannot_be_written_end_the_run_and_it_goes_on_later(out, straight, name):
    """A full disk while a frame or a row is written: 73 without a traceback, and nothing is lost."""
    from pdfem_mpi.results import history

    def full(*arguments, **options):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), name)

    where = (vtkhdf, "append_frame") if name == "points.vtkhdf" else (history.History, "append")
    reporter = Listener()
    with patch.object(*where, full):
        assert alone(often(), out, reporter=reporter) == NOT_WRITTEN
    assert reporter.said(name, "No space left")
    assert alone(often(), out) == FINISHED
    assert not differing(outcome(out), straight)


def test_a_read_only_folder_is_73(out, monkeypatch):
    def refuse(*arguments, **options):
        raise OSError(errno.EROFS, os.strerror(errno.EROFS), str(arguments[0]))

    reporter = Listener()
    monkeypatch.setattr("pathlib.Path.write_text", refuse)
    assert alone(often(), out, reporter=reporter) == NOT_WRITTEN
    assert reporter.said("Read-only file system")


# --- which run it is --------------------------------------------------------------------------------------


def test_another_scene_is_refused_with_all_its_keys(out):
    reporter = Listener()
    scene = often(solver="cg")
    scene = scene.model_copy(update={"material": Material(youngs_modulus=2.0)})
    assert alone(scene, out, reporter=reporter) == NO_CHECKPOINT
    assert reporter.said('solver.kind was "adr", the deck has "cg"', "material.youngs_modulus was 1000.0")
    assert summary(out)["status"] == "stopped"


def test_force_goes_on_and_is_recorded(out):
    scene = often().model_copy(update={"material": Material(youngs_modulus=999.0)})
    assert alone(scene, out, force=True) == FINISHED
    assert any("forced: material.youngs_modulus" in note for note in summary(out)["restarts"][-1]["notes"])


def test_changes_that_make_sense_are_told(out):
    probe = DisplacementProbe(kind="displacement", name="end", point=(9.0, 1.5, 1.0))
    scene = often(max_evaluations=500, probes=(probe,), title="longer")
    scene = scene.model_copy(update={"stepping": Steps(load_factors=(*FACTORS, 1.5))})
    reporter = Listener()
    assert alone(scene, out, reporter=reporter) == FINISHED
    assert reporter.said("note: solver.max_evaluations was 20000, the deck has 500")
    assert reporter.said("note: stepping.load_factors was")
    assert summary(out)["probes"].keys() == {"end"} and summary(out)["solve"]["load_steps"] == 4


def test_other_fields_begin_new_files_of_frames(out, straight):
    """A frame must have the fields of those before it in its file."""
    reporter = Listener()
    assert alone(often(output=Output(figures=False, damage=True)), out, reporter=reporter) == FINISHED
    assert reporter.said("points.vtkhdf begins anew: output was changed")
    assert vtkhdf.frames(out / "points.vtkhdf.before") == 1 and vtkhdf.frames(out / "points.vtkhdf") == 2
    found = outcome(out)
    assert found["history"] == straight["history"] and found["checkpoint"] == straight["checkpoint"]


@pytest.mark.slow
def test_another_version_of_packages_is_told(out, monkeypatch):
    monkeypatch.setattr(np, "__version__", "0.0")
    reporter = Listener()
    assert alone(often(), out, reporter=reporter) == FINISHED
    assert reporter.said("another packages")


def test_a_finished_run_is_not_overwritten_and_can_be_made_longer(tmp_path, straight):
    out, reporter = tmp_path / "run", Listener()
    short = often(stepping=Steps(load_factors=FACTORS[:2]))
    assert alone(short, out) == FINISHED
    assert alone(often(), out, reporter=reporter) == USAGE
    assert reporter.said("already holds a run. Use --overwrite")
    assert alone(short, out, reporter=reporter, resume="continue") == FINISHED
    assert reporter.said("is finished already")
    assert alone(often(), out, resume="continue") == FINISHED
    assert not differing(outcome(out), straight)


def test_a_finished_run_without_checkpoints_is_not_begun_anew_unasked(tmp_path):
    out, reporter = tmp_path / "run", Listener()
    assert alone(often(), out) == FINISHED
    for path in files(out):
        path.unlink()
    before = summary(out)
    assert alone(often(), out, reporter=reporter, resume="continue") == NO_CHECKPOINT
    assert reporter.said("is finished, and no checkpoint is left to go on from")
    assert summary(out) == before


def test_a_run_killed_after_its_last_step_only_writes_its_summary(tmp_path, straight):
    out = tmp_path / "run"
    with patch("pdfem_mpi.runs.finishing.write_summary", side_effect=RuntimeError), pytest.raises(RuntimeError):
        alone(often(), out)
    assert alone(often(), out) == FINISHED
    assert not differing(outcome(out), straight)


def test_a_step_that_fails_leaves_the_last_good_state(tmp_path, straight):
    """Too few evaluations for the second step; with more of them the run goes on to the same end."""
    counts = [int(row[8]) for row in straight["history"][1:]]
    assert straight["history"][0][8] == "evaluations" and counts[1] > counts[0]
    out = tmp_path / "run"
    assert alone(relaxed(max_evaluations=counts[0]), out) == NOT_CONVERGED
    assert place(files(out)[0])[0] == 1 and summary(out)["status"] == "not converged"
    assert alone(relaxed(), out) == FINISHED
    assert not differing(outcome(out), straight)


@pytest.mark.slow
def test_never_starts_only(out, tmp_path):
    assert alone(often(), out, resume="never") == USAGE
    assert alone(relaxed(), tmp_path / "new", resume="never") == FINISHED


def test_a_named_checkpoint_of_the_same_folder(out, straight):
    older = files(out)[2]
    assert alone(often(), out, resume=str(older)) == FINISHED
    assert len(list(out.glob("checkpoints/*.superseded"))) == 2
    assert not differing(outcome(out), straight)


@pytest.mark.slow
def test_a_named_checkpoint_of_another_folder(out, tmp_path, straight):
    """Its fields and end are the same; the new folder's history begins at it."""
    new = tmp_path / "new"
    assert alone(often(), new, resume=str(files(out)[0])) == FINISHED
    found = outcome(new)
    assert found["fields"] == straight["fields"] and found["checkpoint"] == straight["checkpoint"]
    assert found["history"] == straight["history"][:1] + straight["history"][2:]


@pytest.mark.parametrize("what", ["missing", "damaged"])
def test_a_named_checkpoint_that_cannot_be_used_is_65(out, tmp_path, what):
    path = files(out)[0]
    if what == "missing":
        path.unlink()
    else:
        flipped(path)
    reporter = Listener()
    assert alone(often(), out, resume=str(path), reporter=reporter) == NO_CHECKPOINT
    assert reporter.said(path.name, "there is no such file" if what == "missing" else "damaged")


# --- the folder -------------------------------------------------------------------------------------------


def test_two_jobs_in_one_folder(out):
    held, reporter = Lock(out), Listener()
    assert alone(often(), out, reporter=reporter) == NOT_WRITTEN
    assert reporter.said("writes into this folder", "--steal-lock")
    held.release()


def test_a_refused_run_leaves_no_folder_behind(tmp_path):
    reporter = Listener()
    path = tmp_path / "ckpt-000001.h5"
    assert alone(often(), tmp_path / "a" / "b", resume=str(path), reporter=reporter) == NO_CHECKPOINT
    assert not (tmp_path / "a").exists()


def test_the_log_has_every_start(out):
    reporter = Listener()
    assert alone(often(), out, reporter=reporter) == FINISHED
    log = (out / "run.log").read_text(encoding="utf-8")
    assert log.count("stopped: asked to stop") == 1 and log.count("going on from") == 1
    assert all(line in log for line in reporter.lines)
