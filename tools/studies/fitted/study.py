"""Figures of docs/fitted.md: factors, what the fit leaves, the coupled bar and the plate before and after.

Bodies of a few thousand points, and the plate with cells of 0.1 in: a minute on two cores, figures in
runs/fitted_figures/coarse. With ``--full`` the plate has the paper's cells, and figures are written to docs/figures.
The plate's stations are printed as they stand in docs/fitted.md.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np
from matplotlib import pyplot as plt

from pdfem_mpi import Simulation, read_deck
from tools.studies.fitted import plate
from tools.studies.members import run_series
from tools.studies.series import DOCS, JOBS, RUNS

CELLS = (12, 6, 6)
STRAIN = 1e-3  # of the bar: 10,000 psi over 10 million psi
BAR = (
    "mesh.spacing=0.1",
    "mesh.lower=[-2, -0.2, -0.2]",
    "mesh.upper=[2, 0.2, 0.2]",
    "probes.left_end.point=[-2, 0.0, 0.0]",
    "probes.right_end.point=[2, 0.0, 0.0]",
    'solver.kind="cg"',
    "solver.tolerance=1e-9",
)
STYLE = {"free": ("tab:blue", "free signs"), "bounded": ("tab:orange", "positive"), "none": ("0.6", "no correction")}


YOUNGS_MODULUS, EDGE = 1000.0, 1.0
BLOCK = {
    "mesh": {"kind": "box", "lower": [0, 0, 0], "upper": list(CELLS), "spacing": EDGE},
    "material": {"youngs_modulus": YOUNGS_MODULUS},
    "regions": [{"name": "bonds", "model": "peridynamics"}],
    "supports": [{"face": "x-", "x": 0.0}],
}
#: Poisson's ratio of the bonds is 1/4: both of Lame's moduli are the same.
LAME = YOUNGS_MODULUS / 2.5
STRAINS = [np.eye(3)[[a]].T * np.eye(3)[b] for a, b in ((0, 0), (1, 1), (2, 2), (1, 2), (2, 0), (0, 1))]
STRAINS = [0.5 * (strain + strain.T) for strain in STRAINS]


def body(correction, signs="free"):
    """A block of cubes."""
    settings = {"surface_correction": correction, "signs": signs, "kinematics": "linear"}
    return Simulation(read_deck(BLOCK | {"peridynamics": settings}))


def surface_areas(x):
    """Area vectors of the points, shape (n_points, 3): what a traction on a face does to displacements there.

    These are extrapolated to the face from the two layers of points of the cell beside it, so that a quarter of the
    face counts (1 + sqrt 3) / 2 times at each outer point, and (1 - sqrt 3) / 2 times at each inner one.
    """
    area = np.zeros_like(x)
    for share, sign in ((0.5 + 0.5 * np.sqrt(3.0), -1.0), (0.5 - 0.5 * np.sqrt(3.0), 1.0)):
        depth = (0.5 + sign * 0.5 / np.sqrt(3.0)) * EDGE
        low, high = np.abs(x - depth) < 1e-6, np.abs(x - CELLS + depth) < 1e-6
        area += 0.25 * EDGE**2 * share * (high.astype(float) - low)
    return area


def factors(bonds, base):
    """Factors over bonds without correction, shape (n,); bonds whose factor is 0 are not listed."""
    number = [found.points @ (8 * np.prod(CELLS), 1) for found in (bonds, base)]
    place, factor = np.searchsorted(number[1], number[0]), np.zeros(len(base.points))
    factor[place] = bonds.stiffness / base.stiffness[place]
    return factor


def draw_factors(path):
    """Histogram of the factors over all bonds of the block, for both signs."""
    base = body("none").bonds()
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for signs in ("free", "bounded"):
        factor = factors(body("fitted", signs).bonds(), base)
        colour, label = STYLE[signs]
        axes.hist(factor, np.linspace(-2.0, 14.0, 161), histtype="step", log=True, color=colour, label=label)
    axes.set_xlabel("strength of a bond, over that without correction")
    axes.set_ylabel("bonds")
    axes.set_title(f"{' x '.join(map(str, CELLS))} cells, {len(base.points):,} bonds", fontsize="medium")
    axes.legend(frameon=False)
    figure.savefig(path / "fitted_factors.svg", metadata={"Date": None})
    plt.close(figure)


def draw_residual(path):
    """Force that six uniform strains leave on each point, in the outermost layer, for several corrections."""
    figure, axes = plt.subplots(1, 3, figsize=(9.6, 2.5), layout="constrained", sharey=True)
    for axis, correction in zip(axes, ("appendix_a", "virial", "fitted"), strict=True):
        block = body(correction)
        x, miss, largest = block.points, np.zeros(len(block.points)), 0.0
        for strain in STRAINS:
            tractions = surface_areas(x) @ (LAME * np.trace(strain) * np.eye(3) + 2.0 * LAME * strain)
            block.displace(lambda place, strain=strain: place @ strain)
            miss = np.maximum(miss, np.abs(block.internal_forces().points - tractions).max(axis=1))
            largest = max(largest, np.abs(tractions).max())
        layer = x[:, 2] > x[:, 2].max() - 1e-6
        values = np.log10(np.maximum(miss[layer] / largest, 1e-12))
        shades = axis.scatter(x[layer, 0], x[layer, 1], c=values, vmin=-12, vmax=0, s=22, marker="s", rasterized=True)
        axis.set_title(correction.replace("_a", " A"), fontsize="medium")
        axis.set_aspect("equal")
        axis.set_xlabel("x / l")
    axes[0].set_ylabel("y / l")
    figure.colorbar(shades, ax=axes, label="log10(force left / largest traction)", shrink=0.9, aspect=12)
    figure.savefig(path / "fitted_residual.svg", metadata={"Date": None})
    plt.close(figure)


def draw_bar(path):
    """Axial displacement minus the exact one along the coupled bar, paper's method and exact coupling."""
    figure, axes = plt.subplots(figsize=(6.4, 3.6), layout="constrained")
    for name, label, colour in (
        ("bar_tension.toml", "appendix A, reading B", "tab:red"),
        ("bar_exact.toml", "fitted, exact coupling", "tab:blue"),
    ):
        bar = Simulation(read_deck(JOBS / name, BAR))
        bar.solve(1.0)
        fields = bar.fields()
        x, u = np.concatenate([bar.nodes, bar.points]), np.concatenate([fields.u_nodes, fields.u_points])
        place, section = np.unique(np.round(x[:, 0], 9), return_inverse=True)
        mean = np.bincount(section, u[:, 0]) / np.bincount(section)
        exact = STRAIN * place
        axes.plot(place, 100.0 * (mean - exact) / exact.max(), ".-", color=colour, label=label)
    axes.axvline(0.0, color="0.7", lw=0.8)
    axes.set_xlabel("x / in")
    axes.set_ylabel("error of u_x, % of the end's")
    axes.set_title("elements (left) coupled to peridynamics (right), 20 + 20 cells", fontsize="medium")
    axes.legend(frameon=False)
    figure.savefig(path / "fitted_bar.svg", metadata={"Date": None})
    plt.close(figure)


