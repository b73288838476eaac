"""Pictures of a body in three dimensions, drawn off screen by VTK through pyvista (extra ``viz``)."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from PIL import Image

from pdfem_mpi.results.camera import look
from pdfem_mpi.results.whole_body import Body, NoPicture, nice_factor
from pdfem_mpi.system.files import replacing

SIZE, FILM_SIZE = (1200, 900), (800, 600)
#: As in the figures of two dimensions: damage beside a complete flat crack is 0.39.
DAMAGE_LIMITS, DAMAGE_COLOURS, OTHER_COLOURS = (0.0, 0.5), "inferno_r", "viridis"
DAMAGE_LABEL = "local damage (0.39: a crack passes by)"
FRAME_SECONDS = 0.25
#: The outside shows less than this share of the largest damage: the crack is inside, and the body is cut open.
HIDDEN = 0.6


@dataclass(frozen=True)
class View:
    """What of a run is drawn, and how.

    Attributes
    ----------
    view : "iso", "x", "y" or "z"
        From where; along an axis, from its upper end.
    field : str or None
        None: damage where there is some, else the size of the displacement.
    deformed : float or None
        By how much displacements are drawn larger; None: a round number that shows them.
    section : bool or None
        Cut open through the largest value; None: where the largest damage is not seen from outside.
    frame : int
        Negative ones count from the last.
    """

    view: str = "iso"
    field: str | None = None
    deformed: float | None = None
    section: bool | None = None
    frame: int = -1


@dataclass(frozen=True)
class Section:
    """A plane through the body; what lies on its upper side is left away."""

    axis: int
    place: float


def load_pyvista() -> Any:
    """pyvista, ready to draw without a screen.

    Raises
    ------
    NoPicture
        It is not installed, or cannot be loaded here.
    """
    try:
        import pyvista
    except ImportError as error:
        missing = getattr(error, "name", None) or ""
        if missing.partition(".")[0] in ("pyvista", "vtk", "vtkmodules"):
            raise NoPicture(
                "pictures in three dimensions need pyvista, which is not installed: pip install pyvista (the extra viz "
                "of this package). The figures in two dimensions do not."
            ) from None
        raise NoPicture(
            f"pyvista cannot be loaded ({error}). On Debian: apt install libgl1 libxrender1, or use vtk-osmesa."
        ) from None
    from vtkmodules.vtkCommonCore import vtkLogger, vtkObject

    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)  # that there is no screen is no news
    vtkObject.GlobalWarningDisplayOff()
    pyvista.OFF_SCREEN = True
    return pyvista


def draw_body(path: Path, body: Body, view: View, title: str = "", unit: str = "") -> str:
    """Draw one frame as a PNG, and say in a sentence what is seen.

    Raises
    ------
    NoPicture
        No such field or frame, or nothing to draw with.
    """
    pyvista = load_pyvista()
    view = _settled(body, view)
    section = _section(body, view)
    with replacing(path) as temporary:
        plotter = pyvista.Plotter(off_screen=True, window_size=SIZE)
        caption = _fill(pyvista, plotter, body, view, section, _limits(body, view, [view.frame]), title, unit)
        shot(plotter, temporary)
        plotter.close()
    return caption


def draw_film(
    path: Path, body: Body, view: View, title: str = "", unit: str = "", told: Callable[[int, int], None] | None = None
) -> None:
    """Draw all frames as an animated GIF; ``told`` hears how many are drawn, and of how many.

    Raises
    ------
    NoPicture
        Also of a run with one frame.
    """
    if body.n_frames < 2:
        raise NoPicture(
            f"{body.folder} has one frame, which is no film. Draw it without --movie, or run more steps "
            "(stepping.load_factors, or output.every for fewer rows between frames)."
        )
    pyvista = load_pyvista()
    last = _settled(body, view)
    section, limits = _section(body, last), _limits(body, last, range(body.n_frames))
    pictures = []
    for frame in range(body.n_frames):
        plotter = pyvista.Plotter(off_screen=True, window_size=FILM_SIZE)
        _fill(pyvista, plotter, body, replace(last, frame=frame), section, limits, title, unit)
        pictures.append(Image.fromarray(plotter.screenshot(None, return_img=True)).quantize(128))
        plotter.close()
        if told:
            told(frame + 1, body.n_frames)
    with replacing(path) as temporary:
        first, *others = pictures
        first.save(temporary, format="GIF", save_all=True, append_images=others, duration=1000 * FRAME_SECONDS, loop=0)


def _settled(body: Body, view: View) -> View:
    """The view with its frame, field and factor chosen."""
    if not -body.n_frames <= view.frame < body.n_frames:
        raise NoPicture(f"{body.folder} has no frame {view.frame}: they count from 0 to {body.n_frames - 1}.")
    frame = view.frame % body.n_frames
    name = view.field
    if name is None:
        broken = "damage" in body.names and np.nanmax(body.field("damage", frame), initial=0.0) > 0.0
        name = "damage" if broken else "displacement"
    body.field(name, frame)  # refuses what is not there
    factor = view.deformed
    if factor is None:
        factor = nice_factor(body, body.displacement(frame))
    return replace(view, frame=frame, field=name, deformed=factor)


def _section(body: Body, view: View) -> Section | None:
    """Where the body is cut open: through the largest value, across the longest direction in which it is large."""
    if view.section is False:
        return None
    values = np.nan_to_num(body.field(view.field, view.frame))
    if view.section is None and (view.field != "damage" or _is_seen(body, values)):
        return None
    centres = body.corners.mean(axis=1)
    large = values >= 0.5 * values.max(initial=0.0)
    spread = np.ptp(centres[large], axis=0)
    sides = "xyz".find(view.view)
    axis = sides if sides >= 0 else int(np.argmax(spread))
    peak = centres[large & (values >= 0.95 * values.max())]
    middle = peak[np.argmin(np.linalg.norm(peak - np.median(peak, axis=0), axis=1))]
    return Section(axis, float(middle[axis]))


def _is_seen(body: Body, values: np.ndarray) -> bool:
    """Whether a cell at the outside shows about as much as the largest value."""
    centres = body.corners.mean(axis=1)
    low, high = body.corners.reshape(-1, 3).min(axis=0), body.corners.reshape(-1, 3).max(axis=0)
    reach = np.ptp(body.corners, axis=1)
    outside = ((centres - low < 0.75 * reach) | (high - centres < 0.75 * reach)).any(axis=1)
    return values[outside].max(initial=0.0) >= HIDDEN * values.max(initial=0.0)


def _limits(body: Body, view: View, frames: Any) -> tuple[float, float]:
    """Ends of the scale of colours over all frames that are drawn."""
    if view.field == "damage":
        return DAMAGE_LIMITS
    found = [body.field(view.field, frame) for frame in frames]
    low, high = min(map(np.nanmin, found)), max(map(np.nanmax, found))
    return (float(low), float(high)) if high > low else (float(low) - 0.5, float(high) + 0.5)


def _fill(pyvista, plotter, body: Body, view: View, section: Section | None, limits, title: str, unit: str) -> str:
    """Put the body, its outline, a scale and words into an empty picture; the words."""
    grid = _grid(pyvista, body, view, section)
    damage = view.field == "damage"
    label = DAMAGE_LABEL if damage else view.field.replace("_", " ")
    if view.field.startswith("displacement"):
        label += f" ({unit})" if unit else ""
    plotter.set_background("white")
    plotter.add_mesh(
        grid,
        scalars="value",
        cmap=DAMAGE_COLOURS if damage else OTHER_COLOURS,
        clim=limits,
        nan_color="lightgrey",
        show_edges=grid.n_cells < 20_000,
        edge_color="#707070",
        line_width=0.5,
        ambient=0.8,  # colours are read off the scale: faces in the shade stay near theirs
        diffuse=0.25,
        scalar_bar_args={
            "title": f"{label}\n", "color": "black", "n_labels": 5, "fmt": "%.3g", "position_x": 0.2,
            "position_y": 0.02, "width": 0.6, "height": 0.08, "title_font_size": 18, "label_font_size": 16,
        },
    )  # fmt: skip
    words = _words(body, view, section, unit)
    text = "\n".join(filter(None, (title[:90], words)))
    plotter.add_text(text, position="upper_left", font_size=10, color="black")
    plotter.add_axes(color="black")
    look(plotter, view.view, grid.bounds)
    return words


def _grid(pyvista, body: Body, view: View, section: Section | None):
    """The cells at their displaced places, those beyond the section left away."""
    corners = body.corners + view.deformed * body.displacement(view.frame)
    values = body.field(view.field, view.frame)
    if section is not None:
        centres = body.corners.mean(axis=1)[:, section.axis]
        grain = 1e-9 * np.ptp(centres)
        # iso looks from below y: the side towards the eye is left away
        kept = (
            centres >= section.place - grain
            if section.axis == 1 and view.view == "iso"
            else (centres <= section.place + grain)
        )
        corners, values = corners[kept], values[kept]
    return outside(pyvista, corners, values)


def outside(pyvista, corners: np.ndarray, values: np.ndarray):
    """The faces that are seen: corners at one place are joined, so that faces between two cells vanish."""
    from vtkmodules.vtkFiltersGeometry import vtkDataSetSurfaceFilter

    flat = corners.reshape(-1, 3)
    grain = 1e-6 * np.ptp(flat, axis=0).max() + 1e-300
    keys = np.round((flat - flat.min(axis=0)) / grain).astype(np.int64)
    _, first, places = np.unique(keys, axis=0, return_index=True, return_inverse=True)
    count = len(corners)
    cells = np.hstack([np.full((count, 1), 8), places.reshape(-1, 8)]).ravel()
    grid = pyvista.UnstructuredGrid(cells, np.full(count, pyvista.CellType.HEXAHEDRON), flat[first])
    grid.cell_data["value"] = values
    surface = vtkDataSetSurfaceFilter()
    surface.SetInputData(grid)
    surface.Update()
    return pyvista.wrap(surface.GetOutput())


def _words(body: Body, view: View, section: Section | None, unit: str) -> str:
    numbers = body.numbers(view.frame)
    words = [f"row {numbers['row']:.0f}"] if "load_factor" in numbers else []
    if "load_factor" in numbers:
        words.append(f"load factor {numbers['load_factor']:.4g}")
    if "broken_bonds" in numbers:
        words.append(f"{numbers['broken_bonds']:,.0f} broken bonds")
    words.append(f"displacements x {view.deformed:g}")
    if section is not None:
        words.append(f"cut at {'xyz'[section.axis]} = {section.place:.4g}{' ' + unit if unit else ''}")
    return ", ".join(words)


def shot(plotter, path: Path) -> None:
    """Write a PNG whatever the suffix of the file is."""
    Image.fromarray(plotter.screenshot(None, return_img=True)).save(path, format="PNG")
