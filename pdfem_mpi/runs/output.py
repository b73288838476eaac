"""What every output of a run is, and where it writes."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.measure.geometry import Geometry
from pdfem_mpi.results.labels import attempt
from pdfem_mpi.results.ownership import Written


@dataclass(frozen=True)
class Drawing:
    """A figure to be drawn, on whatever rank.

    Attributes
    ----------
    path : Path
    draw : callable
        ``draw(path, *arguments)``, by a name of its module, which loads matplotlib when it is called.
    arguments : tuple
    """

    path: Path
    draw: Callable[..., object]
    arguments: tuple[Any, ...]

    def __call__(self) -> list[str]:
        """Draw it; why it was not drawn, or nothing."""
        problems: list[str] = []
        attempt(lambda: self.draw(self.path, *self.arguments), self.path, problems.append)
        return problems


@dataclass
class Place:
    """Where outputs write, and what they describe.

    Attributes
    ----------
    scene : Scene
    geometry : Geometry or None
        None where no output reads places of the body.
    written : Written
        The files of the run folder; `Written.new` gives the path of one.
    deck_sha256 : str
    cursors : dict
        How far each file was at the checkpoint that the run goes on from; empty at the beginning.
    other_fields : bool
        Frames have other fields than before.
    note : callable
        Hears what the user should know, and later checkpoints too.
    warn : callable
        Hears what could not be drawn.
    """

    scene: Scene
    geometry: Geometry | None
    written: Written
    deck_sha256: str
    cursors: dict[str, dict[str, Any]]
    other_fields: bool
    note: Callable[[str], None]
    warn: Callable[[str], None]


class Output:
    """Observes a run; an output overrides what it needs.

    Attributes
    ----------
    results : dict
        What summary.json lists as probes.
    """

    def __init__(self) -> None:
        self.results: dict[str, Any] = {}

    def open(self, place: Place) -> None:
        """Create the files, or cut them back to the checkpoint."""

    def write(self, columns: dict[str, Any], fields: Fields | None, damage: np.ndarray | None) -> None:
        """Append one row of the load program."""

    def measure(self, place: Place, fields: Fields, load_factor: float) -> None:
        """Read results off the last fields."""

    def close(self, place: Place) -> None:
        """Write what belongs to the end."""

    def drawings(self, place: Place) -> list[Drawing]:
        """The figures, those that take longest first."""
        return []


def new_figure(place: Place, name: str) -> Path:
    """Where a figure goes."""
    (place.written.folder / "figures").mkdir(exist_ok=True)
    return place.written.new(f"figures/{name}.png")
