"""docs/paper.md: numbers from the finished runs and from what the tests measured, the figures, and the filled template.

A cell of a table whose numbers are missing says "not run".
"""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tools.studies.members import Result, Series, results
from tools.studies.paper import drawings as draw
from tools.studies.paper.cases import COARSE_CORNERS, STRAIN, X0, Y0
from tools.studies.series import table

TEMPLATE = Path(__file__).with_name("template.md")
Found = dict[str, list[Result]]
BAR_STRAIN = 1.0e-3
READINGS = {"paper": "reading B", "paper_a": "reading A"}
PLATE_OVERRIDES = ["mesh.spacing=0.2", *(f"regions.{name}={corner}" for name, corner in COARSE_CORNERS.items())]
FULL = "Full size."
COARSE = "Coarse set: numbers are those of coarse cells, see `tools/studies/study paper --full`."
#: What separates the cells of a table's row.
CELLS = re.compile(r"(?<!\\) \| ")


def unfinished(series: list[Series], runs: Path) -> list[str]:
    """Which series lack runs, one sentence each."""
    found = results(series, runs)
    missing = [f"series {item.name} has no finished run" for item in series if item.name not in found]
    missing += [
        f"series {item.name}: {len(found[item.name])} of {len(item.members())} runs finished"
        for item in series
        if item.name in found and len(found[item.name]) < len(item.members())
    ]
    return missing


def write_report(
    path: Path, figures: Path, series: list[Series], runs: Path, measured: dict[str, Any], full: bool
) -> None:
    """Draw, and fill the template; cells whose runs are missing say so.

    Parameters
    ----------
    measured : dict
        What the tests measured on small bodies; empty where they did not run.
    """
    found = results(series, runs)
    numbers: dict[str, Any] = {"size": FULL if full else COARSE, "figures": figures.relative_to(path.parent)}
    if measured:
        numbers |= measured | {"patch_table": _patch_table(measured)}
        _draw_small_bodies(measured, figures)
    for needs, make in STEPS:
        if all(name in found for name in needs):
            numbers |= make(found, figures, full)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(fill_template(TEMPLATE.read_text(encoding="utf-8"), numbers, figures), encoding="utf-8")


def fill_template(template: str, numbers: dict[str, Any], figures: Path) -> str:
    """The text with its numbers; a figure that was not drawn is left out with its caption."""
    lines = []
    parts = template.split("\n\n")
    for part, before in zip(parts, ["", *parts], strict=False):
        name = _figure_of(part) or _figure_of(before)
        if name is None or (figures / name).exists():
            lines.append("\n".join(_fill_line(line, numbers) for line in part.split("\n")))
    return "\n\n".join(lines)


def _figure_of(part: str) -> str | None:
    """The file that a paragraph shows."""
    found = re.fullmatch(r"!\[.*\]\(\{figures\}/(.*)\)", part)
    return found.group(1) if found else None


def cells_of(line: str) -> list[str]:
    """Cells of a table's row; nothing for another line."""
    return CELLS.split(line[2:-2]) if line.startswith("| ") else []


def _fill_line(line: str, numbers: dict[str, Any]) -> str:
    if cells := cells_of(line):
        return "| " + " | ".join(_filled(cell, numbers) for cell in cells) + " |"
    return _filled(line, numbers)


def _filled(text: str, numbers: dict[str, Any]) -> str:
    try:
        return text.format_map(numbers)
    except KeyError:
        return "not run"


def _patch_table(measured: dict[str, Any]) -> str:
    rows = []
    for name, errors in measured["patch"].items():
        moved = (f"{error:.3f}" if error >= 1e-3 else "0.000" for error, _ in errors)
        rows.append([name, *moved, f"{max(force for _, force in errors):.1e}"])
    return "\n".join(table(["block", *measured["patch_strains"], "forces, worst"], rows))


# --- numbers and figures -----------------------------------------------------------------------------------


def _draw_small_bodies(measured: dict[str, Any], figures: Path) -> None:
    """Figs 2, 4, 5 and those of appendix A."""
    stored = [(length, np.array(r), np.array(response)) for length, r, response in measured["stored_responses"]]
    draw.locality(figures / "paper_02.png", stored)
    stretch, force = np.array(measured["bond_stretch"]), np.array(measured["bond_force"])
    draw.bond_law(figures / "paper_04_05.png", stretch, force, measured["critical_stretch"])
    layers = np.array(measured["layers"])
    sweeps = {int(number): left for number, left in measured["sweeps"]}
    draw.surface_correction(figures / "paper_a.png", sweeps, layers[:, 0], layers[:, 1:], measured["block_cells"])


