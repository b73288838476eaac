"""Mesh files through meshio: hexahedra with their named sets, or every reason why not.

A set is a physical group (Gmsh), an *NSET or *ELSET (Abaqus), a node set, side set or element block (Exodus II); and in
any format the items of an integer array NAME with the value VALUE are the set ``NAME=VALUE``, which is how .vtu files
name sets. meshio leaves out the names of Exodus' blocks and its side sets; they are read here.
"""

from __future__ import annotations

import contextlib
import io
import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pdfem_mpi.deck.limits import LARGEST
from pdfem_mpi.deck.scene import MESH_SUFFIXES, FileMesh, SceneError, did_you_mean
from pdfem_mpi.mesh.abaqus import find_traps
from pdfem_mpi.mesh.hexmesh import FACES, HexMesh
from pdfem_mpi.system.plain_files import NotPlain, open_plain

FORMATS = {".msh": "gmsh", ".inp": "abaqus", ".vtu": "vtu", ".exo": "exodus", ".e": "exodus"}
NAMES = {"gmsh": "Gmsh", "abaqus": "Abaqus", "vtu": "VTK (.vtu)", "exodus": "Exodus II"}
#: Cells that may stand beside hexahedra: the faces, edges and corners of groups.
BESIDE = ("quad", "line", "vertex")
#: An integer array with more values than this numbers its items and makes no sets.
MOST_VALUES = 256
#: Rows of ``FACES`` of the sides 1 to 6 of an Exodus hexahedron.
EXODUS_SIDES = np.array([2, 1, 3, 0, 4, 5])
#: First bytes that are read to tell the format.
HEAD = 4096


class MeshFile(NamedTuple):
    """What a file holds: hexahedra in the file's order, and the number of each node in the file, from 0."""

    mesh: HexMesh
    node_number: np.ndarray


def read_mesh(entry: FileMesh) -> MeshFile:
    """Read the file of a deck's ``[mesh]`` table.

    Nodes that no hexahedron has are left out. What is wrong with the hexahedra themselves is told by ``defects.py``.

    Raises
    ------
    SceneError
        No such file, not readable, not of the format its suffix says, cells that are not hexahedra, coordinates that
        are not finite, no cells.
    """
    path = Path(entry.path)
    kind = FORMATS[next(suffix for suffix in MESH_SUFFIXES if path.name.lower().endswith(suffix))]
    if problems := _troubles(path, kind):
        raise SceneError([f'mesh.path = "{entry.path}": {problem}' for problem in problems])
    try:
        with contextlib.redirect_stderr(io.StringIO()), contextlib.redirect_stdout(io.StringIO()):
            raw, sets = _read(path, kind)
    except MemoryError:
        raise SceneError([f'mesh.path = "{entry.path}": does not fit into memory. Use a coarser mesh.']) from None
    except ImportError:
        raise SceneError(
            [
                f'mesh.path = "{entry.path}": Exodus II files need netCDF4, which is not installed. Install it '
                "with pip install 'pdfem_mpi[exodus]', or write the mesh in another format."
            ]
        ) from None
    except Exception as error:  # meshio raises what its parsers meet: KeyError, ValueError, IndexError, ...
        raise SceneError([f'mesh.path = "{entry.path}": {_unreadable(kind, error)}']) from None
    if problems := _refusals(raw) or _too_far(raw, entry.scale):
        raise SceneError([f'mesh.path = "{entry.path}": {problem}' for problem in problems])
    return _convert(raw, sets, entry.scale)


# --- is it there, and is it what its suffix says? -----------------------------------------------------------


