"""The paper's plate without failure, before and after: its runs, its stations of Fig. 15, and their figure.

Before is the correction of appendix A with reading B of the coupling, after are fitted factors with the exact one. Both
are compared with finite elements on the same cells, whose own error the elements on cells half as long show.
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

from tools.studies.members import Series, results

STATIONS = {"u_x": (0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 4.5), "u_y": (0.0, 0.25, 0.5, 1.0, 2.0, 3.0, 4.0, 4.5)}
COMPONENTS = tuple(STATIONS)
#: u_x is 0 in the middle by symmetry; differences are told where it is at least this part of the largest.
LEAST = 0.04
#: Goal for fitted bonds, percent.
AGREED = 0.5
ELEMENTS, HALVED = "elements", "elements, half the spacing"
BEFORE, AFTER = "appendix A", "fitted"
EVERYWHERE, PART = "peridynamics, ", "coupled, "
BONDS = (EVERYWHERE + BEFORE, PART + BEFORE, EVERYWHERE + AFTER, PART + AFTER)
CURVES = {  # colour, line, marker
    ELEMENTS: ("black", "-", ""),
    HALVED: ("black", "--", ""),
    BONDS[0]: ("#D55E00", "-", "s"),
    BONDS[1]: ("#E69F00", "-", "^"),
    BONDS[2]: ("#0072B2", "-", "o"),
    BONDS[3]: ("#009E73", "-", "D"),
}
#: Both ends pulled in balance with a uniform stress; the deck's body forces over a layer of cells are not.
PULLS = (("x+", 6000.0), ("x-", -6000.0))
TRACTIONS = "loads=[" + ",".join(f'{{kind="traction",face="{f}",total=[{t},0.0,0.0]}}' for f, t in PULLS) + "]"


def make_series(full: bool) -> list[Series]:
    """The runs, cheap ones first: cells of the paper's 0.05 in, or of 0.1 in."""
    spacing = 0.05 if full else 0.1
    common = (f"mesh.spacing={spacing}", "output.fields=false", "output.figures=false")
    correction = "peridynamics.surface_correction"
    return [
        Series("elements", "plate_fe.toml", (f"mesh.spacing={spacing},{spacing / 2:g}",), common[1:]),
        Series("coupled", "plate_coupled.toml", (f"coupling.kind:{correction}=paper:appendix_a,exact:fitted",), common),
        Series("everywhere", "plate_pd.toml", (f"{correction}=appendix_a",), common),
        Series("everywhere_fitted", "plate_pd.toml", (f"{correction}=fitted",), (*common, TRACTIONS)),
    ]


def read_lines(series: list[Series], runs: Path) -> dict[str, dict[str, np.ndarray]]:
    """Columns of the bottom line of every finished run, by the names of ``CURVES``."""
    found = results(series, runs)
    pairs = [(name, members) for name, members in found.items()]
    names = {
        "elements": (ELEMENTS, HALVED),
        "coupled": (PART + BEFORE, PART + AFTER),
        "everywhere": (EVERYWHERE + BEFORE,),
        "everywhere_fitted": (EVERYWHERE + AFTER,),
    }
    return {
        label: member.run.line("bottom")
        for name, members in pairs
        for label, member in zip(names[name], members, strict=True)
    }


def differences(line: Mapping[str, np.ndarray], reference: Mapping[str, np.ndarray], component: str) -> np.ndarray:
    """Difference of a displacement along a line from a reference, in percent of the local value.

    NaN where the reference is below ``LEAST`` of its largest value. Both lines have the same places.

    Raises
    ------
    ValueError
        Other places.
    """
    if not np.allclose(line["x"], reference["x"], rtol=0.0, atol=1e-9):
        raise ValueError("the lines have other places")
    exact = np.asarray(reference[component], float)
    told = np.abs(exact) >= LEAST * np.abs(exact).max()
    return np.where(told, 100.0 * (line[component] - exact) / np.where(told, exact, 1.0), np.nan)


def at_stations(line: Mapping[str, np.ndarray], values: np.ndarray, component: str) -> np.ndarray:
    """Values along a line at the stations of a component, linear in between."""
    return np.interp(STATIONS[component], line["x"], values)


