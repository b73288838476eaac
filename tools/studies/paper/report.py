"""docs/paper.md: numbers from the finished runs and from small bodies, the figures, and the two tables."""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path

import numpy as np
import paper_figures as draw
from paper_cases import COARSE_CORNERS, ROOT, STRAIN, X0, Y0, Result, Series, results
from paper_rows import EQUATIONS, FIGURES
from verification.bodies import bond_list, build, make_scene
from verification.measure import (
    cracked_block,
    damage_by_layer,
    largest_eigenvalue,
    lattice_constants,
    lattice_of,
    release_rate_inside,
)
from verification.patch import BLOCKS, STRAINS, block, patch_test

from pdfem_mpi.kernels import surface_correction
from pdfem_mpi.model.model import point_rows
from pdfem_mpi.peridynamics import bonds as bonds_module
from pdfem_mpi.peridynamics.bonds import BULK_MODULUS

Found = dict[str, list[Result]]
KEPT = 0.971457  # of the fracture energy by r_c = 2.5 l
CRITICAL_STRETCH = 0.0025
BAR_STRAIN = 1.0e-3
READINGS = {"paper": "reading B", "paper_a": "reading A"}
SWEEPS = (1, 2, 3, 4, 5, 6, 8, 10, 11, 12, 15, 18, 21, 25, 31)  # a sweep tells what was left before it
FEW_SWEEPS = (1, 6, 11, 21)
PLATE_OVERRIDES = ["mesh.spacing=0.2", *(f"regions.{name}={corner}" for name, corner in COARSE_CORNERS.items())]
CAPTIONS = {
    "paper_02.png": "Fig. 2. Response per unit stretch against distance.",
    "paper_04_05.png": "Figs 4 and 5. One bond pulled beyond the critical stretch; response under constant stretch.",
    "paper_11.png": "Fig. 11. Cells of the bar; the load acts on the last layer of cells of both ends.",
    "paper_12.png": "Fig. 12. Bar: displacement, and what each model misses.",
    "paper_13_14.png": "Figs 13 and 14. Plate: regions and cells.",
    "paper_15.png": "Fig. 15. Plate without failure: both components along the bottom line.",
    "paper_a.png": "Appendix A. Convergence of the surface correction, and its factors beneath a face.",
    "paper_b2.png": "Fig. B2. Poisson's ratio against thickness.",
    "paper_b3.png": "Fig. B3. Displacements at x0 against thickness.",
    "paper_b4.png": "Fig. B4. Displacements at x0 against the cutoff radius, one cell thick.",
    "paper_b5.png": "Fig. B5. Displacements at x0 against the internal length.",
}


def unfinished(series: list[Series], runs: Path) -> list[str]:
    """Which series lack runs, one sentence each."""
    found = results(series, runs)
    missing = [f"series {item.name} has no finished run" for item in series if item.name not in found]
    missing += [
        f"series {item.name}: {len(found[item.name])} of {len(item.members()[1])} runs finished"
        for item in series
        if item.name in found and len(found[item.name]) < len(item.members()[1])
    ]
    return missing


def write_report(path: Path, figures: Path, series: list[Series], runs: Path, full: bool) -> None:
    """Measure, draw, and write the document; rows whose series have no run say so."""
    found = results(series, runs)
    numbers: dict[str, object] = {"failure": _failure()}
    for needs, make in STEPS:
        if all(name in found for name in needs):
            numbers |= make(found, figures, full)
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_text(_document(numbers, path, figures, full), encoding="utf-8")


# --- measuring and drawing -------------------------------------------------------------------------------


def _failure() -> str:
    if (ROOT / "docs" / "failure.md").exists():
        return "see failure: `docs/failure.md`"
    return "`jobs/plate_cutout.toml` runs it and draws its damage; nothing is compared with the paper here yet"


