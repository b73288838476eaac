"""The figures of docs/speed_vs_error.md: an error against processor seconds, and against memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from tools.studies.style import CURVES, STYLE

SVG = {"svg.fonttype": "none", "svg.hashsalt": "pdfem", "font.size": 9, "axes.titlesize": 10}


@dataclass(frozen=True)
class Mark:
    """One mark of a chart.

    Attributes
    ----------
    group : str
        What stands in the legend; marks of a group that have no other setting are joined.
    plain : bool
        No setting of it differs from the group's: others are open marks.
    seconds, memory : float
        Processor seconds, MiB.
    error : float
        In percent, of either sign.
    """

    group: str
    plain: bool
    seconds: float
    memory: float
    error: float


def draw(path: Path, marks: Sequence[Mark], what: str, floor: float) -> None:
    """Two charts side by side; empty ones without marks.

    Parameters
    ----------
    what : str
        The error, in words.
    floor : float
        Smaller errors, in percent, stand on the lower edge.
    """
    with rc_context(STYLE | SVG):
        figure = Figure(figsize=(10.0, 4.0))
        figure.subplots_adjust(left=0.07, right=0.99, bottom=0.12, top=0.97, wspace=0.05)
        axes = figure.subplots(1, 2, sharey=True)
        groups = dict.fromkeys(mark.group for mark in marks)
        for group, (colour, marker) in zip(groups, CURVES, strict=False):
            mine = [mark for mark in marks if mark.group == group]
            plain = sorted((mark for mark in mine if mark.plain), key=lambda mark: mark.seconds)
            others = [mark for mark in mine if not mark.plain]
            for one, cost in zip(axes, ("seconds", "memory"), strict=True):
                one.plot(*_points(plain, cost, floor), color=colour, marker=marker, linewidth=0.9, label=group)
                one.plot(
                    *_points(others, cost, floor),
                    color=colour,
                    marker=marker,
                    linestyle="",
                    fillstyle="none",
                    clip_on=False,
                )
        for one, words in zip(axes, ("processor seconds, start included", "peak memory / MiB"), strict=True):
            one.set(xscale="log", yscale="log", xlabel=words)
            for axis in (one.xaxis, one.yaxis):
                axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
                axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
                axis.set_minor_formatter(NullFormatter())
        axes[0].set(ylabel=f"{what} in percent", ylim=(floor, None))
        if marks:
            axes[0].legend(fontsize=7)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, metadata={"Date": None})


def _points(marks: Sequence[Mark], cost: str, floor: float) -> tuple[list[float], list[float]]:
    """Costs and errors in percent."""
    return [getattr(mark, cost) for mark in marks], [max(floor, abs(mark.error)) for mark in marks]
