"""What a run writes: each output observes the rows of the load program. On rank 0 alone.

An output has `open` before the first row, `write` at each row, `measure` on the last fields, `close` and `draw` at the
end; it leaves out what it does not need. `make_outputs` is the one place that knows which output a table of the deck
asks for.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.measure.geometry import Geometry, gather_geometry
from pdfem_mpi.results.cursor import continue_history, flushed
from pdfem_mpi.results.history import History
from pdfem_mpi.results.labels import attempt
from pdfem_mpi.runs.body_frames import BodyFrames
from pdfem_mpi.runs.frames import (
    ELEMENTS_FILE,
    HISTORY_FILE,
    POINTS_FILE,
    FramesOutput,
    create_elements,
    create_points,
    fields_of_elements,
    fields_of_points,
)
from pdfem_mpi.runs.output import Drawing, Output, Place, new_figure
from pdfem_mpi.runs.probes import OF_PROBE
from pdfem_mpi.runs.simulation import Simulation


class HistoryOutput(Output):
    """history.csv, and the figures of a run in which bonds broke, or of one with several rows."""

    def __init__(self, columns: tuple[str, ...]) -> None:
        super().__init__()
        self.columns = columns
        self.history: History

    def open(self, place: Place) -> None:
        path = place.written.new(HISTORY_FILE)
        self.history = continue_history(path, self.columns, place.cursors.get(HISTORY_FILE), place.note)

    def write(self, columns: dict[str, Any], fields: Fields | None, damage: np.ndarray | None) -> None:
        self.history.append(columns)

    def drawings(self, place: Place) -> list[Drawing]:
        last = self.history.last() or {}
        names = []
        if int(last.get("broken_bonds") or 0):
            from pdfem_mpi.results.read_frames import has_damage

            damaged = has_damage(place.written.folder / POINTS_FILE)
            names = ["damage", "energies", "reaction"] if damaged else ["energies", "reaction"]
        elif "broken_bonds" not in last and int(last.get("step") or 0) > 1:
            names = ["reaction"]
        return [Drawing(new_figure(place, name), _draw_failure, _words(place.scene)) for name in names]


@dataclass
class Outputs:
    """All outputs of a run, in the order in which they write."""

    place: Place
    history: HistoryOutput
    frames: list[FramesOutput] = field(default_factory=list)
    probes: list[Output] = field(default_factory=list)

    @property
    def all(self) -> list[Output]:
        """Every output."""
        return [self.history, *self.frames, *self.probes]

    def open(self) -> None:
        """Create all files, or cut them back to the checkpoint."""
        for output in self.all:
            output.open(self.place)

    def write(self, columns: dict[str, Any], fields: Fields | None, damage: np.ndarray | None) -> None:
        """Append one row of the load program to all files."""
        for output in self.all:
            output.write(columns, fields, damage)

    def measure(self, fields: Fields, load_factor: float) -> None:
        """Read all results off the last fields."""
        for output in self.all:
            output.measure(self.place, fields, load_factor)

    def close(self) -> None:
        """Write what belongs to the end."""
        for output in self.all:
            output.close(self.place)

    def drawings(self) -> list[Drawing]:
        """The figures of all outputs, to be drawn after summary.json was written."""
        found: list[Drawing] = []

        def take(output: Output) -> None:
            found.extend(output.drawings(self.place))

        for output in self.all if self.place.scene.output.figures else ():
            attempt(partial(take, output), Path("figures"), self.place.warn)
        return found

    def follow(self, geometry: Geometry | None) -> None:
        """Describe the body from here on as it is now, after elements were turned into bonds."""
        for frame in self.frames:
            frame.make()
        self.place.geometry = geometry

    def flush(self) -> dict[str, dict[str, Any]]:
        """Bring all files to the disk; how far each is, for a checkpoint."""
        digests = {output.name: output.digest for output in self.frames}
        return flushed(self.place.written.folder, self.history.history, digests)

    @property
    def results(self) -> dict[str, Any]:
        """What summary.json lists as probes."""
        return {name: value for output in self.all for name, value in output.results.items()}


def geometry_of(simulation: Simulation) -> Geometry | None:
    """The shape of the body on rank 0, where an output reads places of it. Collective."""
    scene = simulation.scene
    return gather_geometry(simulation.share) if scene.output.fields or scene.probes else None


def make_outputs(place: Place, columns: tuple[str, ...]) -> Outputs:
    """The outputs that a deck asks for.

    Parameters
    ----------
    columns : tuple of str
        Of history.csv.
    """
    outputs = Outputs(place, HistoryOutput(columns))
    scene, names = place.scene, place.scene.output.names
    if names and scene.is_adaptive:  # points and elements come and go: one file has the whole body
        outputs.frames.append(BodyFrames(names, with_model=True))
    elif names and scene.has_peridynamics:
        outputs.frames.append(FramesOutput(POINTS_FILE, create_points, fields_of_points, names, True))
    if names and scene.has_finite_elements and not scene.is_adaptive:
        outputs.frames.append(FramesOutput(ELEMENTS_FILE, create_elements, fields_of_elements, names))
    if names and scene.has_peridynamics and scene.output.body and not scene.is_adaptive:
        outputs.frames.append(BodyFrames(names))
    outputs.probes += [OF_PROBE[type(probe)](probe) for probe in place.scene.probes]
    return outputs


def draw_run(folder: Path, scene: Scene, warn: Callable[[str], None], film: bool = False) -> list[Path]:
    """Draw the figures of a run with failure or of several rows, from its files, on this rank alone; the paths drawn.

    ``warn`` is called with a sentence about each figure that could not be drawn.
    """
    from pdfem_mpi.results.failure_plots import draw_failure

    return draw_failure(folder, *_words(scene), film, warn=warn)


def _words(scene: Scene) -> tuple[str, str, str]:
    """What figures say of a deck."""
    return scene.title, scene.units.length, scene.units.force


def _draw_failure(*arguments: Any) -> None:
    from pdfem_mpi.results.failure_plots import draw_figure

    draw_figure(*arguments)
