"""A run folder that something damaged: an equal end, or told, or refused; nothing is different in silence."""

import json
import shutil
from pathlib import Path

import h5py
import numpy as np
import pytest

from pdfem_mpi.deck.outputs import Checkpoint, DisplacementProbe, LineProbe, Output
from pdfem_mpi.deck.table import DeckError
from pdfem_mpi.deck.toml import read_deck
from pdfem_mpi.results import checkpoint
from pdfem_mpi.results.checkpoint import Invalid, check
from pdfem_mpi.results.checkpoint_files import list_checkpoints
from pdfem_mpi.results.guarded import guarded
from support.reporters import Listener
from support.restarts import StopAt, alone, differing, in_child, outcome, relaxed

FINISHED, USAGE, NO_CHECKPOINT, STOPPED = 0, 64, 65, 75
#: Files whose content is not the same in two runs of one deck, or says nothing about its results.
NOT_COMPARED = ("run.log", "RUNNING")
SEEDS, FEW = 200, 10


def scene(**tables):
    """A short bar with all kinds of results, a checkpoint now and then."""
    probes = (
        DisplacementProbe(kind="displacement", name="end", point=(9.0, 1.0, 1.0)),
        LineProbe(kind="line", name="axis", start=(0.0, 1.5, 1.0), stop=(9.0, 1.5, 1.0), n=11),
    )
    tables = {"probes": probes, "checkpoint": Checkpoint(iterations=45)} | tables
    return relaxed(**tables)


@pytest.fixture(scope="module")
def folders(tmp_path_factory):
    """A run that was stopped in its second step, the same run finished, and another run of another deck, finished."""
    where = tmp_path_factory.mktemp("folders")
    assert alone(scene(), where / "stopped", requests=StopAt(140)) == STOPPED
    assert alone(scene(output=Output()), where / "finished") == FINISHED
    assert alone(scene(internal_length=1.2), where / "other", requests=StopAt(140)) == STOPPED
    assert alone(scene(), where / "straight") == FINISHED
    return where


@pytest.fixture(scope="module")
def straight(folders):
    return everything(folders / "straight")


@pytest.fixture
def out(folders, tmp_path):
    return shutil.copytree(folders / "stopped", tmp_path / "run")


def everything(out):
    """All results of a run: those of a restart, the deck, lines, and what the summary tells beside times."""
    found = outcome(out)
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    found |= {key: summary[key] for key in ("title", "status", "exit_code", "counts", "mesh", "deck_sha256")}
    found["deck.toml"] = (out / "deck.toml").read_bytes()
    for path in sorted((out / "lines").glob("*")):
        found[f"lines/{path.name}"] = path.read_bytes()
    return found


# --- one by one -------------------------------------------------------------------------------------------


def flip(path, place, bit=0):
    data = bytearray(path.read_bytes())
    data[place] ^= 1 << bit
    path.write_bytes(data)


def first_number(path, name="PointData/displacement"):
    """Where the numbers of a dataset begin in a file of frames."""
    with h5py.File(path) as file:
        data = file[f"VTKHDF/{name}"]
        return data.id.get_offset() if data.chunks is None else data.id.get_chunk_info(0).byte_offset


def test_a_changed_digit_of_the_history_is_told_and_the_checkpoint_stays_good(out, straight):
    """As many rows and bytes as before: only a digest sees it."""
    path = out / "history.csv"
    flip(path, path.read_bytes().rindex(b"."), 0)  # another character in place of a point
    damaged, reporter = path.read_bytes(), Listener()
    assert alone(scene(), out, reporter=reporter) == FINISHED
    assert reporter.said("warning", "history.csv begins anew", "not those that were written")
    assert (out / "history.csv.damaged").read_bytes() == damaged
    assert not [name for name in differing(everything(out), straight) if not name.startswith("history")]


