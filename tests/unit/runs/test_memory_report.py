"""A scene allocates, compiles and imports what it needs, and the summary says so."""

import json
import platform
from unittest.mock import patch

import numpy as np
import pytest

from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.outputs import DisplacementProbe, Output
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.toml import write_deck
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.measure.fields import digest_fields, fields_sha256
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.results.checkpoint import open_checkpoint
from pdfem_mpi.results.checkpoint_files import list_checkpoints
from pdfem_mpi.runs.memory_report import PARTS
from pdfem_mpi.runs.run import run
from support.bodies import YOUNGS_MODULUS, build, make_scene
from support.helpers import ROOT, run_python
from support.reporters import Silence

CELLS = (6, 3, 3)
NO_OUTPUT = Output(fields=False, figures=False)
BRITTLE = Material(youngs_modulus=YOUNGS_MODULUS, critical_stretch=0.5)

BONDS = {"points", "bond_rows", "bond_strengths", "bond_counts"}
BREAKING = {"break_check", "break_records"}
ELEMENTS = {"nodes", "elements"}
GRADIENTS = {"intact_elements", "coarse_grid", "preconditioner_blocks"}
ALWAYS = {
    "mesh", "share_of_the_rank", "masses", "loads_and_supports", "state", "force_tables",
    "solver_vectors",
}  # fmt: skip


def scene_of(n_elements=0, output=NO_OUTPUT, material=None, **options):
    scene = make_scene(CELLS, n_elements, correction="none", output=output, **options)
    return scene.model_copy(update={"material": material} if material else {})


#: Scenes, the parts that they have beside `ALWAYS`, and the bond kernels that they call.
SCENES = {
    "finite elements, adr": (scene_of(CELLS[0]), ELEMENTS, []),
    "finite elements, cg": (scene_of(CELLS[0], solver="cg"), ELEMENTS | GRADIENTS, []),
    "finite elements, finite, adr": (scene_of(CELLS[0], kinematics="finite"), ELEMENTS, []),
    "finite elements, finite, cg": (scene_of(CELLS[0], kinematics="finite", solver="cg"), ELEMENTS | GRADIENTS, []),
    "linear": (scene_of(), BONDS, ["linear"]),
    "linear, cg": (scene_of(solver="cg"), BONDS | GRADIENTS, ["linear"]),
    "linear, breaking": (scene_of(material=BRITTLE), BONDS | BREAKING, ["linear", "linear, breaking"]),
    "finite": (
        scene_of(kinematics="finite"),
        BONDS | {"bond_lengths"},
        ["finite, closed form", "finite, series"],
    ),
    "finite, cg": (
        scene_of(kinematics="finite", solver="cg"),
        BONDS | GRADIENTS | {"bond_lengths"},
        ["finite, closed form", "finite, series", "tangent, closed form", "tangent, series"],
    ),
    "another ratio": (scene_of(poissons_ratio=0.3), BONDS | {"dilatations"}, ["linear, volumetric"]),
    "coupled": (scene_of(3), BONDS | ELEMENTS | {"overlap"}, ["linear"]),
    "half": (
        scene_of(symmetry=("y-",)),
        BONDS | {"mirror_images"},
        ["linear"],
    ),
    "two steps": (scene_of(stepping=Steps(load_factors=(0.5, 1.0))), BONDS | {"checkpoint_copy"}, ["linear"]),
    "fields": (scene_of(output=Output(figures=False)), BONDS | {"output"}, ["linear"]),
    "damage": (
        scene_of(output=Output(figures=False, damage=True)),
        BONDS | {"output", "damage_weights"},
        ["linear"],
    ),
    "probe": (
        scene_of(probes=(DisplacementProbe(kind="displacement", name="end", point=(6.0, 1.5, 1.5)),)),
        BONDS | {"output"},
        ["linear"],
    ),
}


def summary_of(scene, out):
    code = run(scene, mpi().COMM_SELF, out, write_deck(scene), True, Silence())
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    assert code == 0, summary["reason"]
    return summary


