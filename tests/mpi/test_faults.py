"""Stops, failures and damage on several ranks: whatever happens, all ranks agree, and the run goes on elsewhere.

Kills of one rank in each phase of a checkpoint are in tests/unit/test_restart.py, launchers and real signals in
tests/unit/test_restart_cli.py.
"""

import errno
import os
from unittest.mock import patch

import h5py
import numpy as np
import pytest

from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.measure.geometry import gather_geometry
from pdfem_mpi.model.state import FIELDS
from pdfem_mpi.parallel import slabs as gathering
from pdfem_mpi.parallel.comm import broadcast, mpi
from pdfem_mpi.parallel.slabs import gather_pairs
from pdfem_mpi.results import checkpoint
from pdfem_mpi.results.checkpoint import Writer, open_checkpoint
from pdfem_mpi.results.checkpoint_files import list_checkpoints
from pdfem_mpi.runs import tables
from pdfem_mpi.runs.tables import BROKEN, make_layout, read_broken, read_fields, total_broken, write_tables
from support.bodies import build, local_share, make_scene
from support.helpers import assert_all
from support.restarts import FACTORS, StopAt, alone, differing, failing, go, often, outcome, relaxed

pytestmark = pytest.mark.mpi(min_size=2)

FINISHED, NO_CHECKPOINT, NOT_WRITTEN, STOPPED = 0, 65, 73, 75


@pytest.fixture
def folder(mpi_tmp_path):
    """A folder of all ranks, gone when all are done with it."""
    yield mpi_tmp_path / "run"
    mpi().COMM_WORLD.Barrier()


def on_ranks(n, action):
    """Do something on the first n ranks, the others wait; return the results of those, on all ranks. Collective."""
    world = mpi().COMM_WORLD
    group = world.Split(int(world.rank >= n))
    result = action(group) if world.rank < n else None
    group.Free()
    return world.allgather(result)[:n]


def expected_of(scene, folder):
    """The straight run on one rank, on rank 0."""
    if mpi().COMM_WORLD.rank:
        return None
    out = folder.with_name("straight")
    assert alone(scene, out) == FINISHED
    return outcome(out)


def assert_outcome(folder, expected):
    """The run folder has all of the straight run. Collective."""
    different = differing(outcome(folder), expected) if mpi().COMM_WORLD.rank == 0 else []
    assert_all(mpi().COMM_WORLD, not different, f"{different}")


def scene_of(kind):
    program, *options = kind.split()
    if program == "relaxation":
        return relaxed()
    if program == "cg":
        steps = {"stepping": Steps(load_factors=FACTORS), "output": Output(figures=False)}
        return make_scene((9, 3, 2), 4, solver="cg", **steps)
    return failing(program, options[0], *map(float, options[1:]))


@pytest.mark.parametrize(
    ("kind", "length"),
    [
        ("events linear", 25),
        ("ramp finite", 65),
        *(
            pytest.param(kind, length, marks=pytest.mark.slow)
            for kind, length in (
                ("relaxation", 11),
                ("cg", 2),
                ("events linear", 4),
                ("events finite", 7),
                ("events linear 0.4", 60),
                ("events finite 0.1", 7),
                ("ramp finite 0.33", 7),
                ("ramp linear", 19),
                ("ramp finite", 7),
                ("steps linear", 3),
                ("steps finite", 3),
            )
        ),
    ],
)
def test_every_start_has_another_number_of_ranks(folder, kind, length):
    """1, 2, 4, 3, 1, ... ranks, stopped by a signal that only the last one gets: the bits of one straight run.

    Events stop in the middle of avalanches, ramps in the middle of cracks.
    """
    world, scene = mpi().COMM_WORLD, scene_of(kind)
    expected = expected_of(scene, folder)
    sizes = [1, 2, 4, 3] if world.size >= 4 else [1, 2]
    for start in range(100):
        n = sizes[start % len(sizes)]
        codes = on_ranks(n, lambda comm: go(scene, comm, folder, requests=StopAt(length, comm.rank == comm.size - 1)))
        assert_all(world, len(set(codes)) == 1, f"codes {codes}")
        if codes[0] != STOPPED:
            break
    assert_all(world, codes[0] == FINISHED and start >= 2, f"ended with {codes} after {start} stops")
    assert_outcome(folder, expected)


