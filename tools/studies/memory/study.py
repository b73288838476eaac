"""The paper's bar with more and with less in it: bytes by part and processor time, for the table of docs/needs.md.

One rank, one run after the other, kernels loaded from the cache; options are those of ``pdfem run``, for example
``--set mesh.spacing=0.1``. Nothing is kept: a row's time and memory are measured together.
"""

from __future__ import annotations

import resource
import subprocess
import tempfile
from pathlib import Path

from tools.studies.series import DOCS, fill, program, run_deck, summary_of, table

COMMON = {"solver.kind": '"cg"', "output.fields": "false", "output.figures": "false", "probes": "[]"}
BREAKING = {"material.critical_stretch": "0.01"}  # ten times the strain: all bonds are looked at, none breaks
QUARTER = {"mesh.lower": "[-5.0, 0.0, 0.0]", "mesh.symmetry": '["y-", "z-"]'}
FINITE = {"peridynamics.kinematics": '"finite"'}
CASES = (
    ("finite elements", "bar_fe.toml", {}),
    ("coupled, linear", "bar_tension.toml", {}),
    ("peridynamics, linear", "bar_pd.toml", {}),
    ("the same, relaxation to 0.5", "bar_pd.toml", {"solver.kind": '"adr"', "solver.tolerance": "0.5"}),
    ("a quarter of it", "bar_pd.toml", QUARTER),
    ("without surface correction", "bar_pd.toml", {"peridynamics.surface_correction": '"none"'}),
    ("two load steps", "bar_pd.toml", {"stepping.kind": '"steps"', "stepping.load_factors": "[0.5, 1.0]"}),
    ("peridynamics, finite", "bar_pd.toml", FINITE),
    ("the same, bonds may break", "bar_pd.toml", FINITE | BREAKING),
    ("and fields are written", "bar_pd.toml", FINITE | BREAKING | {"output.fields": "true"}),
    ("and damage", "bar_pd.toml", FINITE | BREAKING | {"output.fields": "true", "output.damage": "true"}),
)
GROUPS = {
    "bonds": ("bond_rows", "bond_strengths", "bond_lengths", "dilatations", "bond_counts", "fitted_factors"),
    "breaking": ("break_check", "break_records", "broken_bonds", "damage_weights"),
    "mesh and places": (
        "mesh", "share_of_the_rank", "exchange", "mirror_images", "points", "nodes", "elements",
        "overlap",
    ),
    "vectors": ("masses", "loads_and_supports", "state", "force_tables"),
    "solver": ("intact_elements", "coarse_grid", "preconditioner_blocks", "solver_vectors"),
    "files": ("checkpoint_copy", "output"),
}  # fmt: skip


def main(words: list[str]) -> int:
    """Run all scenes, print the rows, fill the table."""
    subprocess.run([program(), "warmup"], check=True, capture_output=True)
    header = ["scene", "undirected bonds", *GROUPS, "all arrays", "estimated", "peak", "evaluations", "processor s"]
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for number, (name, deck, settings) in enumerate(CASES):
            out = Path(folder) / str(number)
            before = processor_time()
            run_deck(deck, COMMON | settings, out, *words)
            rows.append([name, *row(summary_of(out), processor_time() - before)])
            print(" | ".join(rows[-1]), flush=True)
    fill(DOCS / "needs.md", {"table": table([*header, "bond kernels called"], rows)})
    return 0


def processor_time():
    """Seconds of all processes that were started here and have ended."""
    usage = resource.getrusage(resource.RUSAGE_CHILDREN)
    return usage.ru_utime + usage.ru_stime


def row(summary, seconds):
    """The columns of a run, sizes in MiB."""
    memory = summary["memory"]
    sizes = memory["array_bytes"]
    groups = [sum(sizes.get(part, 0) for part in parts) for parts in GROUPS.values()]
    names = ("private_before_set_up", "estimated", "private_peak")
    start, estimated, peak = (memory[f"{name}_bytes_per_rank"][0] for name in names)
    return [
        f"{summary['counts']['undirected_bonds']:,}",
        *(show(size) for size in (*groups, sum(sizes.values()), estimated, peak - start)),
        f"{summary['solve']['evaluations']}",
        f"{seconds:.1f}",
        "; ".join(memory["bond_kernels"]) or "-",
    ]


def show(size):
    """MiB with three figures or so; a dash for nothing."""
    mib = size / 2**20
    return "-" if not size else f"{mib:.0f}" if mib >= 9.95 else f"{mib:.1f}" if mib >= 0.095 else "< .1"
