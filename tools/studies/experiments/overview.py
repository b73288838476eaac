"""One row for each test: how far its peak is from the measured one, and what thickness, cells and length change."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from tools.studies.experiments.cases import OTHER, SLICE, TESTS, Case, Experiment
from tools.studies.experiments.curves import Curve, columns, read_measured, rms
from tools.studies.series import table

Read = Callable[[Case], Curve | None]


def overview_table(read: Read) -> list[str]:
    """All tests, and those with another set of material values or another place of the load.

    Parameters
    ----------
    read : callable
        The curve of a case; None without a run.
    """
    head = [
        "test", "half of the thickness", "slice", "rms along its curve", "its change with cells half as wide",
        f"and with l = {OTHER:g} cells",
    ]  # fmt: skip
    rows = [_row(one, material, read) for one in TESTS for material in ("", *one.sets)]
    return table(head, [row for row in rows if row[2]])


def _row(one: Experiment, material: str, read: Read) -> list[str]:
    slice_, half = Case(one, body=SLICE, material=material), Case(one, material=material)
    coarse = read(slice_)
    measured = read_measured(one.measured)
    fit = ""
    if coarse is not None and measured is not None and len(columns(measured)) == 2:
        fit = f"{100.0 * rms(coarse, measured)[0]:.1f} %"
    finer = Case(one, level=1, body=SLICE, material=material, short=True)
    shorter = Case(one, body=SLICE, length=OTHER, material=material, short=True)
    return [
        ", ".join(part for part in (one.title, material) if part),
        off(read(half), measured), off(coarse, measured), fit,
        change(read(finer), coarse), change(read(shorter), coarse),
    ]  # fmt: skip


def off(curve: Curve | None, measured: dict[str, np.ndarray] | None) -> str:
    """How far the peak is from the measured one, or the nearer edge of the band of specimens; empty without one."""
    if curve is None or measured is None:
        return ""
    _, *loads = columns(measured)
    peak, peaks = curve.peak[0], [float(np.nanmax(load)) for load in loads]
    if len(peaks) == 2 and peaks[0] <= peak <= peaks[1]:
        return "in the band"
    nearer = min(peaks, key=lambda load: abs(load - peak))
    error = 100.0 * (peak / nearer - 1.0)
    side = "above" if error > 0.0 else "below"
    return f"{error:+.1f} %" if len(peaks) == 1 else f"{abs(error):.1f} % {side} the band"


def change(other: Curve | None, one: Curve | None) -> str:
    """Of the peak, in percent; empty where one was not run."""
    return "" if other is None or one is None else f"{100.0 * (other.peak[0] / one.peak[0] - 1.0):+.1f} %"