@pytest.mark.parametrize("name", ["points.vtkhdf", pytest.param("elements.vtkhdf", marks=pytest.mark.slow)])
@pytest.mark.parametrize("what", ["displacement", pytest.param("Points", marks=pytest.mark.slow)])
def test_a_changed_bit_of_a_frame_or_of_the_geometry_is_told(out, straight, name, what):
    flip(out / name, first_number(out / name, "Points" if what == "Points" else "PointData/displacement") + 100, 3)
    reporter = Listener()
    assert alone(scene(), out, reporter=reporter) == FINISHED
    assert reporter.said("warning", f"{name} begins anew", "not those that were written")
    assert (out / f"{name}.damaged").exists()
    assert not [part for part in differing(everything(out), straight) if not part.startswith(name)]


def test_a_truncated_history_does_not_cost_the_checkpoint(out, straight):
    """Deleting the file would let the same checkpoint go on; a shorter one must not be worse."""
    path = out / "history.csv"
    path.write_bytes(path.read_bytes()[:40])
    reporter = Listener()
    assert alone(scene(), out, reporter=reporter) == FINISHED
    assert reporter.said("warning", "history.csv begins anew") and reporter.said("going on from")
    assert not [name for name in differing(everything(out), straight) if not name.startswith("history")]


def test_a_second_damaged_file_does_not_replace_the_first(out):
    for text in ("first", "second"):
        (out / "history.csv").write_text(text)
        assert alone(scene(), out, requests=StopAt(1)) == STOPPED
    assert (out / "history.csv.damaged").read_text() == "first"
    assert (out / "history.csv.damaged.2").read_text() == "second"


@pytest.mark.parametrize("name", ["summary.json", "points.vtkhdf"])
def test_what_is_of_another_run_is_told(folders, out, straight, name):
    """A summary of a finished run of another deck would say that nothing is left to do."""
    source = "finished" if name == "summary.json" else "other"
    shutil.copy(folders / source / name, out / name)
    reporter = Listener()
    assert alone(scene(), out, reporter=reporter, resume="continue") == FINISHED
    assert reporter.said(name, "of another run")
    assert not [part for part in differing(everything(out), straight) if not part.startswith(name)]