def extrapolate(lines: Mapping[str, Mapping[str, np.ndarray]]) -> dict[str, np.ndarray]:
    """What the elements on both spacings extrapolate to at second order along the line."""
    same, halved = lines[ELEMENTS], lines[HALVED]
    return {"x": same["x"]} | {name: halved[name] + (halved[name] - same[name]) / 3.0 for name in COMPONENTS}


def station_table(lines: Mapping[str, Mapping[str, np.ndarray]]) -> str:
    """Markdown: a row for each station, differences in percent of what the elements have there.

    From the elements on the same cells; of fitted bonds also from the extrapolated elements, and of those everywhere
    from those in a part.
    """
    same, limit = lines[ELEMENTS], extrapolate(lines)
    columns = [(label, lines[label], same) for label in CURVES if label != ELEMENTS]
    columns += [(f"{label}, from extrapolated elements", lines[label], limit) for label in BONDS[2:]]
    columns.append((f"{BONDS[2]}, from {BONDS[3]}", lines[BONDS[2]], lines[BONDS[3]]))
    text = "| station | elements / 1e-3 in | " + " | ".join(label for label, *_ in columns) + " |\n"
    text += "|" + "---|" * (2 + len(columns)) + "\n"
    for component in COMPONENTS:
        exact = at_stations(same, same[component], component)
        rows = [at_stations(same, differences(line, goal, component), component) for _, line, goal in columns]
        for k, x in enumerate(STATIONS[component]):
            cells = " | ".join(f"{row[k]:+.2f} %" for row in rows)
            text += f"| {component}, x = {x:g} | {1e3 * exact[k]:.4f} | {cells} |\n"
    return text


def draw_plate(path: Path, lines: Mapping[str, Mapping[str, np.ndarray]], spacing: float) -> None:
    """Displacements of the right half of the bottom line, and their differences from the elements at two scales."""
    reference = lines[ELEMENTS]
    x = reference["x"]
    right = x >= -1e-9
    figure, rows = plt.subplots(
        3, 2, figsize=(9.6, 8.8), layout="constrained", sharex=True, height_ratios=(1.0, 1.0, 1.2)
    )
    for left, right_hand in rows[1:]:
        right_hand.sharey(left)
    for column, component in enumerate(COMPONENTS):
        top, middle, bottom = rows[:, column]
        for number, (label, (colour, style, marker)) in enumerate(CURVES.items()):
            options = {"color": colour, "ls": style, "marker": marker, "ms": 4, "lw": 1.2, "label": label}
            options["markevery"] = (2 * number, 12)
            line = lines[label]
            top.plot(x[right], 1e3 * line[component][right], **options)
            values = differences(line, reference, component)[right]
            middle.plot(x[right], values, **options)
            if label not in BONDS[:2]:
                bottom.plot(x[right], values, **options)
        bottom.axhspan(-AGREED, AGREED, color="0.92", zorder=0)
        top.set_title(f"${component}$ along y = -1.5 in", fontsize="medium")
        bottom.set_xlabel("x / in")
        for axes in (top, middle, bottom):
            axes.axvline(2.0, color="0.6", ls=":", lw=0.9)
            axes.set_xlim(0.0, 4.5)
            axes.spines[["top", "right"]].set_visible(False)
    rows[0, 0].annotate("interface", (2.0, rows[0, 0].get_ylim()[1]), (3, -10), textcoords="offset points", fontsize=8)
    rows[0, 0].set_ylabel("displacement / $10^{-3}$ in")
    rows[0, 1].set_ylim(0.0, None)
    rows[1, 0].set_ylabel("from elements\n% of the local value")
    rows[2, 0].set_ylabel(f"the same without appendix A\n(grey: {AGREED:g} %)")
    figure.legend(*rows[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=3, frameon=False)
    figure.suptitle(f"The paper's plate without failure, cells of {spacing:g} in, right half of its bottom line")
    figure.savefig(path, metadata={"Date": None})
    plt.close(figure)
