"""study.csv and its figure: the results of several runs of one deck, over the keys that were varied."""

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator, NullFormatter, ScalarFormatter

from pdfem_mpi.results.labels import as_it_is
from pdfem_mpi.results.plots import STYLE
from pdfem_mpi.system.files import replacing

MAX_PANELS = 6
PANEL_INCHES, DPI = (4.4, 3.4), 110
WIDE = 20.0  # largest over smallest value from which on the axis is logarithmic
# Okabe & Ito (2008), with a marker each: also told apart in grey
CURVES = (
    ("#0072B2", "o"), ("#D55E00", "s"), ("#009E73", "^"), ("#CC79A7", "D"), ("#56B4E9", "v"), ("#E69F00", "P"),
    ("#000000", "x"), ("#999999", "*"),
)  # fmt: skip


@dataclass(frozen=True)
class Series:
    """One curve: the same values of all keys but the one on the axis.

    Attributes
    ----------
    label : str
        The other keys and their values; empty if there is one curve.
    x : list of str
        Values on the axis as they were given.
    results : dict from name to list of float or None
        None where a member has no such result.
    """

    label: str
    x: Sequence[str]
    results: Mapping[str, Sequence[float | None]]


def write_table(path: str | Path, header: Sequence[str], rows: Sequence[Sequence[Any]]) -> None:
    """Write the table as CSV under a temporary name, then rename it; floats by ``repr``."""
    with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
        writer = csv.writer(file, lineterminator="\n")
        writer.writerow(header)
        writer.writerows([repr(value) if isinstance(value, float) else value for value in row] for row in rows)


def draw_study(
    path: str | Path,
    series: Sequence[Series],
    along: str,
    units: Mapping[str, str] | None = None,
    title: str = "",
    note: str = "",
) -> None:
    """Draw a panel for each result (at most six) over the varied key, as a PNG.

    Parameters
    ----------
    path : str or Path
        The PNG file; an older one is replaced.
    series : list of Series
        With the same results each.
    along : str
        Label of the axis: key and unit.
    units : dict from result to str, optional
    title : str
    note : str
        Under the title, such as how many members failed.
    """
    names = list(series[0].results)[:MAX_PANELS]
    values = [_number(text) for curve in series for text in curve.x]
    numeric = all(value is not None for value in values)
    words = list(dict.fromkeys(text for curve in series for text in curve.x))
    columns = min(len(names), 2 if len(names) != 3 else 3)
    rows = -(-len(names) // columns)
    size = PANEL_INCHES[0] * max(columns, 1.5), PANEL_INCHES[1] * rows + 0.8
    with matplotlib.rc_context(STYLE), replacing(path) as temporary:
        figure = Figure(figsize=size, dpi=DPI, layout="constrained")
        panels = figure.subplots(rows, columns, squeeze=False).reshape(-1)
        for panel in panels[len(names) :]:
            panel.set_axis_off()
        for panel, name in zip(panels, names, strict=False):
            _draw_curves(panel, series, name, words if not numeric else None)
            _mark_axis(panel, values if numeric else None, words)
            unit = (units or {}).get(name, "")
            panel.set_ylabel(as_it_is(name.replace("_", " ") + (f" ({unit})" if unit else "")))
            panel.set_xlabel(as_it_is(along))
            panel.yaxis.set_major_locator(MaxNLocator(6))
            panel.ticklabel_format(axis="y", scilimits=(-3, 5), useMathText=True)
        if len(series) > 1:
            handles = panels[0].get_legend_handles_labels()[0]
            figure.legend(
                handles=handles,
                loc="outside lower center",
                ncols=min(len(series), columns + 1),
                frameon=False,
                fontsize=10,
            )
        figure.suptitle("\n".join(as_it_is(text) for text in (title, note) if text))
        figure.savefig(temporary, format="png")


def _draw_curves(panel, series: Sequence[Series], name: str, words: Sequence[str] | None) -> None:
    """One result of all series; over numbers, joined by lines, or over ``words``."""
    for number, curve in enumerate(series):
        colour, marker = CURVES[number % len(CURVES)]
        x = [_number(text) if words is None else words.index(text) for text in curve.x]
        y = [math.nan if value is None else value for value in curve.results[name]]
        order = sorted(range(len(x)), key=x.__getitem__)
        panel.plot(
            [x[k] for k in order],
            [y[k] for k in order],
            color=colour,
            marker=marker,
            markersize=5,
            linewidth=1.2 if words is None else 0.0,
            label=as_it_is(curve.label),
        )


def _mark_axis(panel, values: Sequence[float] | None, words: Sequence[str]) -> None:
    """Ticks at the values: numbers, on a logarithmic axis if they spread widely, or words."""
    if values is None:
        panel.set_xticks(range(len(words)), [as_it_is(word) for word in words])
        panel.margins(x=0.2)
        return
    if min(values) > 0.0 and max(values) / min(values) >= WIDE:
        panel.set_xscale("log")
        panel.xaxis.set_minor_formatter(NullFormatter())
    ticks = sorted(set(values))
    if len(ticks) <= 8:
        panel.set_xticks(ticks)
        panel.xaxis.set_major_formatter(ScalarFormatter())


def _number(text: str) -> float | None:
    try:
        value = float(text)
    except ValueError:
        return None
    return value if math.isfinite(value) else None
