"""A deck before it is run, in three dimensions: regions, supports, springs, ties, loads, cracks and ranks."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi.results.camera import BELOW, look
from pdfem_mpi.results.pictures import load_pyvista, outside, shot
from pdfem_mpi.system.files import replacing

SIZE = (1200, 900)
#: Of regions and ranks, light for faces and dark for letters on white; and of what acts.
REGIONS = (
    ("#a6cee3", "#1f78b4"), ("#f6c5af", "#b3541e"), ("#b9e3c6", "#2b8a57"), ("#f3e6a1", "#94801a"),
    ("#d9c3e5", "#7b4fa3"), ("#cfcfcf", "#555555"),
)  # fmt: skip
MARKS = {"supports": "#0072b2", "springs": "#009e73", "ties": "#cc79a7"}
LOADS, CRACKS = "#d55e00", "#000000"
#: Where the legend begins, from the lower left corner, and the height of a line, all over the picture's sides; how many
#: lines there are, and letters that have room beside.
LEGEND, MOST_LABELS, LETTERS = (0.63, 0.02, 0.03), 24, 40
#: Longest arrow over the body's size, and most places of one kind that are drawn.
LONGEST, MOST = 0.15, 1500


@dataclass(frozen=True)
class Sketch:
    """What is drawn, in the deck's units.

    Attributes
    ----------
    corners : float64, shape (n_cells, 8, 3)
    region : int64, shape (n_cells,)
    names : tuple of str
        Of the regions.
    marks : dict of float64, shape (n, 3)
        Places that are held, by ``supports``, ``springs`` and ``ties``.
    places, forces : float64, shape (n, 3)
        Of the loads.
    cracks : tuple of float64, shape (n, 3)
        Corners of each.
    rank : int32, shape (n_cells,), or None
        Which rank of a run has which cell.
    """

    corners: np.ndarray
    region: np.ndarray
    names: tuple[str, ...]
    marks: dict[str, np.ndarray]
    places: np.ndarray
    forces: np.ndarray
    cracks: tuple[np.ndarray, ...]
    rank: np.ndarray | None = None


def draw_sketch(path: Path, sketch: Sketch, title: str = "") -> None:
    """Draw it as a PNG, beside it the ranks where they are known.

    Raises
    ------
    whole_body.NoPicture
        Nothing to draw with.
    """
    pyvista = load_pyvista()
    panels = 1 if sketch.rank is None else 2
    with replacing(path) as temporary:
        plotter = pyvista.Plotter(off_screen=True, shape=(1, panels), window_size=(panels * SIZE[0], SIZE[1]))
        plotter.subplot(0, 0)
        labels = _add_cells(pyvista, plotter, sketch, sketch.region, sketch.names, 0.45)
        labels += _add_marks(pyvista, plotter, sketch)
        _finish(plotter, sketch, title, labels)
        if sketch.rank is not None:
            plotter.subplot(0, 1)
            names = tuple(f"rank {k}" for k in range(int(sketch.rank.max()) + 1))
            labels = _add_cells(pyvista, plotter, sketch, sketch.rank, names, 1.0)
            _finish(plotter, sketch, f"{len(names)} ranks", labels[: len(REGIONS)] if len(names) > 12 else labels)
        shot(plotter, temporary)
        plotter.close()


def _add_cells(pyvista: Any, plotter: Any, sketch: Sketch, kind: np.ndarray, names: tuple[str, ...], opacity: float):
    """Add the cells in the colours of their kinds; entries of the legend."""
    labels = []
    for number, name in enumerate(names):
        chosen = kind == number
        if not chosen.any():
            continue
        colour, dark = REGIONS[number % len(REGIONS)]
        surface = outside(pyvista, sketch.corners[chosen], np.zeros(np.count_nonzero(chosen)))
        edges = len(sketch.corners) < 20_000
        plotter.add_mesh(
            surface, color=colour, opacity=opacity, show_edges=edges, edge_color="#909090", line_width=0.5, ambient=0.8,
            diffuse=0.25,
        )  # fmt: skip
        labels.append([name, dark])
    return labels


def _add_marks(pyvista: Any, plotter: Any, sketch: Sketch) -> list[list[str]]:
    """Add what holds and loads the body, and its cracks; entries of the legend."""
    labels = []
    for name, colour in MARKS.items():
        x = _thinned(sketch.marks.get(name, np.empty((0, 3))))
        if len(x):
            plotter.add_points(x, color=colour, point_size=9, render_points_as_spheres=True)
            labels.append([name, colour])
    rows = np.flatnonzero(sketch.forces.any(axis=1))
    rows = _thinned(rows)
    if len(rows):
        size = np.ptp(sketch.corners.reshape(-1, 3), axis=0).max()
        arrows = sketch.forces[rows] * (LONGEST * size / np.linalg.norm(sketch.forces[rows], axis=1).max())
        plotter.add_arrows(sketch.places[rows], arrows, mag=1.0, color=LOADS)
        labels.append(["loads", LOADS])
    for corners in sketch.cracks:
        face = pyvista.PolyData(corners, faces=np.concatenate([[len(corners)], np.arange(len(corners))]))
        within = face.triangulate().clip_box(_bounds(sketch, 0.01), invert=False)  # as far as the body reaches
        if within.n_cells:
            plotter.add_mesh(within, color=CRACKS, opacity=0.7)
    return labels + ([["cracks", CRACKS]] if sketch.cracks else [])


def _thinned(rows: np.ndarray) -> np.ndarray:
    """Every n-th row, so that there are not more than `MOST`."""
    return rows[:: max(1, -(-len(rows) // MOST))]


def _finish(plotter: Any, sketch: Sketch, title: str, labels: list[list[str]]) -> None:
    plotter.set_background("white")
    plotter.add_text(title[:90], position="upper_left", font_size=10, color="black")
    labels = labels[:MOST_LABELS]
    for line, (name, colour) in enumerate(reversed(labels)):
        short = name if len(name) <= LETTERS else f"{name[: LETTERS - 3]}..."
        place = LEGEND[0], LEGEND[1] + LEGEND[2] * line
        plotter.add_text(short, position=place, viewport=True, font_size=9, color=colour)
    plotter.add_axes(color="black")
    room = LONGEST if sketch.forces.any() else 0.0  # for arrows
    look(plotter, "iso", _bounds(sketch, room), max(BELOW, 2.0 * LEGEND[1] + LEGEND[2] * len(labels)))


def _bounds(sketch: Sketch, room: float) -> np.ndarray:
    """Ends of the box around the body along x, y and z, wider by a part of its size; float64, shape (6,)."""
    flat = sketch.corners.reshape(-1, 3)
    low, high = flat.min(axis=0), flat.max(axis=0)
    room *= (high - low).max()
    return np.column_stack([low - room, high + room]).reshape(-1)