def make_plate(path, full, ranks):
    """Run what is left of the plate's decks, draw its figure, print its stations; the exit code."""
    series = plate.make_series(full)
    runs = RUNS / "fitted_figures" / ("full" if full else "coarse")
    for item in series:
        code = run_series(item, runs / item.name, ranks, dry_run=False)
        if code:
            return code
    lines = plate.read_lines(series, runs)
    plate.draw_plate(path / "fitted_plate.svg", lines, 0.05 if full else 0.1)
    print(plate.station_table(lines), end="")
    return 0


def main(words: list[str]) -> int:
    """Draw all figures into the folder."""
    parser = argparse.ArgumentParser(description=__doc__.partition("\n")[0])
    parser.add_argument("--full", action="store_true", help="the plate with the paper's cells")
    parser.add_argument("--ranks", type=int, default=2, help="ranks of the plate's runs")
    parser.add_argument("folder", nargs="?", type=Path, help="where figures go")
    arguments = parser.parse_args(words)
    path = arguments.folder or (DOCS / "figures" if arguments.full else RUNS / "fitted_figures" / "coarse")
    path.mkdir(parents=True, exist_ok=True)
    plt.rcParams["svg.hashsalt"] = "fitted"
    draw_factors(path)
    draw_residual(path)
    draw_bar(path)
    return make_plate(path, arguments.full, arguments.ranks)