def _troubles(path: Path, kind: str) -> list[str]:
    """Why a file cannot be what the deck says, or what of it would be misread."""
    try:
        with open_plain(path) as file:
            head = file.read(HEAD)
    except FileNotFoundError:
        near = [str(other) for suffix in MESH_SUFFIXES for other in path.parent.glob(f"*{suffix}")]
        remedy = did_you_mean(path, near) or " Give its path relative to the folder of the deck."
        return [f"there is no such file.{remedy}"]
    except IsADirectoryError:
        return ["this is a folder. Give a mesh file in it."]
    except NotPlain as error:
        return [f"{error.strerror}. Give a mesh file."]
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        return [f"cannot be read: {reason}. Give a file that this user may read."]
    if not head.strip():
        return ["the file is empty. Write the mesh again."]
    found = _sniff(head)
    if found != kind:
        suffixes = " or ".join(suffix for suffix, name in FORMATS.items() if name == found)
        remedy = f"It is {NAMES[found]}: rename it to {suffixes}." if found else "Give a mesh file."
        return [f"its content is not {NAMES[kind]}, as its suffix says. {remedy}"]
    if kind == "abaqus":
        with path.open(encoding="utf-8", errors="replace") as file:
            return [f"the file {trap}" for trap in find_traps(file)]
    if kind == "vtu":
        with path.open("rb") as file:
            pieces = sum(line.count(b"<Piece") for line in file)
        if pieces > 1:
            return [f"the file has {pieces} pieces, of which only the last is read. Merge them into one."]
    return []


def _sniff(head: bytes) -> str:
    """Format of a file by its first bytes, or an empty string."""
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if text.startswith((b"$MeshFormat", b"$Comments")):
        return "gmsh"
    if head.startswith((b"CDF\x01", b"CDF\x02", b"CDF\x05", b"\x89HDF\r\n")):
        return "exodus"
    if b"<VTKFile" in head and b"UnstructuredGrid" in head:
        return "vtu"
    if b"\0" not in head and re.search(rb"(?im)^\*(\*|\s*(heading|node|part|element|include|preprint)\b)", head):
        return "abaqus"
    return ""


def _unreadable(kind: str, error: Exception) -> str:
    if "gmsh:physical" in str(error):
        return (
            "some of its volumes, surfaces or curves are in a physical group and others are not, which cannot be read. "
            "Put all into groups, or save only those in groups (Gmsh's Mesh.SaveAll = 0)."
        )
    reason = " ".join(str(error).split())[:120] or "no reason given"
    return f"cannot be read as {NAMES[kind]} ({type(error).__name__}: {reason}). It may be cut off: write it again."


# --- reading ------------------------------------------------------------------------------------------------


class _Sets(NamedTuple):
    """Named sets: numbers of cells of each block by name, nodes by name, nodes of faces by name."""

    cells: dict[str, list[np.ndarray]]
    nodes: dict[str, np.ndarray]
    faces: dict[str, np.ndarray]


def _read(path: Path, kind: str):
    """The file as meshio has it, and its named sets."""
    import meshio

    raw = {
        "gmsh": meshio.gmsh.read,
        "abaqus": meshio.abaqus.read,
        "vtu": meshio.vtu.read,
        "exodus": meshio.exodus.read,
    }[kind](str(path))
    sets = _Sets({}, {}, {})
    if kind == "exodus":
        _add_exodus_sets(path, sets)
    else:
        sets.nodes.update({name: np.asarray(members, np.int64) for name, members in raw.point_sets.items()})
    for name, members in raw.cell_sets.items():
        if name != "gmsh:bounding_entities":
            sets.cells[name] = [
                np.asarray(members[k] if k < len(members) and members[k] is not None else [], np.int64)
                for k in range(len(raw.cells))
            ]
    tags = raw.cell_data.get("gmsh:physical")
    for name, (tag, dimension) in raw.field_data.items() if tags else ():  # versions before 4.1 have no sets
        if name not in sets.cells:
            sets.cells[name] = [
                np.flatnonzero((tag_of == tag) & (block.dim == dimension))
                for tag_of, block in zip(tags, raw.cells, strict=True)
            ]
    for array, values in raw.cell_data.items():
        for name, value in _values(array, np.concatenate(values) if values else np.empty(0)):
            sets.cells.setdefault(name, [np.flatnonzero(part == value) for part in values])
    for array, values in raw.point_data.items():
        for name, value in _values(array, values):
            sets.nodes.setdefault(name, np.flatnonzero(values == value))
    return raw, sets


