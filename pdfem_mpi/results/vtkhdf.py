"""Fields over time for ParaView: VTKHDF UnstructuredGrid files, version 2.0, written with h5py alone.

The geometry and the static fields are stored once. A frame adds its fields as further rows of one dataset
per field, then one entry to each array of ``Steps``, and ``NSteps`` last of all: whatever an interrupted
append leaves behind is invisible to readers, and the next append cuts it off. The file is closed between
frames, and not locked, so that an open viewer cannot stop a run.
"""

from collections.abc import Mapping
from pathlib import Path
from typing import Literal

import h5py
import numpy as np

from pdfem_mpi.results.frame_digest import FrameDigest
from pdfem_mpi.results.guarded import guarded
from pdfem_mpi.results.read_frames import KINDS, read_digest, rows_of
from pdfem_mpi.system.files import replacing

VERTEX, HEXAHEDRON = 1, 12  # VTK cell types
ROWS_PER_CHUNK = 65536  # at most; a smaller frame is one chunk
STEPS_PER_CHUNK = 64

# Shape and value of one step's entry. The geometry does not change, so all its offsets are 0; the last two
# arrays have a second axis, of length 1, for the kinds of cells.
STEP_ENTRIES = {
    "NumberOfParts": ((), 1),
    "PartOffsets": ((), 0),
    "PointOffsets": ((), 0),
    "CellOffsets": ((1,), 0),
    "ConnectivityIdOffsets": ((1,), 0),
}

#: How many rows a frame has of each kind of field.
COUNTS = {"PointData": "NumberOfPoints", "CellData": "NumberOfCells"}

Kind = Literal["PointData", "CellData"]
Precision = Literal["f4", "f8"]
Arrays = Mapping[str, np.ndarray]


def create_points(
    path: str | Path,
    x: np.ndarray,
    point_data: Arrays | None = None,
    *,
    precision: Precision = "f4",
    attributes: Mapping[str, str | int] | None = None,
) -> None:
    """Create the file of the peridynamic points: a vertex cell at each point, no frames yet.

    Parameters
    ----------
    path : str or Path
        The file; an existing one is replaced.
    x : float, shape (n, 3), dimension length
        Reference positions; stored in double precision whatever ``precision`` is.
    point_data : dict of arrays, shape (n,) or (n, k), optional
        Fields that do not change, such as region and rank. Integers keep their type.
    precision : "f4" or "f8"
        How floating-point fields, also those of the frames, are stored.
    attributes : dict of str or int, optional
        Identity of the run (format and code version, hash of the deck), put on the root of the file.
    """
    vertices = np.arange(len(x))[:, None]
    _create(path, x, vertices, VERTEX, point_data or {}, {}, precision, attributes or {})


def create_elements(
    path: str | Path,
    nodes: np.ndarray,
    cells: np.ndarray,
    cell_data: Arrays | None = None,
    point_data: Arrays | None = None,
    *,
    precision: Precision = "f4",
    attributes: Mapping[str, str | int] | None = None,
) -> None:
    """Create the file of the finite elements: hexahedra, no frames yet.

    Parameters
    ----------
    path, precision, attributes
        As in `create_points`.
    nodes : float, shape (n, 3), dimension length
        Reference positions.
    cells : int, shape (m, 8)
        Rows of ``nodes`` in VTK's order: bottom quadrilateral counter-clockwise, then top.
    cell_data, point_data : dicts of arrays, shape (m,) or (m, k), and (n,) or (n, k), optional
        Fields that do not change, on elements and on nodes.
    """
    _create(path, nodes, cells, HEXAHEDRON, point_data or {}, cell_data or {}, precision, attributes or {})


