"""The body of a run folder as cells that can come apart: what pictures in three dimensions are drawn from.

Every cell has eight corners of its own. Corners of neighbours move together where their displacements agree, and apart
where they do not: so a crack is seen to open, and cells beside it keep their shape.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

import h5py
import numpy as np

from pdfem_mpi.kernels.dense import lengths
from pdfem_mpi.results.export import Part

#: Sides on which the Gauss points of a cell lie, x first, and its corners, in VTK's order.
_GAUSS = np.array([(r, s, t) for t in (-1, 1) for s in (-1, 1) for r in (-1, 1)])
_NEAREST = np.array([0, 1, 3, 2, 4, 5, 7, 6])
_AT_CORNERS = np.prod(1.0 + np.sqrt(3.0) * _GAUSS[_NEAREST][:, None, :] * _GAUSS[None, :, :], axis=2) / 8.0
#: Neighbours whose corners are farther apart than so many times the median move apart.
APART = 30.0
COMPONENTS = ("x", "y", "z")


class NoPicture(Exception):
    """What cannot be drawn; the sentence has the remedy."""


@dataclass(frozen=True)
class Body:
    """A run folder's fields on cells.

    Attributes
    ----------
    folder : Path
    """

    folder: Path

    def __post_init__(self) -> None:
        if not (self.has("points") or self.has("elements")):
            if self.has("body"):
                why = "found its region of bonds, so that only body.vtkhdf has its fields. Draw that with ParaView."
                raise NoPicture(f"{self.folder} {why}")
            raise NoPicture(f"{self.folder} has no fields to draw. Run the deck with output.fields = true.")
        if not self.n_frames:
            raise NoPicture(f"{self.folder} has no frame yet: the run ended before its first row.")

    def has(self, part: str) -> bool:
        """Whether there is a file of points or of elements."""
        return (self.folder / f"{part}.vtkhdf").is_file()

    @property
    def n_frames(self) -> int:
        """Frames that every part has."""
        return min(self._read(part, lambda file: file.n_frames) for part in self._parts)

    @property
    def names(self) -> list[str]:
        """Fields that can be drawn."""
        found: dict[str, None] = {}
        for part in self._parts:
            for kind in ("PointData", "CellData"):
                found |= dict.fromkeys(self._read(part, lambda file, kind=kind: list(file.fields(kind, 0))))
        return [name for name in found if name not in ("global_id", "overlap")]

    @cached_property
    def corners(self) -> np.ndarray:
        """Reference positions of the corners of all cells, float64, shape (n_cells, 8, 3)."""
        parts = []
        if self.has("points"):
            parts.append(_to_corners(self._read("points", lambda file: file.root["Points"][:])))
        if self.has("elements"):
            nodes = self._read("elements", lambda file: file.root["Points"][:])
            parts.append(nodes[self._elements])
        return np.concatenate(parts)

    def displacement(self, frame: int) -> np.ndarray:
        """Displacements of the corners, float64, shape (n_cells, 8, 3)."""
        parts = []
        if self.has("points"):
            values = self._fields("points", "PointData", frame)["displacement"].astype(np.float64)
            parts.append(_together(self._places, _to_corners(values), values.reshape(-1, 8, 3)[:, _NEAREST]))
        if self.has("elements"):
            parts.append(
                self._fields("elements", "PointData", frame)["displacement"][self._elements].astype(np.float64)
            )
        return np.concatenate(parts)

    def field(self, name: str, frame: int) -> np.ndarray:
        """A field as one number for each cell, float64, shape (n_cells,); NaN where a part does not have it.

        Vectors by their size; ``displacement_x`` is a component.

        Raises
        ------
        NoPicture
            There is no such field.
        """
        stem, _, component = name.rpartition("_")
        vector = stem in self.names and component in COMPONENTS
        base = stem if vector else name
        if base not in self.names:
            components = ", ".join(f"displacement_{axis}" for axis in COMPONENTS)
            raise NoPicture(
                f"the frames of {self.folder} have no field {name}. They have {', '.join(self.names)}; {components}. "
                "Damage is written with output.damage = true."
            )
        parts = []
        for part in self._parts:
            values = self._on_cells(part, base, frame)
            if values.ndim == 2:
                values = values[:, COMPONENTS.index(component)] if vector else lengths(values)
            parts.append(values)
        return np.concatenate(parts)

    def numbers(self, frame: int) -> dict[str, float]:
        """Load factor, reaction and broken bonds of a frame, as far as they are known, and its time."""

        def read(file: Part) -> dict[str, float]:
            numbers = file.root.get("FieldData", {})
            return {name: float(table[frame]) for name, table in numbers.items()} | {"row": float(file.times[frame])}

        return self._read(self._parts[0], read)

    @property
    def _parts(self) -> list[str]:
        return [part for part in ("points", "elements") if self.has(part)]

    @cached_property
    def _elements(self) -> np.ndarray:
        """Corners of the elements that are not drawn as points already, int64, shape (n, 8)."""
        cells = self._read("elements", lambda file: file.root["Connectivity"][:].reshape(-1, 8))
        return cells[self._kept]

    @cached_property
    def _kept(self) -> np.ndarray:
        overlap = self._read("elements", lambda file: file.root["CellData/overlap"][:].astype(bool))
        return ~overlap if self.has("points") else np.ones(len(overlap), bool)

    def _on_cells(self, part: str, name: str, frame: int) -> np.ndarray:
        """A field as the mean over each cell, shape (n_cells_of_part,) or (n_cells_of_part, k)."""
        on_points, on_cells = (self._fields(part, kind, frame) for kind in ("PointData", "CellData"))
        if part == "points":
            if name in on_points:
                values = on_points[name].astype(np.float64)
                return values.reshape(-1, 8, *values.shape[1:]).mean(axis=1)
            return np.full(self._n_points // 8, np.nan)
        if name in on_cells:
            return on_cells[name][self._kept].astype(np.float64)
        if name in on_points:
            return on_points[name][self._elements].astype(np.float64).mean(axis=1)
        empty = 0.0 if name == "damage" else np.nan
        return np.full(len(self._elements), empty)

    @cached_property
    def _n_points(self) -> int:
        return self._read("points", lambda file: int(file.root["NumberOfPoints"][0]))

    @cached_property
    def _places(self) -> np.ndarray:
        """Number of the place of each corner of the cells with points: corners at one place share a number."""
        x = self.corners[: self._n_points // 8].reshape(-1, 3)
        grain = 1e-6 * np.ptp(x, axis=0).max() + 1e-300
        return np.unique(np.round((x - x.min(axis=0)) / grain).astype(np.int64), axis=0, return_inverse=True)[1].ravel()

    def _fields(self, part: str, kind: str, frame: int) -> dict[str, np.ndarray]:
        return self._read(part, lambda file: file.fields(kind, frame))

    def _read(self, part: str, what):
        path = self.folder / f"{part}.vtkhdf"
        with h5py.File(path, "r", locking=False) as file:
            return what(Part(file["VTKHDF"], int(file["VTKHDF/Steps"].attrs["NSteps"])))


def _together(places: np.ndarray, extended: np.ndarray, own: np.ndarray) -> np.ndarray:
    """The mean over the cells at a place, where they agree; else each cell's own nearest point."""
    flat = extended.reshape(-1, 3)
    count = np.bincount(places)
    mean = np.stack([np.bincount(places, flat[:, d]) / count for d in range(3)], axis=1)[places]
    away = lengths(flat - mean)
    widest = np.zeros(len(count))
    np.maximum.at(widest, places, away)
    inner = widest[count > 1]
    limit = APART * np.median(inner) if len(inner) else 0.0
    apart = widest[places] > max(limit, 1e-12 * np.abs(flat).max(initial=0.0))
    return np.where(apart[:, None], own.reshape(-1, 3), mean).reshape(extended.shape)


def _to_corners(values: np.ndarray) -> np.ndarray:
    """From the eight points of each cell to its corners, (8 n, 3) to (n, 8, 3)."""
    return np.einsum("ag,cgd->cad", _AT_CORNERS, values.reshape(-1, 8, 3).astype(np.float64))


def nice_factor(body: Body, displacement: np.ndarray, share: float = 0.05) -> float:
    """A round number by which displacements are a share of the body's size; 1 where they are larger already."""
    size = np.ptp(body.corners.reshape(-1, 3), axis=0).max()
    moved = displacement.reshape(-1, 3) - displacement.reshape(-1, 3).mean(axis=0)
    largest = np.abs(moved).max(initial=0.0)
    if not largest or largest >= share * size:
        return 1.0
    wanted = share * size / largest
    power = 10.0 ** np.floor(np.log10(wanted))
    return float(max(step * power for step in (1.0, 2.0, 5.0) if step * power <= wanted * (1 + 1e-9)))
