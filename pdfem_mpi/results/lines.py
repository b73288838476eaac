"""lines/NAME.csv: fields along a line, one row per sample, every number with all its digits."""

import csv
import math
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path

from pdfem_mpi.system.files import replacing

COLUMNS = ("distance", "x", "y", "z", "u_x", "u_y", "u_z", "model")


#: What the components of fields of so many numbers are called.
COMPONENTS = {
    1: ("value",),
    3: ("1", "2", "3"),
    6: ("xx", "yy", "zz", "xy", "yz", "zx"),
    9: tuple(f"{k}_{axis}" for k in "123" for axis in "xyz"),
}


def write_line(path: str | Path, rows: Iterable[Sequence], more: Mapping[str, Iterable[float]] | None = None) -> None:
    """Write the samples of a line.

    Parameters
    ----------
    path : str or Path
        An older file is replaced; its folder must exist.
    rows : iterable of (distance, position, displacement, model)
        Floats are written by ``repr``. Outside of the body displacement is None and model "": empty fields.
    more : dict of columns, optional
        Further columns by name; NaN is an empty field.
    """
    more = more or {}
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow((*COLUMNS, *more))
        columns = [iter(values) for values in more.values()]
        for distance, position, displacement, model in rows:
            u = [""] * 3 if displacement is None else [repr(float(value)) for value in displacement]
            others = [float(next(values)) for values in columns]
            texts = ["" if math.isnan(value) else repr(value) for value in others]
            writer.writerow([repr(float(value)) for value in (distance, *position)] + u + [model] + texts)