def append_frame(
    path: str | Path,
    time: float,
    point_data: Arrays | None = None,
    cell_data: Arrays | None = None,
    field_data: Mapping[str, float] | None = None,
    digest: FrameDigest | None = None,
) -> None:
    """Append the fields at one time; the first frame decides which fields there are.

    Parameters
    ----------
    path : str or Path
        A file made by `create_points` or `create_elements`.
    time : float
        Shown by the viewer as time; it must rise, or the viewer finds the wrong frame.
    point_data, cell_data : dicts of arrays, shape (n,) or (n, k), optional
        Fields on points (or nodes) and on cells.
    field_data : dict of float, optional
        Numbers of the whole frame, such as the load factor; stored in double precision.
    digest : FrameDigest, optional
        Of the file so far; the frame is added to it when it is written.

    Raises
    ------
    ValueError
        A field has the wrong number of rows, the name of a static field, or is not in the earlier frames
        (or is missing here). The file still has its earlier frames.
    """
    with guarded(path, "r+") as file:
        root = file["VTKHDF"]
        steps = root["Steps"]
        frame = int(steps.attrs["NSteps"])
        if frame == 0:
            _cut(root, frame)
        stored: dict[str, np.ndarray] = {}
        numbers = {name: np.array([value], np.float64) for name, value in (field_data or {}).items()}
        for kind, fields in zip(KINDS, (point_data or {}, cell_data or {}, numbers), strict=True):
            group, offsets = root[kind], steps[kind + "Offsets"]
            if frame and set(fields) != set(offsets):
                raise ValueError(f"{path}: frame {frame} has {kind} {sorted(fields)}, earlier frames {sorted(offsets)}")
            rows = _checked(root, kind, fields, static=frame == 0)
            for name, values in rows.items():
                if frame == 0:
                    offsets.create_dataset(name, (0,), "i8", maxshape=(None,), chunks=(STEPS_PER_CHUNK,))
                    _create_field(group, name, values)
                _put(group, name, frame * len(values), values)
                _put(offsets, name, frame, np.array([frame * len(values)]))
                stored[f"{kind}/{name}"] = values
        for name, (shape, value) in STEP_ENTRIES.items():
            _put(steps, name, frame, np.full((1, *shape), value))
        _put(steps, "Values", frame, np.array([time], np.float64))
        file.flush()
        steps.attrs.modify("NSteps", np.int64(frame + 1))
    if digest is not None:
        digest.add_frame(time, {name: np.full(shape, value) for name, (shape, value) in STEP_ENTRIES.items()}, stored)


def digest_of(path: str | Path, n_frames: int = 0) -> FrameDigest:
    """Read a file and its first frames, and return their digest; errors as `read_frames.read_digest`."""
    return read_digest(path, n_frames, tuple(STEP_ENTRIES))


def frames(path: str | Path) -> int:
    """Return the number of complete frames in the file."""
    with h5py.File(path, "r", locking=False) as file:
        return int(file["VTKHDF/Steps"].attrs["NSteps"])


def has_numbers(path: str | Path) -> bool:
    """Whether the file is of a version that keeps the numbers of its frames."""
    with h5py.File(path, "r", locking=False) as file:
        return "FieldData" in file["VTKHDF"]


def frame_fields(path: str | Path, kind: Kind = "PointData") -> list[str]:
    """Names of the fields of points (or nodes), or of cells, that the frames have."""
    with h5py.File(path, "r", locking=False) as file:
        return sorted(file[f"VTKHDF/Steps/{kind}Offsets"])


def read_points(path: str | Path) -> np.ndarray:
    """Reference positions, float64, shape (n, 3)."""
    with h5py.File(path, "r", locking=False) as file:
        return file["VTKHDF/Points"][:]


def read_frame(path: str | Path, name: str, frame: int, kind: Kind = "PointData") -> np.ndarray:
    """A field of one frame, of points (or nodes) or of cells, shape (n,) or (n, k).

    Raises
    ------
    ValueError
        There is no such frame.
    """
    with h5py.File(path, "r", locking=False) as file:
        root = file["VTKHDF"]
        present = int(root["Steps"].attrs["NSteps"])
        if not 0 <= frame < present:
            raise ValueError(f"{path}: has {present} frames, and no frame {frame}")
        start = int(root[f"Steps/{kind}Offsets"][name][frame])
        return root[kind][name][start : start + int(root[COUNTS[kind]][0])]


def truncate(path: str | Path, n_frames: int) -> None:
    """Keep the first ``n_frames`` frames and drop the others.

    Raises
    ------
    ValueError
        The file has fewer frames; it is left as it was.
    """
    with guarded(path, "r+") as file:
        root = file["VTKHDF"]
        present = int(root["Steps"].attrs["NSteps"])
        if not 0 <= n_frames <= present:
            raise ValueError(f"{path}: has {present} frames, cannot be cut to {n_frames}")
        root["Steps"].attrs.modify("NSteps", np.int64(n_frames))
        file.flush()
        _cut(root, n_frames)