@pytest.mark.parametrize(
    "name", ["history.csv", "summary.json", *(pytest.param(name, marks=pytest.mark.slow) for name in
                                              ("elements.vtkhdf", "lines/axis.csv"))]
)  # fmt: skip
def test_a_finished_run_with_a_damaged_file_is_not_said_to_be_in_order(folders, tmp_path, name):
    out, reporter = shutil.copytree(folders / "finished", tmp_path / "run"), Listener()
    before = everything(out)
    assert alone(scene(output=Output()), out, reporter=reporter, resume="continue") == FINISHED
    assert reporter.said("is finished already")
    flip(out / name, first_number(out / name) if name.endswith("hdf") else (out / name).stat().st_size // 2, 1)
    reporter = Listener()
    assert alone(scene(output=Output()), out, reporter=reporter, resume="continue") == FINISHED
    grows = name in ("history.csv", "elements.vtkhdf")
    assert reporter.said(Path(name).name, "begins anew" if grows else "it is written again")
    assert not reporter.said("is finished already")
    lost = ("history", "solve", "balance") if name == "history.csv" else (name,)  # the last row is in the damaged file
    assert not [part for part in differing(everything(out), before) if not part.startswith(lost)]


@pytest.mark.parametrize("how", ["flipped", "deleted"])
def test_a_finished_run_without_its_last_checkpoint_makes_its_end_again(folders, tmp_path, how):
    out, reporter = shutil.copytree(folders / "finished", tmp_path / "run"), Listener()
    before, path = everything(out), list_checkpoints(out / "checkpoints")[0][1]
    if how == "flipped":
        flip(path, 3000)
    else:
        path.unlink()
    assert alone(scene(output=Output()), out, reporter=reporter, resume="continue") == FINISHED
    assert reporter.said("going on from") and not reporter.said("is finished already")
    assert reporter.said(path.name, "is passed over") == (how == "flipped")
    assert not differing(everything(out), before)


def test_a_changed_title_of_the_deck_is_told(folders, out):
    reporter = Listener()
    assert alone(scene(title="another"), out, reporter=reporter) == FINISHED
    assert reporter.said("note", 'title was "", the deck has "another"')


def test_checkpoints_without_digests_still_serve(out, straight):
    """Those of older versions: their results are taken as they are, and it is said."""
    path = list_checkpoints(out / "checkpoints")[0][1]
    change_header(path, lambda header: [cursor.pop(key, 0) for cursor in header["results"].values()
                                        for key in ("sha256", "deck")])  # fmt: skip
    reporter = Listener()
    assert alone(scene(), out, reporter=reporter) == FINISHED
    assert reporter.said("taken as they are", "history.csv, points.vtkhdf, elements.vtkhdf")
    assert not differing(everything(out), straight)


# --- checkpoints that someone put together ----------------------------------------------------------------


def change_header(path, change):
    header = check(path)
    change(header)
    text = np.frombuffer(json.dumps(header).encode(), np.uint8)
    edit(path, lambda file: replace(file, "header", data=text))


def edit(path, change):
    """Change a checkpoint with HDF5 and seal it again."""
    with h5py.File(path, "r+", libver=("v110", "v110")) as file:
        change(file)
    checkpoint._seal(path)


def replace(file, name, **options):
    del file[name]
    file.create_dataset(name, **options)


def link(file):
    del file["points/u"]
    file["points/u"] = h5py.ExternalLink("elsewhere.h5", "u")


def soft(file):
    del file["points/u"]
    file["points/u"] = h5py.SoftLink("/nodes/u")


def virtual(file):
    shape = file["points/u"].shape
    layout = h5py.VirtualLayout(shape, "f8")
    layout[:] = h5py.VirtualSource("elsewhere.h5", "u", shape)
    del file["points/u"]
    file.create_virtual_dataset("points/u", layout)


def external(file):
    shape = file["points/u"].shape
    replace(file, "points/u", shape=shape, dtype="f8", external=[("elsewhere.bin", 0, h5py.h5f.UNLIMITED)])


BUILT = {
    "external link": (link, "has a link in place of /points/u"),
    "soft link": (soft, "has a link in place of /points/u"),
    "virtual": (virtual, "has its /points/u in other files (a virtual dataset)"),
    "external storage": (external, "has its /points/u in another file (external storage)"),
    "two columns": (lambda f: replace(f, "points/u", data=np.zeros((5, 2))), "its table points/u has shape (5, 2)"),
    "integers": (lambda f: replace(f, "nodes/u", data=np.zeros((5, 3), int)), "its table nodes/u has shape (5, 3)"),
    "a further table": (lambda f: f.create_dataset("more", data=1.0), "has more, which no checkpoint has"),
    "no broken": (lambda f: f.pop("broken"), "has no table broken"),
}


@pytest.mark.parametrize("how", BUILT)
def test_a_checkpoint_that_someone_put_together_is_refused_by_name(out, how):
    change, reason = BUILT[how]
    path = list_checkpoints(out / "checkpoints")[0][1]
    edit(path, change)
    with pytest.raises(Invalid) as error:
        check(path)
    assert reason in str(error.value)


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        (lambda header: header.pop("keys"), "its header has no keys"),
        (lambda header: header["state"].update(step="two"), "its header has state.step of type str"),
        (lambda header: header["state"].update(bounds={}), "state.bounds of another form"),
        (lambda header: header["results"].update({"../x": {"frames": 1}}), "results.../x of another form"),
        (lambda header: header.update(broken_bonds=3), "its table broken has shape (0, 2)"),
    ],
)
def test_a_header_of_another_form_is_refused_by_name(out, change, reason):
    path = list_checkpoints(out / "checkpoints")[0][1]
    change_header(path, change)
    with pytest.raises(Invalid) as error:
        check(path)
    assert reason in str(error.value)


