"""Limits are seen before they end a run: of memory, of shared memory, and of what a deck or mesh can ask for."""

import resource
import subprocess
import sys
import time

import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.deck.table import DeckError, SceneError
from pdfem_mpi.deck.toml import MOST_PROBLEMS, parse_deck, read_deck
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.mesh.layers import cells_near_face
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs import memory_estimate as memory
from pdfem_mpi.system import process_limits
from pdfem_mpi.system.process_limits import Limit, group_limit, own_limit, shared_memory_problem
from support.bodies import local_share
from support.helpers import outside_launcher, run_pdfem, run_python
from support.restarts import alone, often
from support.tiny import TINY

USAGE, MIB = 64, 2**20
#: Of a processor, before a bad deck is refused: wall time would be that of other work as well.
SECONDS = 2.0


def refused(text):
    """Sentences about a deck, found within two seconds."""
    begun = time.process_time()
    with pytest.raises(SceneError) as error:
        scene = parse_deck(text, "deck")
        discretize(scene)
    assert time.process_time() - begun < SECONDS
    return error.value.messages


# --- decks ------------------------------------------------------------------------------------------------


def test_numbers_beyond_all_use_are_refused_by_key():
    polygon = "[[3.0, -1e200, 0.0], [3.0, 1e200, -1.0], [3.0, 1.0, 1.0]]"
    messages = refused(f"{TINY}\n[[cracks]]\npolygon = {polygon}\n".replace("1000.0", "1" + 200 * "0"))
    assert [message.split(" = ")[0] for message in messages] == [
        "deck: material.youngs_modulus", "deck: cracks.0.polygon.0.1", "deck: cracks.0.polygon.1.1",
    ]  # fmt: skip
    assert all("is beyond 1e+100" in message for message in messages)


def test_other_problems_are_told_beside_them():
    messages = refused(TINY.replace("spacing = 1.0", "spacing = 1e200").replace('"cg"', '"cgg"'))
    assert any("mesh.spacing = 1e+200 is beyond" in message for message in messages)
    assert any("solver.kind" in message for message in messages) and len(messages) == 2


@pytest.mark.parametrize(
    "deep",
    [
        "\n[x]\n" + ".".join(900 * ["a"]) + " = 1\n",
        "\n[" + ".".join(900 * ["a"]) + "]\nb = 1\n",
        "\nx = " + 90 * "[" + 90 * "]" + "\n",
        "\nx = " + 900 * "[" + 900 * "]" + "\n",
    ],
)
def test_tables_within_tables_without_end_are_refused(deep):
    messages = refused(deep + TINY if deep.startswith("\nx") else TINY + deep)
    assert any("nested" in message for message in messages)
    assert all(len(message) < 2100 for message in messages)


def test_a_deep_override_is_refused():
    with pytest.raises(DeckError, match="nested more than"):
        parse_deck(TINY, "deck", ["x." + ".".join(900 * ["a"]) + "=1"])


@pytest.mark.parametrize("length", [255, 100_000])
def test_names_that_no_file_can_have_are_refused(length):
    probe = f'\n[[probes]]\nkind = "line"\nname = "{"n" * length}"\nstart = [0.0, 1.0, 1.0]\nstop = [4.0, 1.0, 1.0]\n'
    (message,) = refused(TINY + probe)
    assert f"has {length} characters. Use a name of at most 200." in message


def test_bytes_that_are_not_text_are_refused(tmp_path):
    (tmp_path / "deck.toml").write_bytes(b'title = "\xff"\n' + TINY.encode())
    with pytest.raises(DeckError, match="is not UTF-8 text"):
        read_deck(tmp_path / "deck.toml")
    with pytest.raises(DeckError, match=r"title = .* has bytes that are not UTF-8"):
        parse_deck(TINY, "deck", ["title=\udcff"])


def test_thousands_of_unknown_keys_are_shown_as_a_few_and_their_count():
    messages = refused("\n".join(f"key_{k} = {k}" for k in range(20_000)) + TINY)
    assert len(messages) == MOST_PROBLEMS + 1
    assert "unknown key key_0 = 0" in messages[0]
    assert "19,950 more of 20,000 problems are not shown" in messages[-1]


