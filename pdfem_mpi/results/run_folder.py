"""A run folder read back as numpy arrays: the one reader of summaries and histories."""

from __future__ import annotations

import json
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi.results import vtkhdf
from pdfem_mpi.results.history import read_columns, read_history
from pdfem_mpi.results.read_frames import frame_numbers, frame_rows
from pdfem_mpi.system.plain_files import read_plain

#: A summary has no more bytes.
MOST_BYTES = 1 << 24
#: Keys of a summary that are no results of the case, and how names of wall times begin, which go last.
NOT_RESULTS = ("schema_version", "exit_code", "ranks", "versions")
WALL_TIMES = "seconds."
#: Of these one at least is in every run folder.
MARKS = ("summary.json", "history.csv", "checkpoints", "run.log")


def read_summary(folder: str | Path) -> dict[str, Any] | None:
    """The content of a folder's summary.json, None where there is none that can be read."""
    try:
        content = json.loads(read_plain(Path(folder) / "summary.json", MOST_BYTES))
    except (OSError, ValueError):
        return None
    return content if isinstance(content, dict) else None


#: Components of vectors and of symmetric tensors.
AXES = {3: ("x", "y", "z"), 6: ("xx", "yy", "zz", "xy", "yz", "zx")}


def numbers_of(summary: dict[str, Any]) -> dict[str, float]:
    """All numbers of a summary by dotted name; probes without prefix, vectors by component, wall times last."""
    found: dict[str, float] = {}

    def visit(name: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, item in value.items():
                visit(f"{name}.{key}" if name and name != "probes" else key, item)
        elif isinstance(value, list) and len(value) in AXES and all(isinstance(item, float) for item in value):
            for axis, item in zip(AXES[len(value)], value, strict=True):
                visit(f"{name}_{axis}", item)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            found[name] = value

    for key, value in summary.items():
        if key not in NOT_RESULTS:
            visit(key, value)
    return dict(sorted(found.items(), key=lambda item: item[0].startswith(WALL_TIMES)))


@dataclass(frozen=True)
class Frames:
    """Fields over the load program at the points, or at the nodes, of the body.

    Fields are stored in single precision, places and load factors in double precision.

    Attributes
    ----------
    path : Path
        A file of the kind that ParaView reads.
    """

    path: Path

    @cached_property
    def positions(self) -> np.ndarray:
        """Reference positions, float64, shape (n, 3), dimension length."""
        return vtkhdf.read_points(self.path)

    @property
    def load_factors(self) -> np.ndarray:
        """Load factor of each frame, float64, shape (n_frames,)."""
        return frame_numbers(self.path)["load_factor"]

    @property
    def rows(self) -> np.ndarray:
        """Row of the history that each frame is of, from 0, int64, shape (n_frames,)."""
        return frame_rows(self.path)

    @property
    def names(self) -> list[str]:
        """What the frames hold, such as ``displacement`` and ``damage``."""
        return vtkhdf.frame_fields(self.path)

    @property
    def cell_names(self) -> list[str]:
        """What they hold of the cells of elements, such as ``stress``."""
        return vtkhdf.frame_fields(self.path, "CellData")

    def field(self, name: str, frame: int = -1) -> np.ndarray:
        """A field of one frame; negative frames count from the last.

        Parameters
        ----------
        name : str
            One of `names`.

        Returns
        -------
        float32, shape (n,) or (n, k)

        Raises
        ------
        KeyError
            The frames hold no such field.
        IndexError
            There is no such frame.
        """
        return self._read(name, frame, "PointData", self.names)

    def of_cells(self, name: str, frame: int = -1) -> np.ndarray:
        """A field of the cells of elements, one of `cell_names`; as `field`, with a row for each cell."""
        return self._read(name, frame, "CellData", self.cell_names)

    def _read(self, name: str, frame: int, kind: vtkhdf.Kind, known: list[str]) -> np.ndarray:
        count = vtkhdf.frames(self.path)
        if not -count <= frame < count:
            raise IndexError(f"{self.path} has {count} frames, and no frame {frame}.")
        if name not in known:
            raise KeyError(f"{self.path} holds {', '.join(known) or 'nothing'}, and no {name}.")
        return vtkhdf.read_frame(self.path, name, frame % count, kind)

    def displacement(self, frame: int = -1) -> np.ndarray:
        """Displacements of a frame, float32, shape (n, 3), dimension length."""
        return self.field("displacement", frame)

    def damage(self, frame: int = -1) -> np.ndarray:
        """Local damage (eq. 5) of a frame, float32, shape (n,); written where the deck has ``output.damage = true``."""
        return self.field("damage", frame)


class RunFolder:
    """The folder that a run wrote; nothing is read before it is asked for.

    Parameters
    ----------
    path : str or Path

    Raises
    ------
    FileNotFoundError
        The folder is not that of a run.

    Examples
    --------
    >>> folder = pdfem_mpi.open_run("runs/plate_cutout")       # doctest: +SKIP
    >>> folder.reaction.max(), folder.history["broken_bonds"][-1]
    >>> folder.points.displacement(-1), folder.damage
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)
        if not any((self.path / name).exists() for name in MARKS):
            raise FileNotFoundError(f"{self.path} is not the folder of a run: it has none of {', '.join(MARKS)}.")

    def __repr__(self) -> str:
        return f"RunFolder({str(self.path)!r})"

    @property
    def summary(self) -> dict[str, Any]:
        """The content of summary.json: status, counts, probes, times, memory.

        Raises
        ------
        FileNotFoundError
            The run has not ended yet, or was killed.
        """
        content = read_summary(self.path)
        if content is None:
            raise FileNotFoundError(f"{self.path} has no summary.json that can be read: the run has not ended.")
        return content

    @property
    def numbers(self) -> dict[str, float]:
        """All numbers of the summary by dotted name: probes by their own, vectors by component, wall times last.

        Raises
        ------
        FileNotFoundError
            As `summary`.
        """
        return numbers_of(self.summary)

    @property
    def history(self) -> dict[str, np.ndarray]:
        """The columns of history.csv, each of shape (n_rows,); NaN where a field is empty."""
        return read_history(self.path / "history.csv")

    @property
    def reaction(self) -> np.ndarray:
        """The scalar force that falls when the body fails, float64, shape (n_rows,)."""
        return self.history["reaction"]

    @property
    def displacement(self) -> np.ndarray:
        """The displacement that goes with `reaction`, float64, shape (n_rows,)."""
        return self.history["displacement"]

    @property
    def points(self) -> Frames | None:
        """Fields at the peridynamic points; None where the run wrote none."""
        return self._frames("points.vtkhdf")

    @property
    def nodes(self) -> Frames | None:
        """Fields at the nodes of elements; None where the run wrote none."""
        return self._frames("elements.vtkhdf")

    @property
    def damage(self) -> np.ndarray | None:
        """Local damage of the points in the last frame, float32, shape (n_points,); None where none was written."""
        points = self.points
        return points.damage() if points and "damage" in points.names else None

    def line(self, name: str) -> dict[str, np.ndarray]:
        """The columns of a line probe's file, float64; words in the column ``model``.

        Raises
        ------
        FileNotFoundError
            The run has no such line.
        """
        return read_columns(self.path / "lines" / f"{name}.csv", "model")

    def _frames(self, name: str) -> Frames | None:
        path = self.path / name
        return Frames(path) if path.exists() else None