def _small_bodies(found: Found, figures: Path, full: bool) -> dict[str, object]:
    """What needs no run: single bonds, lattice constants, release rates, damage, eigenvalues, patch tests."""
    stored, error = [], 0.0
    for length in (0.5, 1.0, 1.5, 2.0):
        scene = make_scene((4, 4, 4), correction="none")
        peridynamics = scene.peridynamics.model_copy(update={"internal_length": length, "cutoff_radius": 2.5 * length})
        body = build(scene.model_copy(update={"peridynamics": peridynamics}), loaded=False)
        r, response = draw.stored_responses(bond_list(body), body.model.points.volume, length)
        exact = 9.0 / (math.pi * length**4) * np.exp(-((r / length) ** 2))
        error = max(error, float(np.abs(response / exact - 1.0).max()))
        shown = np.unique(r.round(6), return_index=True)[1]
        stored.append((length, r[shown], response[shown]))
    draw.locality(figures / "paper_02.png", stored)

    body = build(make_scene((1, 1, 1), correction="none", kinematics="finite"), loaded=False)
    stretch = np.linspace(0.0, 1.25 * CRITICAL_STRETCH, 26)
    force = draw.single_bond(body, bond_list(body), stretch)
    slope = force[-1] / stretch[-1]
    draw.bond_law(figures / "paper_04_05.png", stretch, force / (slope * CRITICAL_STRETCH), CRITICAL_STRETCH)

    constant = 27.0 * math.sqrt(math.pi) / 16.0
    release = [release_rate_inside(length) / (constant * KEPT * BULK_MODULUS) for length in (1.0, 1.5)]
    n = 12 if full else 8  # appendix A's factors are those of an infinite body from about 12 cells on
    lattice = {
        kind: lattice_constants(build(make_scene((n, n, n), correction=kind), loaded=False))
        for kind in ("none", "appendix_a")
    }
    layers = [float(layer.mean()) for layer in damage_by_layer(cracked_block())]
    block_size = (8, 8, 8) if full else (4, 4, 4)
    corrected, plain = (build(make_scene(block_size, correction=kind)) for kind in ("appendix_a", "none"))
    patch = {}
    for name in BLOCKS if full else (next(iter(BLOCKS)), *(name for name in BLOCKS if name.startswith("coupled"))):
        body = block(name)
        patch[name] = [patch_test(body, strain) for strain in STRAINS]
    worst = {name: max(error.displacement for error in errors) for name, errors in patch.items()}
    names = list(BLOCKS)
    return {
        "locality_error": error,
        "bond_law_error": float(np.abs(force - slope * stretch).max() / force.max()),
        "fracture_constant": constant,
        "fracture_cutoff": constant * KEPT,
        "release_one": release[0],
        "release_more": release[1],
        "lattice_none": lattice["none"][0],
        "lattice_a": lattice["appendix_a"][0],
        "lattice_nu": lattice["appendix_a"][1],
        "lattice_short": ", ".join(
            "E/E0 = {:.2f}, nu = {:.3f} at l = {:g} Delta".format(*lattice_of(length), length)
            for length in (0.75, 0.5, 0.4, 0.3)
        ),
        "damage_first": layers[0],
        "damage_second": layers[1],
        "damage_third": layers[2],
        "eigenvalue": largest_eigenvalue(corrected),
        "eigenvalue_printed": largest_eigenvalue(corrected, plain.model.mass),
        "patch_fe": max(error.force for error in patch[names[0]]),
        "patch_a": worst["coupled, reading A"],
        "patch_b": worst["coupled, reading B"],
        "patch": patch,
    }