def test_thousands_of_unknown_regions_are_shown_as_a_few_and_their_count():
    load = '[[loads]]\nkind = "body_force"\nregion = "nowhere{}"\ntotal = [1.0, 0.0, 0.0]\n'
    messages = refused(TINY + "".join(load.format(k) for k in range(5_000)))
    assert len(messages) == MOST_PROBLEMS + 1 and "4,950 more" in messages[-1]


def test_a_crack_of_thousands_of_corners_is_refused():
    angle = np.linspace(0.0, 2.0 * np.pi, 20_000, endpoint=False)
    polygon = [[3.0, float(np.cos(a)), float(np.sin(a))] for a in angle]
    (message,) = refused(f"{TINY}\n[[cracks]]\npolygon = {polygon}\n")
    assert "cracks.0.polygon has 20,000 corners, and at most 1,000 serve" in message
    begun = time.process_time()
    parse_deck(f"{TINY}\n[[cracks]]\npolygon = {polygon[::20]}\n", "deck")
    assert time.process_time() - begun < SECONDS


def test_more_layers_than_cells_are_all_cells():
    begun = time.process_time()
    scene = parse_deck(TINY.replace('face = "x+"', 'face = "x+"\nlayers = 1000000000000'), "deck")
    mesh = discretize(scene).mesh
    assert isinstance(mesh, HexMesh) and cells_near_face(mesh, "x+", scene.loads[0].layers).all()
    (message,) = refused(TINY + "\n[coupling]\noverlap = 1000000000000\n")
    assert "leaves no finite element outside the overlap" in message
    assert time.process_time() - begun < 2.0 * SECONDS


MESH = """*HEADING
 x
*NODE
1, 1e300, 0, 0
2, 1, 0, 0
3, 0, 1, 0
4, 1, 1, 0
5, 0, 0, 1
6, 1, 0, 1
7, 0, 1, 1
8, 1, 1, 1
*ELEMENT, TYPE=C3D8, ELSET=all
1, 1, 2, 4, 3, 5, 6, 8, 7
"""


def test_coordinates_beyond_all_use_are_refused(tmp_path):
    (tmp_path / "big.inp").write_text(MESH)
    deck = f"""
[mesh]
kind = "file"
path = "{tmp_path / "big.inp"}"
[material]
youngs_modulus = 1000.0
[[regions]]
name = "a"
model = "finite_elements"
[[supports]]
face = "x-"
x = 0.0
"""
    (message,) = refused(deck)
    assert "1 nodes have coordinates beyond 1e+50" in message and "node 0 at (1e+300, 0, 0)" in message
    with pytest.raises(SceneError, match="is beyond 1e"):
        parse_deck(deck.replace('inp"', 'inp"\nscale = 1e200'), "deck")


@pytest.mark.slow
@pytest.mark.parametrize("value", ["1e99", "-1e99", "1e-99", "-1e-99", "1e-300", "0.0", "1e200", "9" * 20])
def test_any_number_of_a_deck_in_the_extreme_is_a_scene_or_refused(value):
    """Each number of a deck in its turn: nothing but sentences, within two seconds."""
    numbers = ("1000.0", "0.25", "spacing = 1.0", "[4.0, 2.0, 2.0]", "[1.0, 0.0, 0.0]", "x = 0.0")
    more = "\n[[cracks]]\npolygon = [[3.0, 0.0, 0.0], [3.0, 1.0, 0.0], [3.0, 1.0, 1.0]]\n"
    more += '[[probes]]\nkind = "bar"\nstress = 7.0\n[stepping]\nload_factors = [0.5]\n'
    peridynamics = 'kinematics = "linear"\ninternal_length = 1.1\ncutoff_radius = 2.75'
    deck = TINY.replace('kinematics = "linear"', peridynamics).replace("0.25\n", "0.25\nfracture_energy = 3.5\n") + more
    numbers += ("1.1", "2.75", "3.5", "7.0", "0.5]", "[3.0, 1.0, 1.0]")
    for number in numbers:
        old = number.rpartition("= ")[2].strip("[]").split(",")[0]
        text = deck.replace(number, number.replace(old, value, 1), 1)
        begun = time.process_time()
        try:
            scene = parse_deck(text, "deck")
            memory.check_mesh(scene, int(np.prod(scene.mesh.n_cells)), mpi().COMM_SELF)
            memory.check_model(scene, local_share(scene), mpi().COMM_SELF)
        except SceneError as error:
            assert error.messages, number
        assert time.process_time() - begun < SECONDS, number


