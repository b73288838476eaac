"""The figures of docs/paper.md, one function each; colours and markers tell curves apart in grey too."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.collections import PolyCollection
from matplotlib.figure import Figure

from pdfem_mpi import Simulation, read_deck
from tools.studies.series import JOBS
from tools.studies.style import CURVES, STYLE

DPI, LAYOUT = 110, "constrained"
CUTOFF = 2.5
NAMES = {"finite elements": CURVES[0], "peridynamics": CURVES[1], "coupled": CURVES[2]}
REGIONS = {"finite elements": "#cfe3f2", "overlap": "#7fd0b5", "peridynamics": "#f7d9c4", "no-failure band": "#f3e6a8"}


class Picture:
    """A figure with panels side by side that is saved when the block ends."""

    def __init__(
        self, path: Path, title: str, columns: int = 2, size=(9.0, 3.9), rows: int = 1, cut: bool = False, **options
    ):
        self.cut = {"bbox_inches": "tight", "pad_inches": 0.1} if cut else {}  # equal axes leave room, and draws twice
        self.path, self.context = path, matplotlib.rc_context(STYLE | {"font.size": 10, "axes.titlesize": 10.5})
        self.context.__enter__()
        self.figure = Figure(figsize=size, dpi=DPI, layout=LAYOUT)
        self.panels = self.figure.subplots(rows, columns, squeeze=False, **options).reshape(-1)
        self.figure.suptitle(title, fontsize=11.5)

    def __enter__(self):
        return self

    def __exit__(self, *problem):
        try:
            if problem[0] is None:
                self.path.parent.mkdir(parents=True, exist_ok=True)
                self.figure.savefig(self.path, format="png", **self.cut)
        finally:
            self.context.__exit__(None, None, None)


def curve(panel, x, y, number, label, line="-", marker=True, **options):
    """One curve in the colour and with the marker of its number."""
    colour, shape = CURVES[number % len(CURVES)]
    style = {"color": colour, "linestyle": line, "linewidth": 1.3, "label": label}
    if marker:
        style |= {"marker": shape, "markersize": 5}
    panel.plot(x, y, **(style | options))


def below(picture: Picture) -> None:
    """One legend for all panels, under them, where it covers no curve."""
    handles = picture.panels[0].get_legend_handles_labels()[0]
    picture.figure.legend(handles=handles, loc="outside lower center", ncols=5, frameon=False, fontsize=9)


def locality(path: Path, stored: Sequence[tuple[float, np.ndarray, np.ndarray]]) -> None:
    """Fig. 2: response per unit stretch against distance, of the program's bonds and by eq. 2.

    Parameters
    ----------
    stored : list of (internal length in cell edges, distances, responses), in cell edges and k / edge^4
    """
    with Picture(path, "Locality of the response (Fig. 2, eq. 2)") as picture:
        left, right = picture.panels
        for number, (length, r, response) in enumerate(stored):
            x = np.linspace(0.0, 5.2, 300)
            y = 9.0 / (math.pi * length**4) * np.exp(-((x / length) ** 2))
            colour, shape = CURVES[number]
            for panel, scale in ((left, 1.0), (right, y[0])):
                panel.plot(x, y / scale, color=colour, linewidth=1.3)
                every = max(1, len(r) // 18)
                panel.plot(
                    r[::every], response[::every] / scale, linestyle="none", color=colour, marker=shape, markersize=4.5
                )
            left.plot([], [], color=colour, marker=shape, label=f"$l$ = {length:g} $\\Delta$")
        left.set_ylabel("response per unit stretch $c\\,e^{-(r/l)^2}$  ($k/\\Delta^4$)")
        left.set_yscale("log")
        left.set_ylim(1e-3, 100)
        right.set_ylabel("the same, relative to distance 0")
        for panel in picture.panels:
            panel.set_xlabel("distance of two points $r/\\Delta$")
        left.set_title("stiffness concentrates as $l$ falls")
        right.set_title("lines: eq. 2; markers: bonds of the program ($r \\leq 2.5\\,l$)")
        left.legend(fontsize=9)


def bond_law(path: Path, stretch: np.ndarray, force: np.ndarray, limit: float) -> None:
    """Figs 4 and 5: one bond of the program pulled beyond the critical stretch; the response under constant stretch."""
    with Picture(path, "Response of one bond (Figs 4 and 5)") as picture:
        left, right = picture.panels
        broken = stretch > limit
        corners = [0.0, 100 * limit, 100 * limit, 100 * stretch[-1]]
        left.plot(corners, [0.0, 1.0, 0.0, 0.0], color="black", linewidth=1.2, label="eqs 2, 4")
        left.plot(
            100 * stretch[~broken],
            force[~broken],
            linestyle="none",
            marker="o",
            color=CURVES[1][0],
            markersize=4,
            label="bond of the program",
        )
        left.annotate("$s_0$", (100 * limit, 0.5), xytext=(6, 0), textcoords="offset points", fontsize=12)
        left.set_xlabel("stretch $s$ (%)")
        left.set_ylabel("force over its largest value")
        left.set_title("Fig. 4: linear to $s_0$ = .0025, then gone")
        left.legend(fontsize=9)
        r = np.linspace(0.0, 3.0, 300)
        present = np.where(r <= CUTOFF, 9.0 / math.pi * np.exp(-(r**2)), 0.0)
        constant = np.where(r <= CUTOFF, 18.0 / (math.pi * CUTOFF**4), 0.0)
        right.plot(r, present, color=CURVES[1][0], label="here: $9k/(\\pi l^4)\\,e^{-(r/l)^2}$")
        right.plot(
            r, constant, color=CURVES[0][0], linestyle="--", label="constant: $18k/(\\pi r_c^4)$ (Silling, Askari)"
        )
        right.set_xlabel("distance of two points $r/l$")
        right.set_ylabel("response per unit stretch ($k/l^4$)")
        right.set_title("Fig. 5: constant stretch, same bulk modulus")
        right.legend(fontsize=9)


def _cells(panel, deck: str, overrides: Sequence[str], axes=(0, 1), linewidth=0.3) -> None:
    """The cells of a deck's mesh on one side of it, filled by what describes them."""
    scene = read_deck(JOBS / deck, overrides)
    cells = Simulation(scene).cells
    across = 3 - sum(axes)
    top = cells.corners[:, :, across].max()
    front = np.flatnonzero(cells.centroids[:, across] > top - 0.75 * scene.mesh.spacing)
    corners = cells.corners[front]
    upper = corners[:, :, across] > corners[:, :, across].mean(axis=1, keepdims=True)
    faces = corners[upper].reshape(-1, 4, 3)[:, :, axes]
    middle = faces.mean(axis=1, keepdims=True)
    angle = np.arctan2(*(faces - middle).transpose(2, 0, 1)[::-1])
    faces = np.take_along_axis(faces, np.argsort(angle, axis=1)[:, :, None], axis=1)
    bands = np.char.startswith(cells.region, "band") & (cells.model != "overlap")
    names = np.where(bands, "no-failure band", cells.model)
    colours = [REGIONS[name] for name in names[front]]
    panel.add_collection(PolyCollection(faces, facecolors=colours, edgecolors="#666666", linewidths=linewidth))
    for name in dict.fromkeys(names[front]):
        panel.plot([], [], linestyle="none", marker="s", markersize=9, color=REGIONS[name], label=name)
    panel.set_aspect("equal")
    panel.grid(False)
    panel.set_xlabel(f"${'xyz'[axes[0]]}$ (in)")
    panel.set_ylabel(f"${'xyz'[axes[1]]}$ (in)")