def _values(array: str, values: np.ndarray) -> list[tuple[str, int]]:
    """Names of the sets that an integer array makes, and the value of each.

    meshio writes sets a and b to formats without sets as an array ``a-b`` with the values 0 and 1: these are the sets a
    and b as well.
    """
    if values.ndim != 1 or values.dtype.kind not in "iu":
        return []
    distinct = np.unique(values)
    if len(distinct) > MOST_VALUES:
        return []
    sets = [(f"{array}={value}", int(value)) for value in distinct]
    for mark in "-_#+/":
        parts = array.split(mark)
        if np.array_equal(distinct[distinct >= 0], np.arange(len(parts))):
            sets += [(name, value) for value, name in enumerate(parts)]
            break
    return sets


def _add_exodus_sets(path: Path, sets: _Sets) -> None:
    """Element blocks and node sets by their names, and side sets as faces; meshio has some of these only."""
    import netCDF4

    with netCDF4.Dataset(str(path)) as file:
        file.set_auto_mask(False)
        table = {key: values for key, values in file.variables.items() if re.fullmatch(r"[a-z_]+\d+", key)}
        blocks = [key for key in table if re.fullmatch(r"connect\d+", key)]  # in meshio's order
        sizes = [len(table[key]) for key in blocks]
        for k, key in enumerate(blocks):
            name = _exodus_name(file, "eb", "block", key)
            sets.cells[name] = [np.arange(size if j == k else 0) for j, size in enumerate(sizes)]
        for key in (key for key in table if key.startswith("node_ns")):
            sets.nodes[_exodus_name(file, "ns", "nodelist", key)] = table[key][:].astype(np.int64) - 1
        if any(table[key].shape[1] != 8 for key in blocks):
            return  # sides of other cells are numbered otherwise
        numbered = sorted(blocks, key=lambda key: int(key.removeprefix("connect")))
        nodes = np.concatenate([table[key][:].astype(np.int64) for key in numbered]) - 1
        for key in (key for key in table if key.startswith("elem_ss")):
            cell = table[key][:].astype(np.int64) - 1
            side = EXODUS_SIDES[table[key.replace("elem", "side")][:].astype(np.int64) - 1]
            sets.faces[_exodus_name(file, "ss", "surface", key)] = nodes[cell[:, None], FACES[side]]


def _exodus_name(file, kind: str, word: str, key: str) -> str:
    """Name of the block or set behind a variable like ``connect2``; without one, ``block_ID``."""
    place = int(re.sub(r"\D", "", key)) - 1
    name = b""
    if f"{kind}_names" in file.variables:
        name = b"".join(file.variables[f"{kind}_names"][place]).split(b"\0")[0].strip()
    if name:
        return name.decode("utf-8", "replace")
    ids = file.variables.get(f"{kind}_prop1")
    return f"{word}_{place + 1 if ids is None else int(ids[place])}"


# --- from meshio's mesh to ours -----------------------------------------------------------------------------