@pytest.mark.parametrize(
    "arguments", [["run", "DECK", "--out", "LONG"], ["run", "LONG.toml"], ["resume", "LONG"], ["info", "LONG"]]
)
def test_paths_that_no_system_has_are_refused(tmp_path, arguments):
    """Without a rank or a library of numbers: by the command line itself."""
    from typer.testing import CliRunner

    from pdfem_mpi.command.cli import app

    (tmp_path / "DECK").write_text(TINY)
    words = [word.replace("LONG", "n" * 300).replace("DECK", str(tmp_path / "DECK")) for word in arguments]
    result = CliRunner().invoke(app, words, standalone_mode=False)
    assert type(result.exception).__name__ == "BadParameter"
    assert "File name too long. Use another path" in str(result.exception) and len(str(result.exception)) < 200


# --- memory -----------------------------------------------------------------------------------------------


def groups(root, version, limits_of, path="/a/b"):
    """A file system of control groups: limit, usage and droppable bytes by folder."""
    names = ("memory.max", "memory.current", "inactive_file")
    mount = root / "cgroup"
    folder = mount
    if version == 1:
        names = ("memory.limit_in_bytes", "memory.usage_in_bytes", "total_inactive_file")
        folder = mount / "memory"
    proc = root / "proc"
    proc.mkdir(parents=True)
    (proc / "cgroup").write_text(f"5:cpu:/x\n{'4:memory' if version == 1 else '0:'}:{path}\n")
    for name, (limit, usage, droppable) in limits_of.items():
        place = folder / name
        place.mkdir(parents=True, exist_ok=True)
        (place / names[0]).write_text(f"{limit}\n")
        (place / names[1]).write_text(f"{usage}\n")
        (place / "memory.stat").write_text(f"anon 5\n{names[2]} {droppable}\n")
    return proc, mount


@pytest.mark.parametrize("version", [1, 2])
def test_the_group_with_the_least_room_counts(tmp_path, version):
    endless = "max" if version == 2 else "9223372036854771712"
    found = groups(tmp_path, version, {"a/b": (endless, 7, 0), "a": (1000, 400, 50), ".": (5000, 4200, 0)})
    assert group_limit(*found) == Limit(650, "the memory limit of the container or job")
    assert group_limit(*groups(tmp_path / "none", version, {"a/b": (endless, 7, 0)})) is None


def test_a_container_whose_group_is_the_root_is_seen(tmp_path):
    """There the path of the host is told, and the files of the own group lie at the root."""
    assert group_limit(*groups(tmp_path, 1, {".": (3000, 1000, 0)}, path="/docker/0123")).bytes == 2000


def test_limits_of_a_process_are_what_is_left_of_them():
    """In a child: a limit of 3 GiB, of which its own pages are taken."""
    code = (
        "import resource; from pdfem_mpi.system.process_limits import own_limit; assert own_limit() is None;"
        "resource.setrlimit(resource.RLIMIT_AS, (3 * 2**30, -1)); found = own_limit();"
        "assert 2.5 * 2**30 < found.bytes < 3 * 2**30 and 'ulimit -v' in found.what"
    )
    result = run_python("-c", code)
    assert result.returncode == 0, result.stderr
    assert resource.getrlimit(resource.RLIMIT_AS)[0] == resource.RLIM_INFINITY
    assert own_limit() is None


