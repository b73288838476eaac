"""Every deck of ``jobs/`` in a coarse form, and what must not change in its results."""

from __future__ import annotations

import csv
import hashlib
import json
import subprocess
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]

# At most 20,000 cells, and runs that 32 ranks on two cores end in minutes: the longest stop early, beyond their first
# broken bonds. Only what has another answer than the deck's own cells is named.
COARSE = {
    "appendix_b_fe": ("mesh.spacing=0.16", "mesh.lower.2=-0.08", "mesh.upper.2=0.08", "mesh.lower.0=-4.96",
                      "mesh.upper.0=4.96", "mesh.lower.1=-2.0", "mesh.upper.1=2.0"),
    "appendix_b_pd": ("mesh.spacing=0.16", "mesh.lower.2=-0.08", "mesh.upper.2=0.08", "mesh.lower.0=-4.96",
                      "mesh.upper.0=4.96", "peridynamics.internal_length=0.16"),
    "plate_cutout_ramp": ("mesh.spacing=0.1", "stepping.increment=1e-3", "stepping.end_load_factor=0.5",
                          "stepping.report_every=100", "checkpoint.iterations=250", "output.damage=false"),
    "plate_cutout": ("mesh.spacing=0.1", "checkpoint.steps=10", "output.damage=false"),
    "plate_adaptive": ("mesh.spacing=0.1", "output.damage=false"),
    "double_cantilever": ("mesh.lower.2=-0.1", "mesh.upper.2=0.1", "stepping.eta=0.1", "stepping.end_load_factor=0.6",
                          "checkpoint.steps=5"),
    "three_point_bending": ("stepping.end_reaction=0.8",),
    "plate_centre_crack": ("mesh.lower.2=-0.1", "mesh.upper.2=0.1", "stepping.eta=0.1", "stepping.end_reaction=0.7",
                           "checkpoint.steps=5"),
    "bar_fe": ("mesh.spacing=0.1", "solver.tolerance=1e-4"),
    "bar_pd": ("mesh.spacing=0.1", "solver.tolerance=1e-3"),
    "bar_tension_relaxed": ("mesh.spacing=0.1", "solver.tolerance=1e-3"),
    "bar_tension": ("mesh.spacing=0.1", "solver.tolerance=1e-3"),
}  # fmt: skip
HALVED = ("mesh.spacing=0.1",)
#: These fail along the way, so there are checkpoints to continue from.
STOPPED = ("plate_cutout", "plate_cutout_ramp", "double_cantilever", "plate_centre_crack")
#: Decks as they are: the mesh is a file.
AS_IS = ("plate_fe_gmsh",)
WALL_SECONDS = "wall_seconds"


@dataclass(frozen=True)
class Digests:
    """What a run's results are recognised by."""

    fields: str
    history: str
    broken: int

    @classmethod
    def of(cls, folder: Path) -> Digests:
        """Those of a run folder."""
        summary = json.loads((folder / "summary.json").read_text())
        with (folder / "history.csv").open(newline="") as file:
            rows = [{name: text for name, text in row.items() if name != WALL_SECONDS} for row in csv.DictReader(file)]
        last = rows[-1] if rows else {}
        text = json.dumps(rows, sort_keys=True)
        return cls(
            summary["fields_sha256"] or "",
            hashlib.sha256(text.encode()).hexdigest(),
            int(last.get("broken_bonds") or 0),
        )


def names() -> list[str]:
    """All decks of ``jobs/``, without the hard ones."""
    return sorted(path.stem for path in (ROOT / "jobs").glob("*.toml"))


def settings(name: str) -> list[str]:
    """Options that make a deck coarse."""
    keys = COARSE.get(name, () if name in AS_IS else HALVED)
    return [f"--set={key}" for key in (*keys, "output.fields=false", "output.figures=false")]


def pdfem(root: Path, *arguments: str) -> None:
    """Call a checkout's program.

    Raises
    ------
    RuntimeError
        With what it said, when it ended with another code than 0, or 74 of a body that is apart.
    """
    command = [str(root / ".venv" / "bin" / "pdfem"), *arguments]
    done = subprocess.run(command, cwd=root, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode not in (0, 74):
        raise RuntimeError(f"{' '.join(command)} ended with {done.returncode}:\n{done.stdout}{done.stderr}")