def _create(path, x, cells, cell_type, point_data, cell_data, precision, attributes) -> None:
    """Write geometry, static fields and empty ``Steps``."""
    n_cells, n_corners = cells.shape
    if cells.size and not 0 <= cells.min() <= cells.max() < len(x):
        raise ValueError(f"{path}: cells name nodes {cells.min()} to {cells.max()} of {len(x)}")
    with replacing(path) as temporary, guarded(temporary, "w") as file:
        file.attrs.update({"field_precision": precision, **attributes})
        root = file.create_group("VTKHDF")
        root.attrs["Version"] = np.array([2, 0])
        root.attrs["Type"] = np.bytes_("UnstructuredGrid")
        root["NumberOfPoints"] = np.array([len(x)])
        root["NumberOfCells"] = np.array([n_cells])
        root["NumberOfConnectivityIds"] = np.array([cells.size])
        root["Points"] = np.asarray(x, dtype="f8")
        root["Connectivity"] = np.asarray(cells, dtype="i8").ravel()
        root["Offsets"] = np.arange(0, cells.size + 1, n_corners)
        root["Types"] = np.full(n_cells, cell_type, dtype="u1")

        steps = root.create_group("Steps")
        steps.attrs["NSteps"] = np.int64(0)
        steps.create_dataset("Values", (0,), "f8", maxshape=(None,), chunks=(STEPS_PER_CHUNK,))
        for name, (shape, _) in STEP_ENTRIES.items():
            steps.create_dataset(name, (0, *shape), "i8", maxshape=(None, *shape), chunks=(STEPS_PER_CHUNK, *shape))
        for kind, fields in zip(KINDS, (point_data, cell_data, {}), strict=True):
            root.create_group(kind)
            steps.create_group(kind + "Offsets")
            for name, values in _checked(root, kind, fields, static=True).items():
                root[kind][name] = values


def _checked(root: h5py.Group, kind: str, fields: Arrays, static: bool) -> dict[str, np.ndarray]:
    """Fields of a kind in the types that are stored, after a check of shapes and, with ``static``, of names."""
    if not fields:
        return {}
    n_rows, precision, checked = rows_of(root, kind), root.file.attrs["field_precision"], {}
    for name, values in fields.items():
        if static and name in root[kind] and name not in root["Steps"][kind + "Offsets"]:
            raise ValueError(f"{root.file.filename}: {kind} {name} is a static field")
        values = np.asarray(values)
        if values.ndim not in (1, 2) or len(values) != n_rows:
            raise ValueError(f"{root.file.filename}: {kind} {name} has shape {values.shape}, needs {n_rows} rows")
        if values.dtype.kind == "f" and kind != "FieldData":
            values = values.astype(precision, copy=False)
        checked[name] = values.astype("u1") if values.dtype.kind == "b" else values
    return checked


def _create_field(group: h5py.Group, name: str, values: np.ndarray) -> None:
    """Create the dataset of a field over time, empty, in equal chunks of at most ``ROWS_PER_CHUNK`` rows."""
    n_chunks = -(-len(values) // ROWS_PER_CHUNK)
    chunk = max(1, -(-len(values) // max(1, n_chunks)))
    width = values.shape[1:]
    group.create_dataset(name, (0, *width), values.dtype, maxshape=(None, *width), chunks=(chunk, *width))


def _put(group: h5py.Group, name: str, start: int, values: np.ndarray) -> None:
    """Write rows of a dataset, which then ends behind them, through HDF5's own functions: they are quick."""
    dataset = h5py.h5d.open(group.id, name.encode())
    dataset.set_extent((start + len(values), *values.shape[1:]))
    if values.size:
        space = dataset.get_space()
        space.select_hyperslab((start, *(0 for _ in values.shape[1:])), values.shape)
        dataset.write(h5py.h5s.create_simple(values.shape), space, np.ascontiguousarray(values))


def _cut(root: h5py.Group, n_frames: int) -> None:
    """Shorten the arrays of ``Steps`` and the fields to ``n_frames``; with no frames, remove the fields."""
    steps = root["Steps"]
    for name in ("Values", *STEP_ENTRIES):
        steps[name].resize(n_frames, axis=0)
    for kind in KINDS:
        if kind not in root:
            continue  # files of earlier versions have no FieldData
        offsets, fields = steps[kind + "Offsets"], root[kind]
        for name in list(offsets):
            if n_frames:
                offsets[name].resize(n_frames, axis=0)
                fields[name].resize(n_frames * rows_of(root, kind), axis=0)
            else:
                fields.pop(name, None)
                del offsets[name]