@pytest.fixture(scope="module")
def memory(tmp_path_factory):
    """What the summary of each scene says of its memory."""
    folder = tmp_path_factory.mktemp("needs")
    return {name: summary_of(scene, folder / name)["memory"] for name, (scene, _, _) in SCENES.items()}


@pytest.mark.parametrize("name", SCENES)
def test_a_scene_has_the_parts_that_it_needs_and_a_reason_for_each_other(memory, name):
    _, parts, kernels = SCENES[name]
    said = memory[name]
    assert set(said["array_bytes"]) == ALWAYS | parts
    assert set(said["left_out"]) == set(PARTS) - ALWAYS - parts
    assert "nothing to hold" not in said["left_out"].values()
    assert said["bond_kernels"] == kernels
    assert sum(said["array_bytes"].values()) == sum(said["array_bytes_per_rank"])


@pytest.mark.parametrize(
    ("scene", "part", "reason"),
    [
        ("finite elements, adr", "bond_rows", "no cell is peridynamic"),
        ("linear", "bond_lengths", 'peridynamics.kinematics = "linear"'),
        ("linear", "break_check", "no critical_stretch and no fracture_energy in the deck"),
        ("linear, breaking", "broken_bonds", "no bond broke"),
        ("linear", "elements", "no cell is a finite element"),
        ("linear", "dilatations", "Poisson's ratio of the bonds is 1/4"),
        ("finite elements, adr", "dilatations", "no cell is peridynamic"),
        ("coupled", "coarse_grid", 'solver.kind = "adr"'),
        ("coupled", "checkpoint_copy", "one load step: there is no earlier state to keep"),
        ("coupled", "output", "output.fields = false, and no probes"),
        ("fields", "damage_weights", "output.damage = false"),
    ],
)
def test_reasons_name_the_key(memory, scene, part, reason):
    assert memory[scene]["left_out"][part] == reason


def test_bytes_are_those_of_the_rows():
    """Counted by hand: a row has its place and four numbers, eight with finite kinematics; every point a start."""
    linear, finite = (build(make_scene(CELLS, kinematics=kind)).model.bonds for kind in ("linear", "finite"))
    n_rows, n_points = len(linear.interior.offset), 8 * np.prod(CELLS)
    assert linear.interior.start.nbytes == 8 * (n_points + 1)
    assert linear.interior.offset.nbytes == 4 * n_rows
    assert [bonds.interior.data.nbytes for bonds in (linear, finite)] == [4 * W * n_rows, 8 * W * n_rows]
    assert sum(array.nbytes for array in linear.boundary.arrays) == 8 + 4 + 4 * W  # one rank: no ghosts, no rows


def test_memory_shrinks_with_what_is_left_out(memory):
    held = {name: said["array_bytes"] for name, said in memory.items()}
    assert held["finite"]["bond_lengths"] == held["linear"]["bond_strengths"] == held["finite"]["bond_strengths"]
    whole = {name: sum(parts.values()) for name, parts in held.items()}
    assert whole["finite elements, adr"] < 0.2 * whole["linear"]  # most of it the mesh and vectors
    assert (
        whole["linear"]
        < whole["linear, breaking"]
        == pytest.approx(whole["linear"] + sum(held["linear, breaking"][part] for part in BREAKING), rel=0.05)
    )
    assert whole["coupled"] < whole["linear"]


def test_half_a_body_has_little_more_than_half_of_the_rows():
    """Bonds across the mirror plane are those of this side only; each point has a start for its rows with images."""
    half, whole = (
        build(make_scene((6, n, 3), symmetry=symmetry)).model.bonds for n, symmetry in ((3, ("y-",)), (6, ()))
    )
    n_half, n_whole = (sum(len(rows.offset) for rows in bonds.rows) for bonds in (half, whole))
    assert 0.5 * n_whole < n_half < 0.6 * n_whole


def test_conjugate_gradients_keep_neither_velocity_nor_previous_force(memory, tmp_path):
    state = {name: memory[name]["array_bytes"]["state"] for name in ("linear", "linear, cg")}
    assert state["linear"] == 3 * state["linear, cg"]
    summary_of(SCENES["linear, cg"][0], tmp_path)
    ((_, path),) = list_checkpoints(tmp_path / "checkpoints")
    with open_checkpoint(path) as reader:
        assert reader.rows("points/u") == 8 * np.prod(CELLS)
        assert reader.rows("points/v") == reader.rows("points/previous_force") == 0


