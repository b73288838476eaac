"""Solve one deck with several internal lengths in a loop, and print how stiff each bar is.

Type ``python jobs/examples/study.py`` (some ten seconds; the runs stay in ``runs/lengths``).
"""

from pathlib import Path

import pdfem_mpi as pdfem

JOBS = Path(__file__).resolve().parents[1]
CELLS = 0.1


def main():
    print("internal length   E of the bonds / E   Poisson's ratio   bonds")
    for ratio in (1.0, 1.25, 1.5):
        scene = pdfem.read_deck(
            JOBS / "bar_tension.toml",
            {"mesh.spacing": CELLS, "peridynamics.internal_length": ratio * CELLS, "solver.kind": "cg"},
        )
        folder = pdfem.run(scene, f"runs/lengths/{ratio}", overwrite=True)
        probes, bonds = folder.summary["probes"], folder.summary["counts"]["undirected_bonds"]
        stiffness, poisson = probes["modulus_ratio_peridynamics"], probes["poissons_ratio_peridynamics"]
        print(f"{ratio * CELLS:15.3g} {stiffness:20.4f} {poisson:17.4f} {bonds:8,}")


if __name__ == "__main__":
    main()
