"""Cubes of 6 x 6 x 6 cells, one on each rank: what a rank holds, for the table of docs/scaling.md.

Nothing assumes as many cores as ranks: bytes and counts are measured, no times. ``--ranks 1 8 32 256`` chooses others;
options after ``--`` are those of ``pdfem run``.
"""

from __future__ import annotations

import argparse
import tempfile
from pathlib import Path

import numpy as np

from tools.studies.series import DOCS, fill, run_deck, summary_of, table

#: Cells along an edge of a rank's cube, and their length.
CUBE, EDGE = 6, 0.05
COMMON = {
    "output.fields": "false",
    "output.figures": "false",
    "probes": "[]",
    "peridynamics.surface_correction": '"none"',
    "solver.tolerance": "1e-3",
}
SOLVERS = {"cg": {"solver.kind": '"cg"'}, "adr": {"solver.kind": '"adr"', "solver.tolerance": "0.3"}}
#: Parts of ``array_bytes`` of the summary that are shown together.
GROUPS = {
    "bonds": ("bond_rows", "bond_strengths", "bond_counts"),
    "mesh and share": ("mesh", "share_of_the_rank"),
    "coarse grid": ("coarse_grid",),
    "intact elements": ("intact_elements", "preconditioner_blocks"),
}
HEADER = [
    "solver", "ranks", "bonds of a rank, max / mean", "evaluations", *(f"{name}, KiB a rank" for name in GROUPS),
    "all arrays, MiB a rank", "estimated, MiB, mean / max", "private peak above start, MiB, mean / max",
    "resident, MiB, mean / max",
]  # fmt: skip


def main(words: list[str]) -> int:
    """Run all cases, print the rows, fill the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--ranks", type=int, nargs="+", default=[1, 8, 32])
    parser.add_argument("--only", choices=SOLVERS, nargs="+", default=list(SOLVERS))
    parser.add_argument("options", nargs="*")
    asked = parser.parse_args(words)
    rows = []
    with tempfile.TemporaryDirectory() as folder:
        for solver in asked.only:
            for ranks in asked.ranks:
                out = Path(folder) / f"{solver}-{ranks}"
                box = {f"mesh.{key}": str(value) for key, value in box_of(ranks).items()}
                run_deck("bar_pd.toml", COMMON | SOLVERS[solver] | box, out, "-n", str(ranks), *asked.options)
                rows.append([solver, *row(summary_of(out))])
                print(" | ".join(rows[-1]), flush=True)
    fill(DOCS / "scaling.md", {"table": table(HEADER, rows)})
    return 0


def box_of(ranks: int) -> dict[str, object]:
    """The mesh of as many cubes as ranks, as near to a cube as their number allows."""
    counts, left = [1, 1, 1], ranks
    for divisor in (7, 5, 3, 2):
        while left % divisor == 0:
            left //= divisor
            counts[counts.index(min(counts))] *= divisor
    counts[0] *= left
    upper = [round(CUBE * EDGE * n, 6) for n in sorted(counts, reverse=True)]
    return {"lower": [0.0, 0.0, 0.0], "upper": upper, "spacing": EDGE}


def row(summary: dict) -> list[str]:
    """The columns of a run."""
    memory, ranks = summary["memory"], summary["ranks"]
    sizes, bonds = memory["array_bytes"], summary["bonds_per_rank"]
    groups = (sum(sizes.get(part, 0) for part in parts) / ranks for parts in GROUPS.values())
    private, resident = (
        np.array(memory[f"{kind}peak_bytes_per_rank"]) - memory[f"{kind}before_set_up_bytes_per_rank"]
        for kind in ("private_", "")
    )
    return [
        f"{ranks}",
        f"{max(bonds):,} / {sum(bonds) // ranks:,}",
        f"{summary['solve']['evaluations']}",
        *(f"{size / 2**10:,.0f}" for size in groups),
        f"{sum(sizes.values()) / ranks / 2**20:.1f}",
        *(mean_and_most(sizes) for sizes in (np.array(memory["estimated_bytes_per_rank"]), private, resident)),
    ]


def mean_and_most(sizes: np.ndarray) -> str:
    """Of the ranks, in MiB."""
    return f"{sizes.mean() / 2**20:.1f} / {sizes.max() / 2**20:.1f}"