def bar_mesh(path: Path, overrides: Sequence[str]) -> None:
    """Fig. 11: the coupled bar's cells and loads."""
    with Picture(path, "Cells and loads of the coupled bar (Fig. 11)", 1, (9.0, 3.6), rows=2, cut=True) as picture:
        whole, part = picture.panels
        for panel in picture.panels:
            _cells(panel, "bar_tension.toml", overrides, linewidth=0.25)
        whole.set_xlim(-6.0, 6.0)
        whole.set_ylim(-0.5, 1.1)
        whole.set_yticks([-0.2, 0.2])
        for x, sign, text in ((-5.0, -1, "traction\n1600 lb"), (5.0, 1, "body force\n1600 lb")):
            whole.annotate(
                "", (x + 0.55 * sign, 0), (x, 0), arrowprops={"arrowstyle": "-|>", "color": "black", "linewidth": 1.5}
            )
            whole.annotate(text, (x + 0.3 * sign, 0.3), ha="center", va="bottom", fontsize=8)
        part.set_xlim(-1.2, 1.2)
        part.set_ylim(-0.22, 0.22)
        part.set_title("its middle; the overlap is one layer of cells")
        whole.legend(loc="upper center", ncols=3, fontsize=9, frameon=False)


def bar_displacements(path: Path, lines: Sequence[tuple[str, int, str, np.ndarray, np.ndarray]], strain: float) -> None:
    """Fig. 12: u_x along the bar of three models over the exact line, and the differences from it.

    Parameters
    ----------
    lines : list of (label, number of the curve, line style, x, u)
    """
    title = "Bar under 1600 lb: horizontal displacement along its axis (Fig. 12)"
    with Picture(path, title, size=(9.6, 4.0)) as picture:
        left, right = picture.panels
        x = lines[0][3]
        left.plot(x, 1e3 * strain * x, color="black", linewidth=1.0, label="exact, $\\sigma x/E$", zorder=5)
        right.axhline(0.0, color="black", linewidth=1.0)
        for label, number, style, at, u in lines:
            every = max(1, len(at) // 20)
            curve(left, at, 1e3 * u, number, label, style, markevery=every)
            curve(right, at, 1e3 * (u - strain * at), number, label, style, markevery=every)
        left.set_ylabel("$u_x$ ($10^{-3}$ in)")
        right.set_ylabel("$u_x - \\sigma x/E$ ($10^{-3}$ in)")
        for panel in picture.panels:
            panel.set_xlabel("$x$ (in)")
            panel.axvline(0.0, color="#555555", linestyle=":", linewidth=1.0)
        left.annotate("interface", (0.0, left.get_ylim()[0]), xytext=(3, 4), textcoords="offset points", fontsize=8)
        below(picture)


def plate_mesh(path: Path, overrides: Sequence[str]) -> None:
    """Figs 13 and 14: dimensions, regions and cells of the plate."""
    title = "Regions and cells of the plate with a cutout (Figs 13 and 14)"
    with Picture(path, title, 2, (10.0, 3.9), cut=True, width_ratios=(2.1, 1.0)) as picture:
        whole, part = picture.panels
        _cells(whole, "plate_coupled.toml", overrides, linewidth=0.12)
        _cells(part, "plate_coupled.toml", overrides, linewidth=0.4)
        whole.set_xlim(-4.6, 4.6)
        whole.set_ylim(-1.6, 1.6)
        part.set_xlim(-0.9, 0.9)
        part.set_ylim(-0.9, 0.9)
        part.set_title("around the cutout")
        whole.set_title("region 1: elements; 2: bands; 3: peridynamics")
        whole.legend(loc="upper center", ncols=4, fontsize=9, bbox_to_anchor=(0.5, -0.28), frameon=False)


def plate_lines(path: Path, lines: Sequence[tuple[str, int, str, dict]]) -> None:
    """Fig. 15: both components along the bottom line of the plate.

    Parameters
    ----------
    lines : list of (label, number of the curve, line style, columns of the line)
    """
    title = "Plate under 6000 lb, no failure: displacements along its bottom line y = -1.5 in (Fig. 15)"
    with Picture(path, title, size=(10.0, 4.0)) as picture:
        for panel, component in zip(picture.panels, ("u_x", "u_y"), strict=True):
            for label, number, style, line in lines:
                curve(panel, line["x"], 1e3 * line[component], number, label, style, markevery=15, linewidth=1.2)
            panel.set_xlabel("$x$ (in)")
            panel.set_ylabel(f"${component}$ ($10^{{-3}}$ in)")
            for x in (-2.0, 2.0):
                panel.axvline(x, color="#555555", linestyle=":", linewidth=1.0)
        below(picture)
        picture.panels[0].set_title("horizontal")
        picture.panels[1].set_title("vertical (dotted lines: interfaces of the coupled plate)")


def surface_correction(
    path: Path, left_over: dict[int, float], depth: np.ndarray, factors: np.ndarray, cells: int
) -> None:
    """Appendix A: the largest difference that is left, sweep by sweep, and the factors beneath a face.

    Parameters
    ----------
    left_over : dict from sweeps to the largest ``|G / g_inf - 1|``
    depth : distances of the layers from the face, in cells
    factors : shape (n, 2), ``g_c`` across and along the face after 20 sweeps
    cells : edge of the block
    """
    with Picture(path, f"Surface correction of appendix A: a block of {cells} x {cells} x {cells} cells") as picture:
        left, right = picture.panels
        curve(left, list(left_over), [100 * value for value in left_over.values()], 1, "")
        left.axvline(20, color="#555555", linestyle="--", linewidth=1.0)
        left.annotate("paper: 20 ", (20, 30), ha="right", fontsize=9)
        left.set_yscale("log")
        left.set_xlabel("sweeps of the iteration (A8)-(A11)")
        left.set_ylabel("largest $|G/g_\\infty - 1|$ left (%)")
        left.set_title("worst of all points and directions")
        for column, name in enumerate(("across the face", "along the face")):
            curve(right, depth, factors[:, column], column, f"$g_c$ {name}")
        right.axhline(1.0, color="black", linewidth=0.8)
        right.set_xlabel("depth of the point beneath the middle of a face ($\\Delta$)")
        right.set_ylabel("correction factor $g_c$ (A11)")
        right.set_title(f"deep inside $g_c$ = {factors[-1, 0]:.3f}, not 1")
        right.legend(fontsize=9)


def poissons_ratios(path: Path, curves: dict[str, tuple[np.ndarray, np.ndarray]]) -> None:
    """Fig. B2: Poisson's ratio against thickness, a curve for each internal length."""
    with Picture(path, "Plate of appendix B: Poisson's ratio against thickness (Fig. B2)", 1, (7.0, 4.2)) as picture:
        (panel,) = picture.panels
        for number, (label, (x, y)) in enumerate(curves.items()):
            curve(panel, x, y, number, label)
        for value, text in ((1 / 3, "1/3, two dimensions"), (1 / 4, "1/4, three dimensions")):
            panel.axhline(value, color="black", linewidth=1.0, linestyle="--")
            panel.annotate(
                text,
                (0.99, value),
                xycoords=("axes fraction", "data"),
                xytext=(0, -3),
                textcoords="offset points",
                ha="right",
                va="top",
                fontsize=9,
            )
        panel.set_ylim(0.225, 0.345)
        panel.set_xlabel("thickness (in)")
        panel.set_ylabel("$\\nu = -(u_y/y)/(u_x/x)$ at $x_0$ (B3)")
        panel.legend(fontsize=9, loc=(0.6, 0.5))


def displacements_at_x0(
    path: Path, title: str, along: str, curves: dict[str, tuple[np.ndarray, np.ndarray]], exact, paper=None
) -> None:
    """Figs B3 to B5: u_x and u_y at x0 against a key, with the finite elements' values.

    Parameters
    ----------
    curves : dict from label to (x, u of shape (n, 2))
    exact : (u_x, u_y) of finite elements and the closed form
    paper : float, optional
        A place on the axis that the paper recommends.
    """
    with Picture(path, title, size=(9.6, 3.9)) as picture:
        for component, panel in enumerate(picture.panels):
            value = 1e3 * exact[component]
            panel.axhline(value, color="black", linewidth=1.2, label="finite elements = closed form")
            for number, (label, (x, u)) in enumerate(curves.items(), start=1):
                curve(panel, x, 1e3 * u[:, component], number, label)
            panel.set_xlabel(along)
            panel.set_ylabel(f"$u_{'xy'[component]}$ at $x_0$ ($10^{{-3}}$ in)")
            if paper is not None:
                panel.axvline(paper, color="#555555", linestyle="--", linewidth=1.0, label="paper's choice")
        below(picture)