@pytest.mark.parametrize("which", ["own_limit", "group_limit"])
def test_a_scene_beyond_a_limit_is_refused_by_its_name(monkeypatch, which):
    monkeypatch.setattr(memory, which, lambda: Limit(float(MIB), "the limit for a test"))
    scene = parse_deck(TINY.replace("spacing = 1.0", "spacing = 0.1"), "deck")
    with pytest.raises(SceneError) as error:
        memory.check_mesh(scene, int(np.prod(scene.mesh.n_cells)), mpi().COMM_SELF)
    (message,) = error.value.messages
    assert "the limit for a test has 1 MiB available" in message and "raise the limit" in message
    monkeypatch.setattr(memory, which, lambda: Limit(1e18, "the limit for a test"))
    memory.check_mesh(scene, int(np.prod(scene.mesh.n_cells)), mpi().COMM_SELF)


# --- shared memory ----------------------------------------------------------------------------------------


class Room:
    """What statvfs tells of a small file system."""

    f_frsize = 4096

    def __init__(self, size, free):
        self.f_blocks, self.f_bavail = size * MIB // 4096, free * MIB // 4096


@pytest.mark.parametrize(
    ("ranks", "size", "free", "started", "enough"),
    [(2, 64, 64, False, True), (8, 64, 64, False, True), (16, 64, 64, False, False), (2, 64, 17, False, False),
     (2, 64, 17, True, True), (2, 17, 17, True, False), (1, 6, 6, False, True), (1, 1, 1, False, False)],
)  # fmt: skip
def test_shared_memory_for_so_many_ranks(monkeypatch, ranks, size, free, started, enough):
    """Sizes at which MPICH ended in a bus error or a segmentation fault are refused, those of containers are not."""
    monkeypatch.setattr(process_limits.os, "statvfs", lambda folder: Room(size, free))
    problem = shared_memory_problem(ranks, started)
    assert (problem is None) == enough
    assert enough or ("MiB there. Make it larger (docker run --shm-size=1g" in problem)


def can_mount():
    return subprocess.run(["unshare", "-m", "true"], capture_output=True, check=False).returncode == 0


@pytest.mark.slow
@pytest.mark.parametrize("ranks", [1, 2])
def test_a_small_shared_memory_is_told_before_mpi_starts(tmp_path, ranks):
    """In a name space of its own, where the system allows one."""
    if not can_mount():
        pytest.skip("no name space of mounts can be made here")
    (tmp_path / "deck.toml").write_text(TINY)
    command = f"mount -t tmpfs -o size=1m tmpfs /dev/shm && exec {sys.executable} -m pdfem_mpi run deck.toml -n {ranks}"
    result = subprocess.run(
        ["unshare", "-m", "bash", "-c", command], cwd=tmp_path, env=outside_launcher(), capture_output=True, text=True,
        check=False,
    )  # fmt: skip
    assert result.returncode == USAGE, result.stderr
    assert "/dev/shm has 1.0 MiB free" in result.stderr


# --- stacks -----------------------------------------------------------------------------------------------


def test_stacks_of_a_hang_go_when_the_run_finishes(tmp_path):
    out = tmp_path / "run"
    assert alone(often(), out) == 0
    (out / "run.r3.hang").write_text("stacks")
    assert alone(often(), out, overwrite=True) == 0
    assert not list(out.glob("*.hang"))


@pytest.mark.slow
@pytest.mark.parametrize("name", ["crack_1e200", "deep_ok", "load_layers"])
def test_decks_that_ended_the_program(tmp_path, name):
    """The whole command, its start included."""
    polygon = "[[3.0, -1e200, -1e200], [3.0, 1e200, -1e200], [3.0, 1e200, 1e200]]"
    more = {
        "crack_1e200": f"\n[[cracks]]\npolygon = {polygon}\n",
        "deep_ok": "\n[x]\n" + ".".join(900 * ["a"]) + " = 1\n",
        "load_layers": "",
    }[name]
    text = TINY.replace('face = "x+"', 'face = "x+"\nlayers = 1000000000000') if name == "load_layers" else TINY + more
    (tmp_path / "deck.toml").write_text(text)
    result = run_pdfem("run", tmp_path / "deck.toml", "--out", tmp_path / "run")
    assert result.returncode == (0 if name == "load_layers" else USAGE), result.stderr
    assert "Traceback" not in result.stderr
