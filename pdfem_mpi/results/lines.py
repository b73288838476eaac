"""lines/NAME.csv: displacements along a line, one row per sample, every number with all its digits."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path

from pdfem_mpi.system.files import replacing

COLUMNS = ("distance", "x", "y", "z", "u_x", "u_y", "u_z", "model")


def write_line(path: str | Path, rows: Iterable[Sequence]) -> None:
    """Write the samples of a line.

    Parameters
    ----------
    path : str or Path
        An older file is replaced; its folder must exist.
    rows : iterable of (distance, position, displacement, model)
        Floats are written by ``repr``. Outside of the body displacement is None and model "": empty fields.
    """
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(COLUMNS)
        for distance, position, displacement, model in rows:
            u = [""] * 3 if displacement is None else [repr(float(value)) for value in displacement]
            writer.writerow([repr(float(value)) for value in (distance, *position)] + u + [model])
