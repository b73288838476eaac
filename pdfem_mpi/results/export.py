"""Frames for other programs: VTU files with a PVD list of their times, and tables of text."""

from __future__ import annotations

import base64
import csv
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path
from xml.sax.saxutils import quoteattr

import h5py
import numpy as np

from pdfem_mpi.system.files import replacing

PARTS = ("body", "points", "elements")
_VTK_TYPES = {"f4": "Float32", "f8": "Float64", "i4": "Int32", "i8": "Int64", "i2": "Int16", "u1": "UInt8"}
_COLLECTION = (
    '<?xml version="1.0"?>',
    '<VTKFile type="Collection" version="0.1" byte_order="LittleEndian">',
    "  <Collection>",
)
COMPONENTS = "xyz"


class NotExported(Exception):
    """What cannot be exported; the sentence has the remedy."""


@dataclass(frozen=True)
class Part:
    """A file of frames, open to be read frame by frame.

    Attributes
    ----------
    root : h5py.Group
    n_frames : int
    """

    root: h5py.Group
    n_frames: int

    def fields(self, kind: str, frame: int) -> dict[str, np.ndarray]:
        """Fields on points (``"PointData"``) or cells of one frame, static ones included."""
        offsets = self.root[f"Steps/{kind}Offsets"]
        rows = int(self.root["NumberOfPoints" if kind == "PointData" else "NumberOfCells"][0])
        found = {}
        for name, table in self.root[kind].items():
            first = int(offsets[name][frame]) if name in offsets else 0
            found[name] = table[first : first + rows]
        return found

    @property
    def times(self) -> np.ndarray:
        """Row of the history of each frame, from 1."""
        return self.root["Steps/Values"][: self.n_frames]


def parts_of(folder: Path, wanted: Sequence[str] = PARTS) -> dict[str, Path]:
    """Files of frames of a run folder, by part."""
    found = {name: folder / f"{name}.vtkhdf" for name in wanted}
    return {name: path for name, path in found.items() if path.is_file()}


def export_pvd(folder: Path, out: Path) -> Iterator[Path]:
    """Write every frame of every part as a VTU file, and a PVD list for each part; the files as they are written.

    Older versions of ParaView, VisIt and meshio read these. Open ``body.pvd``, or the parts one by one.
    """
    for name, source in parts_of(folder).items():
        entries = []
        with h5py.File(source, "r", locking=False) as file:
            part = Part(file["VTKHDF"], int(file["VTKHDF/Steps"].attrs["NSteps"]))
            for frame, time in enumerate(part.times):
                path = out / f"{name}-{frame + 1:05d}.vtu"
                write_vtu(path, part, frame)
                entries.append(f'    <DataSet timestep="{time:g}" part="0" file={quoteattr(path.name)}/>')
                yield path
        _write(out / f"{name}.pvd", "\n".join([*_COLLECTION, *entries, "  </Collection>", "</VTKFile>", ""]))
        yield out / f"{name}.pvd"


def write_vtu(path: Path, part: Part, frame: int) -> None:
    """Write one frame as an XML file of VTK, with data in base64."""
    root = part.root
    kinds = root["Types"][:]
    lines = [
        '<?xml version="1.0"?>',
        '<VTKFile type="UnstructuredGrid" version="1.0" byte_order="LittleEndian" header_type="UInt64">',
        "  <UnstructuredGrid>",
        f'    <Piece NumberOfPoints="{len(root["Points"])}" NumberOfCells="{len(kinds)}">',
    ]
    for kind in ("PointData", "CellData"):
        arrays = [_array(name, values) for name, values in part.fields(kind, frame).items()]
        lines += [f"      <{kind}>", *arrays, f"      </{kind}>"]
    lines += ["      <Points>", _array("Points", root["Points"][:]), "      </Points>", "      <Cells>"]
    lines += [
        _array("connectivity", root["Connectivity"][:]),
        _array("offsets", root["Offsets"][1:]),
        _array("types", kinds),
    ]
    lines += ["      </Cells>", "    </Piece>", "  </UnstructuredGrid>", "</VTKFile>", ""]
    _write(path, "\n".join(lines))


def export_csv(folder: Path, out: Path, frame: int = -1) -> Iterator[Path]:
    """Write one frame of points and nodes as tables: place, displacement and what else the frame holds.

    Raises
    ------
    NotExported
        There is no such frame.
    """
    for name, source in parts_of(folder, ("points", "elements")).items():
        with h5py.File(source, "r", locking=False) as file:
            part = Part(file["VTKHDF"], int(file["VTKHDF/Steps"].attrs["NSteps"]))
            if not -part.n_frames <= frame < part.n_frames:
                raise NotExported(f"{source} has no frame {frame}: they count from 0 to {part.n_frames - 1}.")
            fields = part.fields("PointData", frame % part.n_frames)
            columns = dict(zip(COMPONENTS, part.root["Points"][:].T, strict=True)) | dict(_columns(fields))
        path = out / ("points.csv" if name == "points" else "nodes.csv")
        with replacing(path) as temporary, open(temporary, "w", newline="", encoding="utf-8") as file:
            writer = csv.writer(file, lineterminator="\n")
            writer.writerow(columns)
            writer.writerows(zip(*(values.tolist() for values in columns.values()), strict=True))
        yield path


def _columns(fields: dict[str, np.ndarray]) -> Iterator[tuple[str, np.ndarray]]:
    """One column for a number, one for each component of a vector."""
    for name, values in fields.items():
        if values.ndim == 1:
            yield name, values
        else:
            ends = COMPONENTS if values.shape[1] == 3 else range(values.shape[1])
            yield from ((f"{name}_{end}", values[:, k]) for k, end in enumerate(ends))


def _array(name: str, values: np.ndarray) -> str:
    values = np.ascontiguousarray(values)
    values = values.astype(values.dtype.newbyteorder("<"), copy=False)
    if values.dtype.str[1:] not in _VTK_TYPES:
        values = values.astype("<i8" if values.dtype.kind in "iu" else "<f8")
    content = base64.b64encode(np.uint64(values.nbytes).tobytes() + values.tobytes()).decode()
    components = values.shape[1] if values.ndim == 2 else 1
    kind = _VTK_TYPES[values.dtype.str[1:]]
    head = f'        <DataArray type="{kind}" Name={quoteattr(name)} NumberOfComponents="{components}" format="binary">'
    return f"{head}{content}</DataArray>"


def _write(path: Path, text: str) -> None:
    with replacing(path) as temporary:
        Path(temporary).write_text(text, encoding="utf-8")