def test_ranks_agree_when_a_checkpoint_cannot_be_written(comm, mpi_tmp_path):
    """Rank 0 alone sees the full disk; three times in a row are 73 on all ranks."""
    folder = mpi_tmp_path / f"run {comm.size} {broadcast(comm, mpi().COMM_WORLD.rank)}"
    call, failures = os.replace, [3]

    def full(source, target):
        if "ckpt-" in str(source) and failures[0]:
            failures[0] -= 1
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        call(source, target)

    with patch.object(os, "replace", full):
        code = go(often(), comm, folder)
    assert_all(comm, code == NOT_WRITTEN, f"{code}")


def test_ranks_agree_when_no_checkpoint_can_be_used(comm, mpi_tmp_path):
    """Rank 0 alone reads them."""
    folder = mpi_tmp_path / f"run {comm.size} {broadcast(comm, mpi().COMM_WORLD.rank)}"
    stopped = go(often(), comm, folder, requests=StopAt(3))
    if comm.rank == 0:
        for _, path in list_checkpoints(folder / "checkpoints"):
            path.write_bytes(b"")
    code = go(often(), comm, folder)
    assert_all(comm, (stopped, code) == (STOPPED, NO_CHECKPOINT), f"{stopped}, {code}")


def test_ranks_agree_when_a_checkpoint_cannot_be_read(comm, mpi_tmp_path):
    """It was sound when it was checked; then the disk fails."""
    body = build(make_scene((5, 2, 2), 2), comm)
    layout = make_layout(body.share)

    class Broken:
        def shape(self, name):
            return 3, 2

        def read_rows(self, *arguments):
            raise OSError(errno.EIO, os.strerror(errno.EIO))

    reader = Broken() if comm.rank == 0 else None
    raised = []
    for read in (
        lambda: read_fields(body.model, layout, body.state, reader),
        lambda: read_broken(body.share, body.model, reader, 2),
    ):
        try:
            read()
        except OSError as error:
            raised.append("Input/output error" in str(error))
    assert_all(comm, raised == [True, True], f"{raised}")


def test_ranks_agree_about_tables_of_another_body_and_about_damaged_results(comm, mpi_tmp_path):
    """A sealed file with fewer rows is refused on all ranks; a damaged history steps aside, and the run goes on."""
    out = mpi_tmp_path / f"run {comm.size} {broadcast(comm, mpi().COMM_WORLD.rank)}"
    assert_all(comm, go(often(), comm, out, requests=StopAt(60)) == STOPPED)
    if comm.rank == 0:
        path = list_checkpoints(out / "checkpoints")[0][1]
        whole, history = path.read_bytes(), (out / "history.csv").read_bytes()
        with h5py.File(path, "r+", libver=("v110", "v110")) as file:
            for name in list(file["points"]):
                rows = file[f"points/{name}"][:-8]
                del file[f"points/{name}"]
                file[f"points/{name}"] = rows
        checkpoint._seal(path)
    comm.Barrier()
    code = go(often(), comm, out)
    if comm.rank == 0:
        path.write_bytes(whole)
        (out / "history.csv").write_bytes(history[:-1] + b"7")
    comm.Barrier()
    assert_all(comm, code == NO_CHECKPOINT)
    assert_all(comm, go(often(), comm, out) == FINISHED)
    assert_all(comm, comm.rank or (out / "history.csv.damaged").exists())


def test_second_job_is_refused_on_all_ranks(comm, mpi_tmp_path):
    from pdfem_mpi.system.lock import Lock

    folder = mpi_tmp_path / f"run {comm.size} {broadcast(comm, mpi().COMM_WORLD.rank)}"
    if comm.rank == 0:
        folder.mkdir()
        held = Lock(folder)
    comm.Barrier()
    code = go(often(), comm, folder)
    if comm.rank == 0:
        held.release()
    assert_all(comm, code == NOT_WRITTEN, f"{code}")


# --- tables -----------------------------------------------------------------------------------------------


NAMES = [field.name for field in FIELDS]


