"""Fields over the load program, in files for the viewer."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi import __version__
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.results.cursor import continue_frames, set_aside
from pdfem_mpi.results.frame_digest import FrameDigest
from pdfem_mpi.runs.output import Output, Place

Arrays = dict[str, Any]
HISTORY_FILE, POINTS_FILE, ELEMENTS_FILE = "history.csv", "points.vtkhdf", "elements.vtkhdf"
#: Columns of history.csv that a frame has as well, and their names there; ``time`` is the viewer's own.
NUMBERS = {
    "load_factor": "load_factor", "time": "pseudo_time", "reaction": "reaction", "broken_bonds": "broken_bonds",
}  # fmt: skip


class FramesOutput(Output):
    """Fields over the load program, in a file for the viewer.

    Parameters
    ----------
    name : str
        The file.
    create : callable
        ``create(place, path)`` writes its geometry.
    pick : callable
        What its points, or nodes, and its cells have in `Fields`, by name.
    names : tuple of str
        Of the fields that the deck asks for.
    has_damage : bool

    Attributes
    ----------
    row : int
        Rows of the history so far: the number of the last is the time of its frame, so that time always rises.
    """

    def __init__(
        self,
        name: str,
        create: Callable[[Place, Path], None],
        pick: Callable[[Fields], tuple[Arrays, Arrays]],
        names: tuple[str, ...],
        has_damage: bool = False,
    ) -> None:
        super().__init__()
        self.name, self.create, self.pick, self.names, self.has_damage = name, create, pick, names, has_damage
        self.path: Path
        self.digest: FrameDigest
        self.row, self.every = 0, 1
        self._waiting: tuple[dict[str, Any], Fields | None, np.ndarray | None] | None = None
        self._made: tuple[Arrays, Arrays] | None = None

    def open(self, place: Place) -> None:
        from pdfem_mpi.results import vtkhdf

        self.row, self.every = place.cursors.get(HISTORY_FILE, {}).get("rows", 0), place.scene.output.every
        self.path = place.written.new(self.name)
        if place.other_fields:
            set_aside(self.path, "output was changed", place.note, "before")
        cursor = None if place.other_fields else place.cursors.get(self.name)
        digest = None if cursor is None else continue_frames(self.path, cursor, place.note)
        if digest is not None and not vtkhdf.has_numbers(self.path):
            set_aside(self.path, "its frames are those of an older version", place.note, "before")
            digest = None
        if digest is None:
            self.create(place, self.path)
            digest = vtkhdf.digest_of(self.path)
        self.digest = digest

    def write(self, columns: dict[str, Any], fields: Fields | None, damage: np.ndarray | None) -> None:
        self.row += 1
        self._waiting, self._made = (columns, fields, damage), None
        if (self.row - 1) % self.every == 0:
            self._append()

    def close(self, place: Place) -> None:
        self._append()  # the last row, whatever its number is

    def make(self) -> None:
        """Make the frame that waits of the body as it is, before that changes."""
        if self._waiting is not None and self._made is None:
            columns, fields, damage = self._waiting
            self._made, self._waiting = self.arrays(fields, damage), (columns, None, None)

    def arrays(self, fields: Fields | None, damage: np.ndarray | None) -> tuple[Arrays, Arrays]:
        """Fields of a frame on points or nodes, and on cells."""
        on_points, on_cells = (
            {name: found[name] for name in self.names if name in found} for found in self.pick(fields)
        )
        if damage is not None and self.has_damage:
            on_points |= by_part(damage)
        return on_points, on_cells

    def _append(self) -> None:
        """Append the frame of the last row, if it is not there already."""
        from pdfem_mpi.results import vtkhdf

        if self._waiting is None:
            return
        columns, fields, damage = self._waiting
        numbers = {name: columns[column] for column, name in NUMBERS.items() if column in columns}
        arrays = self._made or self.arrays(fields, damage)
        vtkhdf.append_frame(self.path, self.row, *arrays, numbers, self.digest)
        self._waiting = self._made = None


def by_part(damage: np.ndarray) -> Arrays:
    """Local damage, and where bonds soften its parts, by the names of the fields."""
    return dict(zip(("damage", "softened", "gone"), damage.reshape(len(damage), -1).T, strict=False))


def fields_of_points(fields: Fields) -> tuple[Arrays, Arrays]:
    """What the peridynamic points have."""
    return {"displacement": fields.u_points, **fields.of_points}, {}


def fields_of_elements(fields: Fields) -> tuple[Arrays, Arrays]:
    """What the nodes of elements have, and their cells."""
    return {"displacement": fields.u_nodes}, fields.of_cells


def create_points(place: Place, path: Path) -> None:
    """Write the geometry of the peridynamic points."""
    from pdfem_mpi.results import vtkhdf

    geometry = place.geometry
    chosen = geometry.has_points
    data = {
        "global_id": np.arange(8 * np.count_nonzero(chosen)),
        "region": np.repeat(geometry.region[chosen], 8),
        "material": np.repeat(geometry.material[chosen], 8),
        "overlap": np.repeat(geometry.is_overlap[chosen], 8),
    }
    vtkhdf.create_points(path, geometry.point_positions, data, attributes=_identity(place))


def create_elements(place: Place, path: Path) -> None:
    """Write the geometry of the finite elements."""
    geometry = place.geometry
    cells = geometry.has_nodes
    data = {
        "region": geometry.region[cells],
        "material": geometry.material[cells],
        "overlap": geometry.is_overlap[cells],
    }
    write_cells(place, path, geometry.node_positions, geometry.node_row[geometry.mesh.cells[cells]], data)


def write_cells(place: Place, path: Path, nodes: np.ndarray, cells: np.ndarray, data: dict[str, np.ndarray]) -> None:
    """Write the geometry of hexahedra, with fields that do not change."""
    from pdfem_mpi.results import vtkhdf

    vtkhdf.create_elements(path, nodes, cells, data, attributes=_identity(place))


def _identity(place: Place) -> dict[str, str]:
    return {"pdfem_mpi_version": __version__, "deck_sha256": place.deck_sha256}