def _refusals(raw) -> list[str]:
    """What keeps a file from being a mesh of hexahedra."""
    problems = []
    points = np.asarray(raw.points)
    if points.ndim != 2 or points.shape[1] != 3:
        return ["its nodes do not have three coordinates. Write a mesh in space."]
    others: dict[str, int] = {}
    first: dict[str, np.ndarray] = {}
    hexahedra = 0
    for block in raw.cells:
        if block.type == "hexahedron":
            hexahedra += len(block)
        elif block.type not in BESIDE and len(block):
            others[block.type] = others.get(block.type, 0) + len(block)
            first.setdefault(block.type, np.asarray(block.data[0]).reshape(-1))
        if not block.type.startswith("polyhedron") and len(block):
            data = np.asarray(block.data)
            wrong = ((data < 0) | (data >= len(points))).any(axis=1)
            if wrong.any():
                problems.append(
                    f"{np.count_nonzero(wrong)} cells ({block.type}) name nodes that the file does not have, the first "
                    f"cell {np.flatnonzero(wrong)[0]}. Write the mesh again."
                )
    if problems:
        return problems
    if others:
        counts = ", ".join(f"{count} of type {name}" for name, count in sorted(others.items()))
        places = ", ".join(f"a {name} at {_place(points[first[name]].mean(axis=0))}" for name in sorted(others))
        problems.append(
            f"the mesh has cells that are not hexahedra of eight nodes: {counts} beside {hexahedra} hexahedra; the "
            f"first are {places}. Mesh the body with hexahedra of first order (in Gmsh: transfinite volumes, "
            "Recombine, ElementOrder = 1)."
        )
    elif not hexahedra:
        problems.append(
            "the mesh has no hexahedra. In Gmsh, put the volumes into physical groups, or set Mesh.SaveAll = 1."
        )
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        problems.append(
            f"{len(bad)} nodes have coordinates that are not finite, the first node {bad[0]} at "
            f"{_place(points[bad[0]])}. Write the mesh again."
        )
    return problems


def _too_far(raw, scale: float) -> list[str]:
    """Coordinates whose products would not be finite."""
    points, most = np.asarray(raw.points), LARGEST / max(scale, 1.0)
    far = np.flatnonzero((np.abs(points) >= most).any(axis=1))
    if not len(far):
        return []
    return [
        f"{len(far)} nodes have coordinates beyond {most:g}, where products are not finite, the first node {far[0]} at "
        f"{_place(points[far[0]])}. Write the mesh again, or scale it."
    ]


def _place(x: np.ndarray) -> str:
    return f"({', '.join(f'{c:.6g}' for c in x)})"


def _convert(raw, sets: _Sets, scale: float) -> MeshFile:
    """Hexahedra of all blocks in the file's order, without orphan nodes."""
    solid = [k for k, block in enumerate(raw.cells) if block.type == "hexahedron"]
    cells = np.concatenate([np.asarray(raw.cells[k].data, np.int64) for k in solid])
    start = np.cumsum([0] + [len(raw.cells[k]) for k in solid])
    used = np.zeros(len(raw.points), bool)
    used[cells] = True
    number = np.where(used, np.cumsum(used) - 1, -1)

    cell_sets, face_sets, node_sets = {}, {}, {}
    for name, members in sets.nodes.items():
        kept = number[members]
        node_sets[name] = np.unique(kept[kept >= 0])
    for name, faces in sets.faces.items():
        face_sets[name] = number[np.asarray(faces, np.int64)].astype(np.int32)
    for name, of_blocks in sets.cells.items():
        chosen = np.concatenate([start[j] + of_blocks[k] for j, k in enumerate(solid)])
        if len(chosen):
            cell_sets[name] = np.unique(chosen)
        for kind, table in (("quad", face_sets), ("line", node_sets), ("vertex", node_sets)):
            rows = [
                np.asarray(block.data, np.int64)[of_blocks[k]]
                for k, block in enumerate(raw.cells)
                if block.type == kind and len(of_blocks[k])
            ]
            if rows and name not in table:
                found = number[np.concatenate(rows)]
                table[name] = found.astype(np.int32) if kind == "quad" else np.unique(found[found >= 0])
    nodes = np.asarray(raw.points, np.float64)[used] * scale + 0.0  # no -0.0: it would be another content
    mesh = HexMesh(nodes, number[cells].astype(np.int32), cell_sets, face_sets, node_sets)
    return MeshFile(mesh, np.flatnonzero(used))