def _bar(found: Found, figures: Path, full: bool) -> dict[str, Any]:
    fe, pd = found["bar_fe"][0], found["bar_pd"][0]
    coupled = {result.values["coupling.kind"]: result for result in found["bar_coupled"]}
    lines = [("finite elements", 0, "-", fe), ("peridynamics", 1, "-", pd)]
    styles = {"paper": "-", "paper_a": "--"}
    for number, (kind, result) in enumerate(coupled.items(), start=2):
        lines.append((f"coupled, {READINGS[kind]}", number, styles[kind], result))
    drawn = []
    for label, number, style, result in lines:
        line = result.run.line("axis")
        u = line["u_x"] - 0.5 * (line["u_x"][0] + line["u_x"][-1])  # both ends move by opposite amounts
        drawn.append((label, number, style, line["x"], u))
    draw.bar_displacements(figures / "paper_12.png", drawn, BAR_STRAIN)
    spacing = [] if full else ["mesh.spacing=0.2"]
    draw.bar_mesh(figures / "paper_11.png", spacing)
    sides = np.array([10.0, 0.4, 0.4]) / (0.05 if full else 0.2)
    return {
        "bar_points": pd.run.summary["counts"]["points"],
        "bar_bonds": pd.run.summary["counts"]["undirected_bonds"],
        "bar_cells": " x ".join(f"{n:.0f}" for n in sides),
        "bar_fe_gap": abs(fe.numbers["end_error_percent"]),
        "bar_pd_gap": pd.numbers["end_error_percent"],
        "bar_pd_e": pd.numbers["modulus_ratio_peridynamics"],
        "bar_pd_nu": pd.numbers["poissons_ratio_peridynamics"],
        "bar_b_gap": coupled["paper"].numbers["end_error_percent"],
        "bar_a_gap": coupled["paper_a"].numbers["end_error_percent"],
        "bar_b_jump": coupled["paper"].numbers["interface_jump"],
        "bar_a_jump": coupled["paper_a"].numbers["interface_jump"],
    }


def _plate(found: Found, figures: Path, full: bool) -> dict[str, Any]:
    fe, pd = found["plate_fe"][0], found["plate_pd"][0]
    coupled = {result.values["coupling.kind"]: result for result in found["plate_coupled"]}
    curves = [("finite elements", 0, "-", fe), ("peridynamics", 1, "-", pd)]
    curves += [("coupled, reading B", 2, "-", coupled["paper"]), ("coupled, reading A", 3, "--", coupled["paper_a"])]
    lines = [(label, number, style, result.run.line("bottom")) for label, number, style, result in curves]
    draw.plate_lines(figures / "paper_15.png", lines)
    draw.plate_mesh(figures / "paper_13_14.png", [] if full else PLATE_OVERRIDES)
    reference = lines[0][3]

    def gap(number, component):
        size = np.abs(reference[component]).max()
        return 100.0 * float(np.abs(lines[number][3][component] - reference[component]).max()) / size

    tops = [result.numbers["top_of_hole_y"] for result in (coupled["paper"], pd)]
    quality = pd.run.summary["mesh"]
    return {
        "plate_shortest": quality["shortest_edge"],
        "plate_longest": quality["longest_edge"],
        "plate_jacobian": quality["smallest_scaled_jacobian"],
        "plate_pd_x": gap(1, "u_x"),
        "plate_b_x": gap(2, "u_x"),
        "plate_a_x": gap(3, "u_x"),
        "plate_pd_y": gap(1, "u_y"),
        "plate_b_y": gap(2, "u_y"),
        "plate_hole": 100.0 * abs(tops[0] / tops[1] - 1.0),
    }


def _at_x0(result: Result) -> np.ndarray:
    return np.array([result.numbers["x0_x"], result.numbers["x0_y"]])


def _poissons_ratio(u: np.ndarray) -> float:
    """Eq. B3."""
    return -(u[1] / Y0) / (u[0] / X0)


def _thickness(result: Result) -> float:
    return float(result.values["mesh.upper.2"]) - float(result.values["mesh.lower.2"])


