"""Curves of load over displacement, measured and computed, and how far they are apart."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np

from pdfem_mpi import open_run
from tools.studies.experiments.cases import Case
from tools.studies.series import summary_of

#: Rows of a history at which the body is stable: others stand on the way between two of them.
STABLE = ("critical", "arrest")
#: Damage from which a point belongs to a crack, and the power that draws its middle to the most damaged points.
CRACKED, SHARPNESS = 0.2, 4


def read_measured(path: Path) -> dict[str, np.ndarray] | None:
    """Columns of a measured file, NaN where a field is empty; None, and a sentence, where the file is missing."""
    if not path.exists():
        print(f"{path.name} is missing: drawn and told without what was measured.")
        return None
    lines = [line for line in path.read_text(encoding="utf-8").splitlines() if line and not line.startswith("#")]
    names = lines[0].split(",")
    rows = [[float(text) if text else np.nan for text in line.split(",")] for line in lines[1:]]
    return dict(zip(names, np.array(rows).T, strict=True))


def columns(measured: dict[str, np.ndarray]) -> list[np.ndarray]:
    """Abscissa and loads of a measured file, in the order of its columns."""
    return list(measured.values())


@dataclass(frozen=True)
class Curve:
    """Stable states of one run, for the whole specimen: float64, shape (n,).

    Attributes
    ----------
    at : dimension length
        Displacement or opening.
    load : dimension force
    work : float, dimension force * length
        Of the loads on the specimen over the whole run, less the energy that is left in it.
    """

    at: np.ndarray
    load: np.ndarray
    work: float

    @property
    def peak(self) -> tuple[float, float]:
        """Largest load, and where."""
        k = int(np.argmax(self.load))
        return float(self.load[k]), float(self.at[k])

    def rising(self) -> tuple[np.ndarray, np.ndarray]:
        """The states that a test sees whose abscissa never shrinks."""
        seen = np.concatenate(([True], self.at[1:] > np.maximum.accumulate(self.at)[:-1]))
        return self.at[seen], self.load[seen]

    def slope(self) -> float:
        """Of the first state: the elastic one."""
        return float(self.load[0] / self.at[0])


def read_curve(case: Case) -> Curve | None:
    """What a run gave; None where it has not ended."""
    summary = summary_of(case.folder)
    if summary.get("exit_code") != 0:
        return None
    history = open_run(case.folder).history
    stable = np.isin(history["event"], STABLE)
    at, load = np.abs(history[case.experiment.abscissa]), np.abs(history[case.experiment.force])
    work = (history["external_work"][-1] - history["stored_energy"][-1]) * case.scale
    keep = stable & np.isfinite(at) & np.isfinite(load) & (at > 0.0)
    return Curve(at[keep], load[keep] * case.scale, float(work))


def rms(curve: Curve, measured: dict[str, np.ndarray]) -> tuple[float, float]:
    """Root mean square of the difference at the measured points over the measured peak, and the last of these points.

    Points beyond the end of the run are left out.
    """
    at, load = columns(measured)[:2]
    ours_at, ours = curve.rising()
    within = at <= ours_at[-1]
    difference = np.interp(at[within], np.r_[0.0, ours_at], np.r_[0.0, ours]) - load[within]
    return float(np.sqrt(np.mean(difference**2)) / np.nanmax(load)), float(at[within][-1])


def inside(curve: Curve, measured: dict[str, np.ndarray]) -> tuple[int, int]:
    """Of the measured points of a band how many have our curve within it, and how many there are."""
    at, low, high = columns(measured)
    ours_at, ours = curve.rising()
    whole = np.isfinite(low) & np.isfinite(high) & (at <= ours_at[-1])
    value = np.interp(at, np.r_[0.0, ours_at], np.r_[0.0, ours])
    good = whole & (value >= low) & (value <= high)
    return int(good.sum()), int(whole.sum())


def read_path(case: Case) -> tuple[np.ndarray, np.ndarray] | None:
    """Middle of the crack, layer of points by layer, float64, shapes (n,); None without damage.

    The damage of a layer across the way of the crack, to a power, weighs the places of its points.
    """
    folder = open_run(case.folder)
    try:
        damage, places = folder.points.field("damage"), folder.points.positions
    except (KeyError, OSError):
        return None
    along, across = (1, 0) if case.experiment.path == "y" else (0, 1)
    layer = np.round(places[:, along] / (0.25 * case.spacing)).astype(int)
    found = []
    for number in np.unique(layer):
        here = layer == number
        weight = np.asarray(damage[here], float) ** SHARPNESS
        if damage[here].max() >= CRACKED:
            found.append((places[here, along].mean(), float(np.average(places[here, across], weights=weight))))
    if not found:
        return None
    along_way, middle = np.array(found).T
    return (middle, along_way) if case.experiment.path == "y" else (along_way, middle)


def path_distance(path: tuple[np.ndarray, np.ndarray], measured: dict[str, np.ndarray]) -> float:
    """Largest distance across, at the measured points that the path reaches, of a crack that runs along y."""
    x, y = columns(measured)
    within = (y >= path[1].min()) & (y <= path[1].max())
    return float(np.abs(np.interp(y[within], path[1], path[0]) - x[within]).max())