def _appendix_a(found: Found, figures: Path, full: bool) -> dict[str, object]:
    """The surface correction of a block, sweep by sweep."""
    n = 12 if full else 6
    body = build(make_scene((n, n, n), correction="none"), loaded=False)
    usual = surface_correction.SWEEPS
    left_over, vectors = {}, {}
    try:
        for sweeps in sorted({*(SWEEPS if full else FEW_SWEEPS), usual}):
            surface_correction.SWEEPS = sweeps
            materials = body.discretization.materials
            flat, remaining = bonds_module._appendix_a(body.model.comm, body.model.points, materials, body.model.bonds)
            left_over[sweeps - 1] = remaining
            vectors[sweeps] = point_rows(flat)
    finally:
        surface_correction.SWEEPS = usual
    x = point_rows(body.model.points.x)
    depth = x + 0.5 * n
    axis = (np.abs(x[:, 1:] + 0.2113) < 0.01).all(axis=1) & (x[:, 0] < 0.0)
    order = np.flatnonzero(axis)[np.argsort(depth[axis, 0])]

    def at(outer):
        place = [depth.min() if out else x[x < 0].max() + 0.5 * n for out in outer]
        return int(np.argmin(((depth - place) ** 2).sum(axis=1)))

    draw.surface_correction(
        figures / "paper_a.png",
        {sweeps: value for sweeps, value in left_over.items() if sweeps + 1 in SWEEPS},
        depth[order, 0],
        vectors[usual][order][:, :2],
        n,
    )
    face, edge, corner, inside = ((True, False, False), (True, True, False), (True,) * 3, (False,) * 3)
    before = 1.0 / vectors[1]
    return {
        "g_face": before[at(face), 0],
        "g_face_along": before[at(face), 1],
        "g_edge": before[at(edge), 0],
        "g_corner": before[at(corner), 0],
        "g_inside": before[at(inside), 0],
        "g_c_inside": vectors[usual][at(inside), 0],
        "g_c_face": vectors[usual][at(face), 0],
        "g_c_along": vectors[usual][at(face), 1],
        "g_c_corner": vectors[usual][at(corner), 0],
        "g_infinite": surface_correction.INFINITE_RESPONSE,
        "left_0": left_over[0],
        "left_5": left_over[5],
        "left_10": left_over[10],
        "left_20": left_over[20],
    }