def every_bond(body):
    """All pairs of points within the cutoff, sorted, of the whole body."""
    geometry = gather_geometry(local_share(body.scene))
    x = geometry.point_positions
    near = ((x[:, None] - x[None]) ** 2).sum(axis=2) <= body.share.cutoff**2
    pairs = np.argwhere(np.triu(near, 1))
    return 8 * np.flatnonzero(geometry.has_points)[pairs // 8] + pairs % 8


def some(pairs, which):
    """None, an odd number of, or all bonds."""
    count = {"none": 0, "odd": 101, "all": len(pairs)}[which]
    return pairs[np.sort(np.random.default_rng(3).permutation(len(pairs))[:count])]


def store(comm, path, which, wide=False):
    """Write fields that are functions of the position, and broken bonds dealt out to the ranks. Collective."""
    body = build(make_scene((5, 2, 2), 2), comm)
    layout = make_layout(body.share)
    for k, name in enumerate(NAMES):
        body.state.add(name)[:] = body.of_positions(lambda x, k=k: np.sin(x + k))
    pairs = some(every_bond(body), which)
    rng = np.random.default_rng(5)
    mine = pairs[rng.integers(0, comm.size, len(pairs)) == comm.rank]
    mine = mine[rng.permutation(len(mine))] + wide * np.array([0, 2**33])
    total, needs = total_broken(body.model, mine)
    assert (total, needs) == (len(pairs), wide and total > 0)
    writer = Writer(path, layout.tables(total, needs, NAMES), "job") if comm.rank == 0 else None
    write_tables(body.model, layout, body.state.fields, mine, writer)
    if writer:
        writer.finish({})
    comm.Barrier()


@pytest.mark.parametrize("which", ["none", "odd", "all"])
def test_tables_are_the_same_file_from_any_number_of_ranks(comm, mpi_tmp_path, monkeypatch, which):
    """Byte for byte, with slabs of a few rows; and each rank reads back its own."""
    monkeypatch.setattr(gathering, "SLAB", 7)
    monkeypatch.setattr(gathering, "PAIR_SLAB", 16)
    monkeypatch.setattr(tables, "PAIRS", 50)
    path = mpi_tmp_path / f"ckpt-{comm.size}{broadcast(comm, mpi().COMM_WORLD.rank):05d}.h5"
    store(comm, path, which)
    alone_path = path.with_name(f"alone-{mpi().COMM_WORLD.rank}.h5")
    store(mpi().COMM_SELF, alone_path, which)
    assert_all(comm, path.read_bytes() == alone_path.read_bytes(), "files differ")

    body = build(make_scene((5, 2, 2), 2), comm)
    layout = make_layout(body.share)
    for name in NAMES:
        body.state.add(name)
    if comm.rank == 0:
        with open_checkpoint(path) as reader:
            read_fields(body.model, layout, body.state, reader)
            found = read_broken(body.share, body.model, reader, 2)
    else:
        read_fields(body.model, layout, body.state, None)
        found = read_broken(body.share, body.model, None, 2)
    for k, values in enumerate(body.state.fields.values()):
        same = np.array_equal(values, body.of_positions(lambda x, k=k: np.sin(x + k)))
        assert_all(comm, same, f"field {k} differs")
    owned = body.model.points.cell_number[: body.model.points.n_owned]
    pairs = some(every_bond(body), which)
    touching = pairs[np.isin(pairs // 8, owned).any(axis=1)]
    assert_all(comm, np.array_equal(found, touching), "broken bonds differ")


def test_point_numbers_beyond_32_bits(comm, mpi_tmp_path):
    path = mpi_tmp_path / f"ckpt-{comm.size}{broadcast(comm, mpi().COMM_WORLD.rank):05d}.h5"
    store(comm, path, "odd", wide=True)
    if comm.rank == 0:
        with open_checkpoint(path) as reader:
            pairs = reader.read_rows(BROKEN, 0, reader.rows(BROKEN))
        assert pairs.dtype == np.uint64 and (pairs[:, 1] >= 2**33).all() and (pairs[:, 0] < 2**10).all()


@pytest.mark.parametrize("n", [0, 1, 500])
def test_pairs_come_in_order_and_in_slabs(comm, monkeypatch, n):
    monkeypatch.setattr(gathering, "PAIR_SLAB", 8)
    rng = np.random.default_rng(n)
    pairs = np.unique(rng.integers(0, 100, (n, 2)), axis=0)
    mine = pairs[rng.integers(0, comm.size, len(pairs)) == comm.rank]
    slabs = list(gather_pairs(comm, mine[::-1], 100))
    joined = np.concatenate([np.empty((0, 2), int), *(slab for slab in slabs if slab is not None)])
    assert_all(comm, comm.rank > 0 or np.array_equal(joined, pairs), "pairs differ")
    assert_all(comm, all(slab is None or len(set(slab[:, 0] // 8)) == 1 for slab in slabs), "slabs are too wide")
