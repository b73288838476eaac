"""Figures of a run with failure, from its result files alone: reaction, energies, damage, and a film of the damage."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi.results import vtkhdf
from pdfem_mpi.results.canvas import Axes, Figure, MaxNLocator, Normalize, rc_context
from pdfem_mpi.results.history import read_history
from pdfem_mpi.results.labels import as_it_is, attempt
from pdfem_mpi.results.ownership import Written
from pdfem_mpi.results.plots import DPI, LEGEND, SIZE_INCHES, STYLE
from pdfem_mpi.results.read_frames import POINTS_FILE, frame_numbers, has_damage
from pdfem_mpi.results.run_folder import read_summary
from pdfem_mpi.system.files import replacing

COLORS = {"stable": "#0072B2", "avalanche": "#D55E00", "work": "#000000"}
#: Columns of the history that the energies are drawn from, with label and colour (Okabe & Ito, 2008).
ENERGIES = (
    ("external_work", "work of loads and supports", "#000000"),
    ("stored_energy", "stored", "#0072B2"),
    ("dissipated_energy", "in broken bonds", "#D55E00"),
    ("released_energy", "released by relaxation", "#009E73"),
)
#: Rows in equilibrium.
STABLE = ("critical", "arrest", "step")
#: A run without failure needs so many rows for a line between them.
FEWEST_ROWS = 2
STAGES = 4
_LAYOUTS = {1: (1, 1), 2: (1, 2)}
#: A face that shows less than this share of the largest damage hides a crack.
HIDDEN = 0.6
#: Damage beside a complete flat crack is 0.39 for l = Delta; the scale ends a little above.
DAMAGE_SCALE = Normalize(0.0, 0.5)
FILM_DPI, FRAME_SECONDS = 80, 0.25


def draw_failure(
    folder: str | Path, title: str, length: str, force: str, film: bool = False, *, warn: Callable[[str], None]
) -> list[Path]:
    """Draw what the result files of a run folder allow into its ``figures``.

    Parameters
    ----------
    folder : str or Path
        With history.csv and, for the damage, points.vtkhdf; summary.json, if it is there, knows the peak.
    title, length, force : str
        Of the deck; labels only.
    film : bool
        Draw ``damage.gif`` too.
    warn : callable
        Called with a sentence about each figure that could not be drawn.

    Returns
    -------
    list of Path
        The figures drawn: ``reaction.png``, ``energies.png``, ``damage.png``, ``damage.gif``; of a run without
        failure the first, if it has several rows.
    """
    folder = Path(folder)
    history = read_history(folder / "history.csv")
    names = []
    if len(history.get("broken_bonds", ())):
        names = ["reaction.png", "energies.png"]
        if has_damage(folder / POINTS_FILE):
            names += ["damage.png", "damage.gif"] if film else ["damage.png"]
    elif len(history.get("reaction", ())) >= FEWEST_ROWS:
        names = ["reaction.png"]
    if not names:
        return []
    (folder / "figures").mkdir(exist_ok=True)
    written = Written(folder)
    written.begin()
    drawn: list[Path] = []
    for path in [written.new(f"figures/{name}") for name in names]:
        drawn += attempt(partial(draw_figure, path, title, length, force), path, warn)
    return drawn


def draw_figure(path: Path, title: str, length: str, force: str) -> None:
    """Draw one of the figures of `draw_failure`, which its name tells, from the files of its run folder."""
    folder, words = path.parent.parent, (title, length, force)
    history = read_history(folder / "history.csv")
    if path.name == "reaction.png":
        _draw_reaction(path, history, *words, find_peak(history, read_summary(folder)))
    elif path.name == "energies.png":
        _draw_energies(path, history, *words)
    else:
        points = folder / POINTS_FILE
        layer, numbers = _Layer(points), frame_numbers(points)
        history = numbers if "broken_bonds" in numbers else history  # files of earlier versions have a frame a row
        draw = _draw_film if path.suffix == ".gif" else _draw_stages
        draw(path, layer, history, title, length)


def _unit(*names: str) -> str:
    return f" ({' '.join(map(as_it_is, names))})" if all(names) else ""


def _new_figure(title: str) -> Figure:
    figure = Figure(figsize=SIZE_INCHES, dpi=DPI, layout="constrained")
    if title:
        figure.suptitle(as_it_is(title))
    return figure


def find_peak(history: dict[str, np.ndarray], summary: dict[str, Any] | None) -> tuple[float, float] | None:
    """Displacement and reaction at the peak; None where the last row has it, since it may go on rising.

    Parameters
    ----------
    summary : dict or None
        The content of summary.json, which knows of the states between the rows that were told.
    """
    reaction = history["reaction"]
    known = ((summary or {}).get("failure") or {}).get("peak")
    if known:
        return (known["displacement"], known["load"]) if reaction[-1] < (1.0 - 1e-9) * known["load"] else None
    stable = np.isin(history["event"], STABLE)
    peak = int(np.argmax(np.where(stable, reaction, -np.inf) if stable.any() else reaction))
    return (history["displacement"][peak], reaction[peak]) if peak < len(reaction) - 1 else None


def _draw_reaction(
    path: Path, history: dict, title: str, length: str, force: str, peak: tuple[float, float] | None
) -> Path:
    """Reaction over displacement; equilibria and states within an avalanche have different markers."""
    u, reaction = history["displacement"], history["reaction"]
    stable = np.isin(history["event"], STABLE)
    with rc_context(STYLE), replacing(path) as temporary:
        figure = _new_figure(title)
        axes = figure.subplots()
        axes.plot(np.append(0.0, u), np.append(0.0, reaction), color="#999999", linewidth=1.0, zorder=1)
        for chosen, label, color, marker in (
            (stable, "in equilibrium", COLORS["stable"], "o"),
            (~stable, "bonds breaking", COLORS["avalanche"], "s"),
        ):
            if chosen.any():
                axes.plot(u[chosen], reaction[chosen], marker, color=color, markersize=4, label=label, linestyle="none")
        if peak:
            axes.plot(*peak, "o", color=COLORS["stable"], markersize=7, fillstyle="none")
            axes.annotate(
                f"peak {peak[1]:.5g}{' ' + as_it_is(force) if force else ''}",
                peak,
                textcoords="offset points",
                xytext=(-12, 6),
                ha="right",
            )
        axes.set_xlabel(f"displacement{_unit(length)}")
        axes.set_ylabel(f"reaction{_unit(force)}")
        if u.min(initial=0.0) >= 0.0:  # a cycle may pass 0
            axes.set_xlim(left=0.0)
        axes.set_ylim(bottom=0.0)
        axes.ticklabel_format(axis="x", scilimits=(-2, 4), useMathText=True)
        figure.legend(loc="outside lower center", **LEGEND)
        figure.savefig(temporary, format="png")
    return path


def _draw_energies(path: Path, history: dict, title: str, length: str, force: str) -> Path:
    """Energies over the number of broken bonds."""
    broken = history["broken_bonds"]
    with rc_context(STYLE), replacing(path) as temporary:
        figure = _new_figure(title)
        axes = figure.subplots()
        for name, label, color in ENERGIES:
            if not np.isnan(history[name]).any():
                axes.plot(broken, history[name], "o-", color=color, label=label, markersize=3, linewidth=1.4)
        axes.set_xlabel("broken bonds")
        axes.set_ylabel(f"energy{_unit(force, length)}")
        axes.set_ylim(bottom=0.0)
        axes.xaxis.set_major_locator(MaxNLocator(6))
        figure.legend(loc="outside lower center", **(LEGEND | {"ncols": 4}))
        figure.savefig(temporary, format="png")
    return path


class _Layer:
    """The layer of points at one face of the body, across its shortest side, and their damage in each frame.

    Where the face shows little of the damage of the last frame, it is the layer through the largest damage, across the
    longest direction in which there is some.
    """

    def __init__(self, path: Path):
        self.path = path
        x = vtkhdf.read_points(path)
        sides = np.ptp(x, axis=0)
        across = int(np.argmin(sides))
        last = vtkhdf.read_frame(path, "damage", vtkhdf.frames(path) - 1)
        outer = x[:, across] >= x[:, across].max() - 1e-3 * sides.max()
        inside = last[outer].max(initial=0.0) < HIDDEN * last.max(initial=0.0)
        if inside:
            across = int(np.argmax(np.ptp(x[last >= 0.5 * last.max()], axis=0)))
        self.plane = [d for d in range(3) if d != across]
        # points of one layer are no farther apart across the body than a tenth of their spacing within it
        tolerance = 0.1 * np.sqrt(np.prod(sides[self.plane]) / len(x)) if len(x) else 0.0
        place = x[np.argmax(last), across] if inside else x[:, across].max()
        self.chosen = np.flatnonzero(np.abs(x[:, across] - place) <= tolerance)
        self.where = f"{'xyz'[across]} = {place:.4g}"
        self.x = x[self.chosen][:, self.plane]
        self.low, self.high = self.x.min(axis=0), self.x.max(axis=0)

    def damage(self, frame: int) -> np.ndarray:
        return vtkhdf.read_frame(self.path, "damage", frame)[self.chosen]

    def draw(self, axes: Axes, frame: int, length: str):
        """One panel; the points as squares that fill it."""
        figure = axes.figure
        area = np.prod(self.high - self.low) / max(len(self.x), 1)
        panel = axes.get_position()
        inches = np.array([panel.width, panel.height]) * figure.get_size_inches()
        scale = float(np.min(inches / (self.high - self.low)))
        size = max((72.0 * 1.3 * np.sqrt(area) * scale) ** 2, 0.5)
        axes.set_aspect("equal")
        axes.grid(False)
        axes.set_xlim(self.low[0], self.high[0])
        axes.set_ylim(self.low[1], self.high[1])
        axes.set_xlabel(f"${'xyz'[self.plane[0]]}${_unit(length)}")
        axes.set_ylabel(f"${'xyz'[self.plane[1]]}${_unit(length)}")
        return axes.scatter(
            *self.x.T, c=self.damage(frame), s=size, marker="s", linewidths=0, cmap="inferno_r", norm=DAMAGE_SCALE
        )


def stages(broken: Sequence[float], n_frames: int) -> list[int]:
    """Frames that show the start, two stages on the way and the end: by shares of the bonds broken at the end."""
    counts = np.asarray(broken[:n_frames])
    first = int(np.argmax(counts > 0))
    shares = [first + int(np.argmin(np.abs(counts[first:] - share * counts[-1]))) for share in (1 / 3, 2 / 3)]
    return sorted({first, *shares, n_frames - 1})


def _draw_stages(path: Path, layer: _Layer, history: dict, title: str, length: str) -> Path:
    """The paper's Fig. 16: local damage (eq. 5) at stages of the failure."""
    frames = stages(history["broken_bonds"], vtkhdf.frames(layer.path))
    with rc_context(STYLE), replacing(path) as temporary:
        figure = _new_figure(title)
        panels = np.atleast_1d(figure.subplots(*_LAYOUTS.get(len(frames), (2, 2)))).ravel()
        for panel, frame in zip(panels, frames, strict=False):
            image = layer.draw(panel, frame, length)
            panel.set_title(f"{history['broken_bonds'][frame]:,.0f} broken bonds", fontsize=10)
        for panel in panels[len(frames) :]:
            panel.set_axis_off()
        figure.supxlabel(f"points at {layer.where}{' ' + as_it_is(length) if length else ''}", fontsize=10)
        figure.colorbar(image, ax=panels, label="local damage (0.39: a crack passes by)", extend="max", shrink=0.8)
        figure.savefig(temporary, format="png")
    return path


def _draw_film(path: Path, layer: _Layer, history: dict, title: str, length: str) -> Path:
    """One picture a frame, as an animated GIF."""
    from matplotlib.animation import FuncAnimation, PillowWriter

    n_frames = vtkhdf.frames(layer.path)
    unfinished = path.with_name(".unfinished.gif")  # the writer goes by the suffix
    with rc_context(STYLE):
        figure = _new_figure(title)
        axes = figure.subplots()
        image = layer.draw(axes, 0, length)
        figure.colorbar(image, ax=axes, label="local damage (0.39: a crack passes by)", extend="max", shrink=0.8)

        def show(frame):
            image.set_array(layer.damage(frame))
            axes.set_title(
                f"load factor {history['load_factor'][frame]:.4g}, {history['broken_bonds'][frame]:,.0f} broken bonds",
                fontsize=10,
            )
            return (image,)

        film = FuncAnimation(figure, show, frames=n_frames, blit=False)
        film.save(str(unfinished), writer=PillowWriter(fps=round(1.0 / FRAME_SECONDS)), dpi=FILM_DPI)
    unfinished.replace(path)
    return path
