"""`tools/benchmarks/bench` on its small case: every number is there and can be one. How fast it is decides nothing."""

import json
import math
from unittest.mock import patch

import pytest

from support.helpers import ROOT, run_python
from tools.benchmarks import bench

KEYS = {
    "pd": (
        "undirected_bonds_per_second_per_core",
        "wall_undirected_bonds_per_second_per_core",
        "sweep_undirected_bonds_per_second_per_core",
        "closed_sweep_undirected_bonds_per_second_per_core",
        "plain_sums_sweep_undirected_bonds_per_second_per_core",
        "sweep_seconds_over_plain_sums",
        "evaluation_seconds",
        "bytes_per_undirected_bond",
        "resident_bytes_per_undirected_bond",
        "row_bytes_per_undirected_bond",
    ),
    "pd_linear": ("undirected_bonds_per_second_per_core", "sweep_undirected_bonds_per_second_per_core"),
    "fe": ("elements_per_second_per_core", "evaluation_elements_per_second_per_core"),
    "fe_general": ("elements_per_second_per_core", "evaluation_elements_per_second_per_core"),
    "setup": ("seconds", "peak_over_resident"),
    "relaxation": ("seconds", "share_of_evaluation"),
    "exact_sums": ("nanoseconds_per_product", "plain_nanoseconds_per_product"),
    "machine": (
        "stream_read_bytes_per_second_per_core",
        "stream_triad_bytes_per_second_per_core",
        "l1_read_bytes_per_second_per_core",
        "l2_read_bytes_per_second_per_core",
        "flops_per_second_per_core",
        "gather_2_mib_triples_per_second_per_core",
        "gather_memory_triples_per_second_per_core",
    ),
    "roofline.pd": ("fraction", "arithmetic_bound_per_second", "memory_bound_per_second"),
    "roofline.pd_linear": ("fraction",),
    "roofline.fe": ("fraction",),
    "roofline.fe_general": ("fraction",),
    "case": ("points", "undirected_bonds", "rows", "bonds_per_row"),
    "computer": ("cores",),
    "": ("schema_version",),
}


@pytest.fixture(scope="module")
def result(tmp_path_factory):
    folder = tmp_path_factory.mktemp("bench")
    with patch.object(bench, "SECONDS", 0.1):  # the fewest repetitions
        assert bench.main(["--small", "-n", "1", "--out", str(folder)]) == 0
    return json.loads((folder / "bench.json").read_text())


@pytest.mark.parametrize(("table", "key"), [(table, key) for table, keys in KEYS.items() for key in keys])
def test_every_number_is_finite_and_positive(result, table, key):
    for name in filter(None, table.split(".")):
        result = result[name]
    assert math.isfinite(result[key]) and result[key] > 0.0


def test_the_case_is_counted_not_assumed(result):
    """2 406 776 bonds were counted by an independent program, and by LAMMPS on the same points."""
    assert result["case"]["points"] == 8 * 24 * 8 * 8
    assert result["case"]["undirected_bonds"] == 2_406_776
    assert 2.0 < result["case"]["bonds_per_row"] <= 4.0
    assert "parallel" not in result and "peer" not in result


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (("--peer", "peridigm"), "the only peer is lammps"),
        (("--small", "--deck", "jobs/bar_pd.toml"), "--small and --deck"),
        (("--deck", "jobs/none.toml"), "there is no such file"),
    ],
)
def test_what_cannot_be_measured_is_refused_at_once(arguments, words, capsys):
    assert bench.main(list(arguments)) == 64
    said = capsys.readouterr().err
    assert words in said and "Traceback" not in said


def test_the_table_tells_the_rates(result):
    assert any("bonds/s/core" in name for name, _ in bench.table(result))


def test_the_command_does_not_start_under_a_launcher():
    answer = run_python("tools/benchmarks/bench", "--small", PMI_SIZE="2")
    assert answer.returncode == 64 and "plain shell" in answer.stderr


def test_sizes_cannot_be_taken_from_a_mesh_file(capsys):
    assert bench.main(["--deck", str(ROOT / "jobs/plate_fe_gmsh.toml")]) == 64
    assert "its mesh is a file, and only the sizes of a box can be taken" in capsys.readouterr().err
