"""Figures of docs/experiments.md: loads over what was measured, and paths of cracks."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
from matplotlib import rc_context
from matplotlib.figure import Figure

from tools.studies.experiments.cases import Case, Experiment
from tools.studies.experiments.curves import Curve, columns
from tools.studies.style import CURVES, STYLE

SVG = {"svg.fonttype": "none", "svg.hashsalt": "pdfem", "font.size": 9, "axes.titlesize": 10}
MEASURED = {"color": "#222222", "linestyle": "", "marker": "o", "markersize": 3.5, "label": "measured"}
#: So many points of a curve are drawn.
POINTS = 150


def draw_loads(
    path: Path,
    experiment: Experiment,
    curves: Mapping[str, Curve],
    measured: Mapping[str, np.ndarray] | None,
    paths: Mapping[str, tuple[np.ndarray, np.ndarray]],
    traced: Mapping[str, np.ndarray] | None = None,
) -> None:
    """Load over displacement, and beside it the paths of the crack where there are some.

    Parameters
    ----------
    curves, paths : by the words of the legend
    measured : the load's, or None
    traced : the path's, or None
    """
    with rc_context(STYLE | SVG):
        figure = Figure(figsize=(8.0 if paths else 5.2, 3.4), layout="constrained")
        axes = figure.subplots(1, 2) if paths else [figure.subplots()]
        if curves:
            _draw_curves(axes[0], experiment, curves, measured)
        if paths:
            _draw_paths(axes[1], paths, traced)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, metadata={"Date": None})


def _draw_curves(axes, experiment, curves, measured) -> None:
    if measured is not None:
        at, *loads = columns(measured)
        if len(loads) == 2:
            axes.fill_between(at, *loads, color="#cccccc", label="measured band")
        else:
            axes.plot(at, loads[0], **MEASURED)
    for (label, curve), (colour, _) in zip(curves.items(), CURVES, strict=False):
        at, load = curve.rising()
        keep = np.unique(np.r_[0, np.linspace(0, len(at) - 1, POINTS).astype(int), int(np.argmax(load))])
        axes.plot(np.r_[0.0, at[keep]], np.r_[0.0, load[keep]], color=colour, linewidth=1.1, label=label)
    axes.set(xlabel=experiment.axis, ylabel="load / N", xlim=(0.0, None), ylim=(0.0, None))
    axes.set_title(experiment.title)
    axes.legend(fontsize=8)


def _draw_paths(axes, paths, traced) -> None:
    if traced is not None:
        axes.plot(*columns(traced), **MEASURED)
    for (label, (x, y)), (colour, _) in zip(paths.items(), CURVES, strict=False):
        axes.plot(x, y, color=colour, linewidth=1.1, label=label)
    axes.set(xlabel="x / mm", ylabel="y / mm")
    axes.set_aspect("equal", adjustable="datalim")
    axes.set_title("middle of the crack")
    axes.legend(fontsize=7, loc="lower left")


def label_of(case: Case, bodies: Sequence[str]) -> str:
    """Words for a legend."""
    words = f"cells {case.spacing:.3g}"
    if case.length != 1.0:
        words += f", l {case.internal:.3g}"
    if len(bodies) > 1 or case.body == "slice":
        words += f", {case.body}"
    return words + (f", {case.material}" if case.material else "")