def test_tables_of_another_body_are_refused_before_a_number_is_used(out):
    path, reporter = list_checkpoints(out / "checkpoints")[0][1], Listener()

    def shorten(file):
        for name in file["points"]:
            replace(file, f"points/{name}", data=file[f"points/{name}"][:-8])

    edit(path, shorten)
    assert alone(scene(), out, reporter=reporter) == NO_CHECKPOINT
    assert reporter.said("its table points/u has shape", "the scene needs")


def test_frames_that_lead_to_another_file_are_not_appended_to(out, tmp_path):
    """An external link with the very same content: the digest alone would not see it."""
    shutil.copy(out / "points.vtkhdf", tmp_path / "victim.h5")
    with guarded(out / "points.vtkhdf", "r+") as file:
        del file["VTKHDF/PointData/displacement"]
        file["VTKHDF/PointData/displacement"] = h5py.ExternalLink(
            str(tmp_path / "victim.h5"), "VTKHDF/PointData/displacement"
        )
    before, reporter = (tmp_path / "victim.h5").read_bytes(), Listener()
    assert alone(scene(), out, reporter=reporter) == FINISHED
    assert reporter.said("points.vtkhdf begins anew", "has a link in place of")
    assert (tmp_path / "victim.h5").read_bytes() == before


# --- at random --------------------------------------------------------------------------------------------


def spoil(folder, other, rng):
    """Damage one file of a folder; return what was done."""
    files = sorted(path for path in folder.rglob("*") if path.is_file() and path.name not in NOT_COMPARED)
    path = files[rng.integers(len(files))]
    name, size = path.relative_to(folder), path.stat().st_size
    how = rng.choice(["flip", "flip", "flip", "truncate", "swap", "delete"])
    if how == "swap":
        twin = next(iter(sorted((other / name).parent.glob(name.name))), None)
        if twin is None:
            how = "flip"
        else:
            shutil.copy(twin, path)
    if how == "flip":
        for _ in range(int(rng.integers(1, 4))):
            flip(path, int(rng.integers(size)), int(rng.integers(8)))
    elif how == "truncate":
        path.write_bytes(path.read_bytes()[: int(rng.integers(size))])
    elif how == "delete":
        path.unlink()
    return f"{how} {name}"


def go_on(out, said):
    """As `pdfem resume` does: the deck is the folder's own. Lines go to a file, the process may end in a crash."""
    reporter = Listener()
    try:
        code = alone(read_deck(out / "deck.toml"), out, reporter=reporter, resume="continue")
    except DeckError as error:
        code, reporter.lines = USAGE, error.messages
    said.write_text("\n".join(reporter.lines), encoding="utf-8")
    return code


@pytest.mark.parametrize(
    "seed", [seed if seed < FEW else pytest.param(seed, marks=pytest.mark.slow) for seed in range(SEEDS)]
)
def test_a_damaged_folder_ends_equal_or_told_or_refused(folders, straight, tmp_path, seed):
    """Every file of a stopped or finished run: bits, lengths, files of another run, nothing at all."""
    rng = np.random.default_rng(seed)
    state = "finished" if seed % 3 == 2 else "stopped"
    out, said = shutil.copytree(folders / state, tmp_path / "run"), tmp_path / "said"
    expected = straight if state == "stopped" else everything(folders / state)
    done = spoil(out, folders / "other", rng)
    code = in_child(lambda: go_on(out, said))
    assert said.exists(), f"{done}: no word, exit code {code}"
    lines = said.read_text(encoding="utf-8")
    assert code in (FINISHED, USAGE, NO_CHECKPOINT), f"{done}: {code}: {lines}"
    if code != FINISHED:
        assert lines, done
        return
    try:
        different = differing(everything(out), expected)
    except (OSError, ValueError, KeyError, RuntimeError) as error:
        different = [f"{type(error).__name__}: {error}"]
    told = [line for line in lines.splitlines() if line.startswith(("note: ", "warning: "))]
    assert not different or told, f"{done}: {different} in silence:\n{lines}"
