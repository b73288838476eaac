"""The figure of docs/speed_vs_error.md: error of the peak against processor seconds, and against memory."""

from __future__ import annotations

from pathlib import Path

from matplotlib import rc_context
from matplotlib.figure import Figure

from tools.studies.style import CURVES, STYLE

SVG = {"svg.fonttype": "none", "svg.hashsalt": "pdfem", "font.size": 9, "axes.titlesize": 10}
#: Smaller errors, in percent, stand on the lower edge.
FLOOR = 0.1


def draw(path: Path, rows, limit: float | None) -> None:
    """Two charts side by side; an empty one without a reference."""
    with rc_context(STYLE | SVG):
        figure = Figure(figsize=(10.0, 4.0), layout="constrained")
        axes = figure.subplots(1, 2, sharey=True)
        groups = dict.fromkeys(row.group for row in rows)
        for group, (colour, marker) in zip(groups if limit else (), CURVES, strict=False):
            mine = [row for row in rows if row.group == group]
            plain = sorted((row for row in mine if not row.setting), key=lambda row: -row.spacing)
            for one, cost in zip(axes, ("seconds", "memory"), strict=True):
                one.plot(*_points(plain, cost, limit), color=colour, marker=marker, linewidth=0.9, label=group)
                others = [row for row in mine if row.setting]
                one.plot(*_points(others, cost, limit), color=colour, marker=marker, linestyle="", fillstyle="none")
        for one, words in zip(axes, ("processor seconds, start included", "peak memory / MiB"), strict=True):
            one.set(xscale="log", yscale="log", xlabel=words)
        axes[0].set(ylabel="error of the peak in percent", ylim=(FLOOR, None))
        if limit:
            axes[0].legend(fontsize=7)
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, metadata={"Date": None})


def _points(rows, cost: str, limit: float) -> tuple[list[float], list[float]]:
    """Costs and errors in percent."""
    errors = [max(FLOOR, 100.0 * abs(row.peak / limit - 1.0)) for row in rows]
    return [getattr(row, cost) for row in rows], errors