def _thicknesses(found: Found, figures: Path, full: bool) -> dict[str, Any]:
    """Figs B2 and B3."""
    h = 0.08 if full else 0.5
    members = found["b2_thickness"] + found.get("b2_long", [])
    elements = _at_x0(found["b_fe"][0])
    by_length: dict[float, list[Result]] = {}
    for member in members:
        by_length.setdefault(float(member.values["peridynamics.internal_length"]), []).append(member)
    ratios, moved = {}, {}
    for length, group in sorted(by_length.items()):
        label = f"$l$ = {length:g} in = {length / h:g} $\\Delta$"
        x = np.array([_thickness(member) for member in group])
        u = np.array([_at_x0(member) for member in group])
        ratios[label] = x, np.array([_poissons_ratio(row) for row in u])
        moved[label] = x, u
    draw.poissons_ratios(figures / "paper_b2.png", ratios)
    title = "Plate of appendix B: displacements at (2.5, 1, 0) in against thickness (Fig. B3)"
    draw.displacements_at_x0(figures / "paper_b3.png", title, "thickness (in)", moved, elements)
    short, long = sorted(by_length)[:2]
    table = {(length, round(_thickness(m) / h)): _at_x0(m) for length in by_length for m in by_length[length]}
    thick = max(cells for length, cells in table if length == long)
    exact = np.array([STRAIN * X0, -0.25 * STRAIN * Y0])
    thin_u, thick_u = table[short, 1] / exact, table[short, thick] / exact
    return {
        "nu_thin": _poissons_ratio(table[short, 1]),
        "nu_thick": _poissons_ratio(table[short, thick]),
        "nu_thin_long": _poissons_ratio(table[long, 1]),
        "nu_thick_long": _poissons_ratio(table[long, thick]),
        "thick_cells": thick,
        "long_ratio": long / h,
        "ux_thin": thin_u[0],
        "ux_thick": thick_u[0],
        "uy_thin": thin_u[1],
        "uy_thick": thick_u[1],
    }


def _cutoffs(found: Found, figures: Path, full: bool) -> dict[str, Any]:
    """Fig. B4."""
    h = 0.08 if full else 0.5
    members = found["b4_cutoff"]
    x = np.array([float(member.values["peridynamics.cutoff_radius"]) for member in members])
    u = np.array([_at_x0(member) for member in members])
    title = "Plate of appendix B, one cell thick: displacements at (2.5, 1, 0) in against the cutoff radius (Fig. B4)"
    curves = {f"peridynamics, $l$ = {h:g} in": (x, u)}
    draw.displacements_at_x0(
        figures / "paper_b4.png", title, "cutoff radius $r_c$ (in)", curves, _at_x0(found["b_fe"][0]), 2.5 * h
    )
    last = u[np.argmax(x), 0]
    chosen = int(np.argmin(np.abs(x - 2.5 * h)))
    return {
        "cutoff_change": 100.0 * (u[chosen, 0] / last - 1.0),
        "cutoff_first": 100.0 * (u[np.argmin(x), 0] / last - 1.0),
        "cutoff_last": x.max() / h,
    }


def _internal_lengths(found: Found, figures: Path, full: bool) -> dict[str, Any]:
    """Fig. B5."""
    h = 0.08 if full else 0.5
    cells = 10 if full else 2
    members = found["b5_internal_length"] + [m for m in found["b2_thickness"] if round(_thickness(m) / h) == cells]
    members.sort(key=lambda member: float(member.values["peridynamics.internal_length"]))
    x = np.array([float(member.values["peridynamics.internal_length"]) for member in members])
    u = np.array([_at_x0(member) for member in members])
    title = (
        f"Plate of appendix B, {cells} cells thick: displacements at (2.5, 1, 0) in against internal length (Fig. B5)"
    )
    elements = _at_x0(found["b_fe"][0])
    draw.displacements_at_x0(
        figures / "paper_b5.png", title, "internal length $l$ (in)", {"peridynamics": (x, u)}, elements, h
    )
    told = ", ".join(f"{row[0] / elements[0]:.3f} ({length / h:g} Delta)" for length, row in zip(x, u, strict=True))
    return {"length_table": told}


STEPS: tuple[tuple[tuple[str, ...], Callable[[Found, Path, bool], dict[str, Any]]], ...] = (
    (("bar_fe", "bar_pd", "bar_coupled"), _bar),
    (("plate_fe", "plate_pd", "plate_coupled"), _plate),
    (("b2_thickness", "b_fe"), _thicknesses),
    (("b4_cutoff", "b_fe"), _cutoffs),
    (("b5_internal_length", "b2_thickness", "b_fe"), _internal_lengths),
)
