"""Figures for people, drawn by matplotlib's Agg canvas without pyplot and its global state."""

from pathlib import Path

import numpy as np

from pdfem_mpi.results.canvas import Axes, Figure, MaxNLocator, rc_context
from pdfem_mpi.results.labels import as_it_is
from pdfem_mpi.results.samples import BarStations, LineSamples
from pdfem_mpi.system.files import replacing

SIZE_INCHES, DPI = (8.0, 6.0), 150  # 1200 x 900 pixels
MARKER_SIZES = 3.2, 5.0  # points; smallest and largest
STYLE = {
    "font.size": 11,
    "axes.titlesize": 12,
    "axes.grid": True,
    "grid.color": "#e4e4e4",
    "axes.axisbelow": True,
}
LEGEND = {"ncols": 5, "frameon": False, "fontsize": 10, "columnspacing": 1.5, "handlelength": 1.6}

# Colour (Okabe & Ito, 2008) and marker both tell the parts apart, so the figure also works in grey or for a
# colour-blind reader.
PARTS = {
    "finite elements": {"color": "#0072B2", "marker": "s", "markeredgewidth": 0},
    "peridynamics": {"color": "#D55E00", "marker": "o", "markeredgewidth": 0},
}


def axial_displacement(path: str | Path, stations: BarStations, title: str = "", units: str = "") -> None:
    """Draw the displacement along a bar over the exact line, and the error under it (Fig. 12), as a PNG.

    Parameters
    ----------
    path : str or Path
        The PNG file; an older one is replaced.
    stations : BarStations
    title : str
        What was computed, above the figure.
    units : str
        The deck's unit of length, a label only; "" if the deck names none.

    Raises
    ------
    ValueError
        As `BarStations.error_percent`; nothing is written then.
    """
    unit = f" ({as_it_is(units)})" if units else " (length units)"
    error = stations.error_percent
    marker_size = float(np.clip(400.0 / len(error), *MARKER_SIZES))  # smaller where stations lie close together
    with rc_context(STYLE), replacing(path) as temporary:
        figure = Figure(figsize=SIZE_INCHES, dpi=DPI, layout="constrained")
        upper, lower = figure.subplots(2, 1, sharex=True, height_ratios=(3, 2))
        order = np.argsort(stations.coordinate, kind="stable")
        exact = [np.asarray(array)[order] for array in (stations.coordinate, stations.exact)]
        upper.plot(*exact, color="black", linewidth=1.0, label="exact solution", zorder=3)
        lower.axhline(0.0, color="black", linewidth=1.0, zorder=3)
        for panel, values in ((upper, stations.displacement), (lower, error)):
            _draw_parts(panel, stations, np.asarray(values), marker_size)
            _mark_interface(panel, stations)
            panel.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
            panel.ticklabel_format(axis="y", scilimits=(-2, 4), useMathText=True)

        upper.set_ylabel(f"displacement $u_{stations.axis}${unit}")
        lower.set_ylabel("error\n(% of end displacement)")
        lower.set_xlabel(f"position along the bar, ${stations.axis}${unit}")
        figure.legend(
            handles=upper.get_legend_handles_labels()[0],
            loc="outside lower center",
            markerscale=MARKER_SIZES[1] / marker_size,
            **LEGEND,
        )
        figure.align_ylabels()
        if title:
            figure.suptitle(as_it_is(title))
        figure.savefig(temporary, format="png")


def displacement_along_line(path: str | Path, samples: LineSamples, title: str = "", units: str = "") -> None:
    """Draw u_x and u_y along a line, finite elements and peridynamics told apart (Fig. 15), as a PNG.

    Parameters
    ----------
    path : str or Path
        The PNG file; an older one is replaced.
    samples : LineSamples
    title : str
        What was computed, above the figure.
    units : str
        The deck's unit of length, a label only; "" if the deck names none.
    """
    unit = f" ({as_it_is(units)})" if units else " (length units)"
    marker_size = float(np.clip(500.0 / len(samples.coordinate), *MARKER_SIZES))
    with rc_context(STYLE), replacing(path) as temporary:
        figure = Figure(figsize=SIZE_INCHES, dpi=DPI, layout="constrained")
        panels = figure.subplots(2, 1, sharex=True)
        for component, (panel, name) in enumerate(zip(panels, "xy", strict=True)):
            values = np.asarray(samples.displacement)[:, component]
            panel.plot(samples.coordinate, values, color="#555555", linewidth=0.8, zorder=1)
            for part, style in PARTS.items():
                of_part = np.asarray(samples.kind) == part
                if of_part.any():
                    panel.plot(
                        np.asarray(samples.coordinate)[of_part],
                        values[of_part],
                        linestyle="none",
                        markersize=marker_size,
                        label=part,
                        **style,
                    )
            panel.yaxis.set_major_locator(MaxNLocator(6, steps=[1, 2, 5, 10]))
            panel.ticklabel_format(axis="y", scilimits=(-2, 4), useMathText=True)
            panel.set_ylabel(f"displacement $u_{name}${unit}")
        along = f"${samples.along}$" if len(samples.along) == 1 else as_it_is(samples.along)
        panels[-1].set_xlabel(f"position on the line, {along}{unit}")
        figure.legend(
            handles=panels[0].get_legend_handles_labels()[0],
            loc="outside lower center",
            markerscale=MARKER_SIZES[1] / marker_size,
            **LEGEND,
        )
        figure.align_ylabels()
        figure.suptitle("\n".join(as_it_is(text) for text in (title, samples.where) if text))
        figure.savefig(temporary, format="png")


def _draw_parts(panel: Axes, stations: BarStations, values: np.ndarray, marker_size: float) -> None:
    """Draw one marker for each station, in the way of its part."""
    for part, style in PARTS.items():
        of_part = np.asarray(stations.kind) == part
        if of_part.any():
            coordinate = np.asarray(stations.coordinate)[of_part]
            panel.plot(coordinate, values[of_part], linestyle="none", markersize=marker_size, label=part, **style)


def _mark_interface(panel: Axes, stations: BarStations) -> None:
    """Mark the interface by a dashed line and the overlap by a shaded band."""
    if stations.interface is not None:
        panel.axvline(stations.interface, color="#555555", linestyle="--", linewidth=1.2, label="interface")
    if stations.overlap is not None:
        panel.axvspan(*stations.overlap, color="#009E73", alpha=0.3, linewidth=0, label="overlap (both models)")
