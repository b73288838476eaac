"""VTK XML files (.vtu): one piece of an unstructured grid."""

from __future__ import annotations

import re
from xml.etree import ElementTree

import numpy as np

from pdfem_mpi.mesh.raw import RawMesh, Refusal, excerpt
from pdfem_mpi.mesh.vtk_cells import add_cell_array, add_point_array, make_mesh, whole
from pdfem_mpi.mesh.vtk_data import COMPRESSORS, Coding, read_array

#: Nodes or cells beyond this are a false count.
LARGEST_COUNT = 2**40


def read_vtu(content: bytes) -> RawMesh:
    """Read the content of a file.

    Raises
    ------
    Refusal
    """
    piece, coding = _piece(content)
    n_points, n_cells = (_count(piece, f"NumberOf{what}") for what in ("Points", "Cells"))
    points = _array(piece, "Points", None, coding, 3 * n_points).astype(np.float64).reshape(-1, 3)
    types = whole(_array(piece, "Cells", "types", coding, n_cells), "the types of cells")
    offsets = whole(_array(piece, "Cells", "offsets", coding, n_cells), "the offsets of cells")
    size = int(offsets[-1]) if n_cells else 0
    if not 0 <= size <= LARGEST_COUNT:
        raise Refusal(f"the offsets of the cells end at {size}. Write the mesh again.")
    raw = make_mesh(
        points, types, offsets, whole(_array(piece, "Cells", "connectivity", coding, size), "nodes of cells")
    )
    for where, count, add in (("CellData", n_cells, add_cell_array), ("PointData", n_points, add_point_array)):
        for element in piece.iterfind(f"{where}/DataArray"):
            single = element.get("NumberOfComponents", "1") in ("", "0", "1")
            if single and element.get("type", "").lstrip("U").startswith("Int") and element.get("Name"):
                add(raw, element.get("Name"), read_array(element, coding, count))
    return raw


def read_point_field(content: bytes, name: str) -> tuple[np.ndarray, dict[str, np.ndarray]]:
    """Positions, float64, shape (n, 3), and the point data of one number by name; only the one of this name is read.

    The others are there as empty arrays, for who asks what there is.

    Raises
    ------
    Refusal
    """
    piece, coding = _piece(content)
    n_points = _count(piece, "NumberOfPoints")
    points = _array(piece, "Points", None, coding, 3 * n_points).astype(np.float64).reshape(-1, 3)
    fields = {}
    for element in piece.iterfind("PointData/DataArray"):
        if element.get("NumberOfComponents", "1") in ("", "0", "1") and element.get("Name"):
            wanted = element.get("Name") == name
            fields[element.get("Name")] = read_array(element, coding, n_points) if wanted else np.empty(0)
    return points, {word: np.asarray(values, np.float64) for word, values in fields.items()}


def _piece(content: bytes) -> tuple[ElementTree.Element, Coding]:
    """The one piece of a file, and how its arrays are written."""
    root, appended = _parse(content)
    grid = root.find("UnstructuredGrid")
    pieces = [] if grid is None else grid.findall("Piece")
    if len(pieces) != 1:
        raise Refusal(
            f"the file has {len(pieces)} pieces, and one is read. Merge them into one, with common nodes (in ParaView: "
            "Merge Blocks, Clean to Grid)."
        )
    return pieces[0], _coding(root, appended)


def _parse(content: bytes) -> tuple[ElementTree.Element, bytes]:
    """The XML without its appended data, and these."""
    appended = b""
    mark = re.search(rb"<AppendedData[^>]*>\s*_", content)
    if mark:
        end = content.rfind(b"</AppendedData>")
        if end < mark.end():
            raise Refusal("the appended data do not end. The file was cut off: write it again.")
        appended = content[mark.end() : end]
        content = content[: mark.end()] + content[end:]
    try:
        return ElementTree.fromstring(content), appended
    except ElementTree.ParseError as error:
        line, column = error.position
        raise Refusal(
            f"line {line}, column {column}: this is not XML ({str(error).split(':')[0]}). It was cut off or changed: "
            "write the mesh again."
        ) from None
    except (LookupError, ValueError) as error:
        raise Refusal(f"this is not XML ({excerpt(str(error))}). Write the mesh again.") from None


def _coding(root: ElementTree.Element, appended: bytes) -> Coding:
    order = {"LittleEndian": "<", "BigEndian": ">"}.get(root.get("byte_order", "LittleEndian"))
    header = {"UInt32": "u4", "UInt64": "u8"}.get(root.get("header_type", "UInt32"))
    compressor = root.get("compressor", "")
    if order is None or header is None or compressor not in COMPRESSORS:
        raise Refusal(
            f"byte order {excerpt(root.get('byte_order', ''))}, counts of type {excerpt(root.get('header_type', ''))} "
            "or "
            f"compressor {excerpt(compressor)} are not known. Write without compression, or with zlib."
        )
    data = root.find("AppendedData")
    return Coding(order, header, compressor, appended, data is not None and data.get("encoding") == "raw")


def _count(piece: ElementTree.Element, key: str) -> int:
    text = piece.get(key, "").strip()
    if not text.isdigit() or len(text) > 18 or int(text) > LARGEST_COUNT:
        raise Refusal(f"the piece has {key} = {excerpt(text)}. Write the mesh again.")
    return int(text)


def _array(piece: ElementTree.Element, table: str, name: str | None, coding: Coding, count: int) -> np.ndarray:
    for element in piece.iterfind(f"{table}/DataArray"):
        if name is None or element.get("Name") == name:
            return read_array(element, coding, count)
    raise Refusal(f"the piece has no array {name or 'of points'} in {table}. Write the mesh again.")