def _bar(found: Found, figures: Path, full: bool) -> dict[str, object]:
    fe, pd = found["bar_fe"][0], found["bar_pd"][0]
    coupled = {result.values["coupling.kind"]: result for result in found["bar_coupled"]}
    lines = [("finite elements", 0, "-", fe), ("peridynamics", 1, "-", pd)]
    styles = {"paper": "-", "paper_a": "--"}
    for number, (kind, result) in enumerate(coupled.items(), start=2):
        lines.append((f"coupled, {READINGS[kind]}", number, styles[kind], result))
    drawn = []
    for label, number, style, result in lines:
        line = result.line("axis")
        u = line["u_x"] - 0.5 * (line["u_x"][0] + line["u_x"][-1])  # both ends move by opposite amounts
        drawn.append((label, number, style, line["x"], u))
    draw.bar_displacements(figures / "paper_12.png", drawn, BAR_STRAIN)
    spacing = [] if full else ["mesh.spacing=0.2"]
    draw.bar_mesh(figures / "paper_11.png", spacing)
    sides = np.array([10.0, 0.4, 0.4]) / (0.05 if full else 0.2)
    return {
        "bar_points": pd.summary["counts"]["points"],
        "bar_bonds": pd.summary["counts"]["undirected_bonds"],
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


def _plate(found: Found, figures: Path, full: bool) -> dict[str, object]:
    fe, pd = found["plate_fe"][0], found["plate_pd"][0]
    coupled = {result.values["coupling.kind"]: result for result in found["plate_coupled"]}
    curves = [("finite elements", 0, "-", fe), ("peridynamics", 1, "-", pd)]
    curves += [("coupled, reading B", 2, "-", coupled["paper"]), ("coupled, reading A", 3, "--", coupled["paper_a"])]
    lines = [(label, number, style, result.line("bottom")) for label, number, style, result in curves]
    draw.plate_lines(figures / "paper_15.png", lines)
    draw.plate_mesh(figures / "paper_13_14.png", [] if full else PLATE_OVERRIDES)
    reference = lines[0][3]

    def gap(number, component):
        size = np.abs(reference[component]).max()
        return 100.0 * float(np.abs(lines[number][3][component] - reference[component]).max()) / size

    tops = [result.numbers["top_of_hole_y"] for result in (coupled["paper"], pd)]
    quality = pd.summary["mesh"]
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


def _thicknesses(found: Found, figures: Path, full: bool) -> dict[str, object]:
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


def _cutoffs(found: Found, figures: Path, full: bool) -> dict[str, object]:
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


def _internal_lengths(found: Found, figures: Path, full: bool) -> dict[str, object]:
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


STEPS: tuple[tuple[tuple[str, ...], Callable[[Found, Path, bool], dict[str, object]]], ...] = (
    ((), _small_bodies),
    ((), _appendix_a),
    (("bar_fe", "bar_pd", "bar_coupled"), _bar),
    (("plate_fe", "plate_pd", "plate_coupled"), _plate),
    (("b2_thickness", "b_fe"), _thicknesses),
    (("b4_cutoff", "b_fe"), _cutoffs),
    (("b5_internal_length", "b2_thickness", "b_fe"), _internal_lengths),
)


# --- writing ---------------------------------------------------------------------------------------------


def _filled(text: str, numbers: dict[str, object]) -> str:
    try:
        return text.format_map(numbers)
    except KeyError:
        return "not run"


def _row(cells: list[str]) -> str:
    return "| " + " | ".join(cell.replace("|", "\\|") or "-" for cell in cells) + " |"


def _tests(names: tuple[str, ...]) -> str:
    return "; ".join(f"`{name.replace('::', '` `')}`" for name in names) or "-"


def _patch_table(numbers: dict[str, object]) -> list[str]:
    lines = [_row(["block", *STRAINS, "forces, worst"]), "|---" * (len(STRAINS) + 2) + "|"]
    for name, errors in numbers["patch"].items():
        forces = max(error.force for error in errors)
        moved = (f"{error.displacement:.3f}" if error.displacement >= 1e-3 else "0.000" for error in errors)
        lines.append(_row([name, *moved, f"{forces:.1e}"]))
    return lines


def _document(numbers: dict[str, object], path: Path, figures: Path, full: bool) -> str:
    size = "Full size." if full else "Coarse set: numbers are those of coarse cells, see `tools/figures --full`."
    relative = figures.relative_to(path.parent)
    lines = [
        "# The paper, claim by claim",
        "",
        "Kilic and Madenci (2010), *Coupling of peridynamic theory and the finite element method*, J. Mech. Mater.",
        "Struct. 5(5). Written by `tools/figures --full`, which runs the decks of `jobs/`, draws the figures below and",
        f"fills in the numbers. {size} Linear kinematics, so that closed forms are exact; finite kinematics change the",
        "bar's elongation by -0.047 %. Tests are under `tests/`, code under `pdfem_mpi/`. The paper's own figures are",
        "not copied here.",
        "",
        "## Figures",
        "",
        _row(["figure", "claim", "paper", "here", "exact", "remark", "tests"]),
        "|---" * 7 + "|",
    ]
    for row in FIGURES:
        texts = (_filled(text, numbers) for text in row[1:6])
        lines.append(_row([row.figure, *texts, _tests(row.tests)]))
    for name, caption in CAPTIONS.items():
        if (figures / name).exists():
            lines += ["", f"![{caption}]({relative}/{name})", "", f"*{caption}*"]
    lines += [
        "",
        "## Patch tests",
        "",
        "A uniform strain is prescribed on the nodes of a block's surface and on the points within a cutoff radius of",
        "it; the table shows how far a displacement inside moves from the uniform field, in cell edges per unit",
        "strain, and the largest force on a free unknown in the uniform field itself, over the largest of a held one.",
        "Rotations give no force in any of them.",
        "",
        *(_patch_table(numbers) if "patch" in numbers else []),
        "",
        "## Equations",
        "",
        _row(["equation", "what", "code", "tests", "how it is read, and what differs"]),
        "|---" * 5 + "|",
    ]
    for row in EQUATIONS:
        code = ", ".join(f"`{place}`" for place in row.code)
        lines.append(_row([row.equation, row.says, code, _tests(row.tests), _filled(row.remark, numbers)]))
    return "\n".join(lines) + "\n"