def test_a_run_without_output_gathers_no_fields_and_has_the_same_digest(tmp_path):
    scene = scene_of(3, solver="cg")
    with patch("pdfem_mpi.runs.readings.gather_fields", side_effect=AssertionError("fields were gathered")):
        without = summary_of(scene, tmp_path / "without")
    fields = summary_of(scene.model_copy(update={"output": Output(figures=False)}), tmp_path / "with")
    assert without["fields_sha256"] == fields["fields_sha256"] is not None
    assert not list((tmp_path / "without").glob("*.vtkhdf"))


@pytest.mark.parametrize("n_elements", [0, 3, CELLS[0]])
def test_digest_in_slabs_is_that_of_the_fields(n_elements, monkeypatch):
    monkeypatch.setattr("pdfem_mpi.parallel.slabs.SLAB", 7)
    body = build(make_scene(CELLS, n_elements))
    u = np.random.default_rng(0).uniform(-1e-3, 1e-3, body.model.n_unknowns)
    fields = body.fields(u)
    assert digest_fields(body.share, body.forces, u) == fields_sha256(fields)


@pytest.mark.skipif(platform.libc_ver()[0] != "glibc", reason="other mallocs have their own ways")
def test_freed_arrays_of_set_up_go_back_to_the_system():
    """A small array behind each large one would keep its pages in the heap; in a process whose heap is new."""
    script = """
import numpy as np
from pdfem_mpi.system.heap import APART, large_arrays_apart
from pdfem_mpi.system.process_memory import footprint
with large_arrays_apart():
    before = footprint().resident
    large, small = [], []
    for _ in range(64):
        large.append(np.ones(APART // 8))
        small.append(np.ones(1 << 13))
    grown = footprint().resident - before
    del large
    print(grown, footprint().resident - before)
"""
    grown, left = map(int, run_python("-c", script).stdout.split())
    assert grown > 48 << 20
    assert left < 8 << 20  # the small ones are 4 MiB


# Runs scenes one after the other as the command line does, each with the kernels of its features; nothing more may be
# compiled or loaded then. Starts with the scenes that need least.
RUN_ALL = """
import sys
from pathlib import Path
from pdfem_mpi.system import launcher as launch
launch.prepare_environment()
from pdfem_mpi.deck.toml import write_deck
from pdfem_mpi.runs.compilation import kernels
from pdfem_mpi.runs.memory_report import features_of
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.run import run
from unit.runs.test_memory_report import SCENES
from support.reporters import Silence
sys.modules.pop("matplotlib", None)
expected = set()
for number, (name, (scene, _, _)) in enumerate(SCENES.items()):
    expected |= set(kernels(features_of(scene)))
    out = Path(sys.argv[1]) / str(number)
    assert run(scene, mpi().COMM_SELF, out, write_deck(scene), True, Silence()) == 0, name
    called = {kernel for kernel in kernels() if kernel.signatures}
    assert called == expected, (name, [kernel.__name__ for kernel in called ^ expected])
    for kernel in called:
        assert kernel.signatures == [kernels()[kernel].args], (name, kernel.__name__)
    if number == 0:
        print(len(called), "of", len(kernels()), "kernels")
for library in ("matplotlib", "meshio", "netCDF4", "gmsh"):
    assert library not in sys.modules, library
"""


def test_a_scene_compiles_its_kernels_and_no_others(tmp_path):
    """Also where the table of needs is wrong, a run is right: the kernel comes when it is called. Not so quickly."""
    answer = run_python("-c", RUN_ALL, tmp_path, PYTHONPATH=f"{ROOT}:{ROOT / 'tests'}", timeout=110)
    assert answer.returncode == 0, answer.stderr[-2000:]
    few, _, every, _ = answer.stdout.split()
    assert int(few) < 0.4 * int(every)
