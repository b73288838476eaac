"""Mesh files: hexahedra with their named sets, or every reason why not.

A set is a physical group (Gmsh), an *NSET, *ELSET or *SURFACE (Abaqus), a node set, side set or element block (Exodus
II); in Gmsh and VTK files the items of an integer array NAME with the value VALUE are the set ``NAME=VALUE``, which is
how VTK files name sets. Each format is read by code that takes every line or refuses it: nothing is dropped in silence.
"""

from __future__ import annotations

import re
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pdfem_mpi.deck.meshes import MESH_SUFFIXES, FileMesh
from pdfem_mpi.deck.table import SceneError, did_you_mean
from pdfem_mpi.mesh.formats import read_format
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.mesh.merge import merge_nodes
from pdfem_mpi.mesh.names import FoldedNames
from pdfem_mpi.mesh.raw import Block, RawMesh, Refusal, excerpt
from pdfem_mpi.system.plain_files import NotPlain, open_plain

FORMATS = {
    ".msh": "gmsh", ".inp": "abaqus", ".vtu": "vtu", ".vtk": "vtk",
    ".exo": "exodus", ".e": "exodus", ".ex2": "exodus", ".g": "exodus", ".gen": "exodus",
}  # fmt: skip
NAMES = {"gmsh": "Gmsh", "abaqus": "Abaqus", "vtu": "VTK (.vtu)", "vtk": "VTK (.vtk)", "exodus": "Exodus II"}
#: Cells beside hexahedra that make sets: the faces, edges and corners of groups.
MAKE_SETS = ("quad", "line", "vertex")
#: Coordinates beyond this have no squares and cubes in double precision.
LARGEST_COORDINATE = 1e50
#: First bytes that are read to recognise the format.
HEAD = 4096
#: Names that a note lists.
LISTED = 6


class MeshFile(NamedTuple):
    """What a file holds: hexahedra in the file's order, and the number of each node in the file, from 0."""

    mesh: HexMesh
    node_number: np.ndarray


def read_mesh(entry: FileMesh) -> MeshFile:
    """Read the file of a deck's ``[mesh]`` table.

    Nodes that no hexahedron has are left out, and what else was left out by intention is in the mesh's notes. What is
    wrong with the hexahedra themselves is found by ``defects.py``.

    Raises
    ------
    SceneError
        No such file, not readable, not of the format its suffix says, a line that cannot be read, cells that are not
        hexahedra, coordinates that are not finite, no cells.
    """
    path = Path(entry.path)
    kind = FORMATS[next(suffix for suffix in MESH_SUFFIXES if path.name.lower().endswith(suffix))]
    if problem := _trouble(path, kind):
        raise SceneError([f'mesh.path = "{entry.path}": {problem}'])
    try:
        raw = read_format(path, kind)
    except Refusal as refusal:
        raise SceneError([f'mesh.path = "{entry.path}": {message}' for message in refusal.messages]) from None
    except MemoryError:
        raise SceneError(
            [
                f'mesh.path = "{entry.path}": what it declares does not fit into memory. Use a coarser mesh, or write '
                "it "
                "again if its counts are wrong."
            ]
        ) from None
    except ImportError:
        raise SceneError(
            [
                f'mesh.path = "{entry.path}": Exodus II files need netCDF4, which is not installed. Install it '
                "with pip install netCDF4, or write the mesh in another format."
            ]
        ) from None
    if problems := _refusals(raw, kind, entry.scale):
        raise SceneError([f'mesh.path = "{entry.path}": {problem}' for problem in problems])
    file = _convert(raw, entry.scale)
    return file if entry.merge is None else MeshFile(*merge_nodes(*file, entry.merge))


# --- is it there, and is it what its suffix says? -----------------------------------------------------------


def _trouble(path: Path, kind: str) -> str:
    """Why a file cannot be what the deck says; empty if it can."""
    try:
        with open_plain(path) as file:
            head = file.read(HEAD)
    except FileNotFoundError:
        near = [str(other) for suffix in MESH_SUFFIXES for other in path.parent.glob(f"*{suffix}")]
        remedy = did_you_mean(path, near) or " Give its path relative to the folder of the deck."
        return f"there is no such file.{remedy}"
    except IsADirectoryError:
        return "this is a folder. Give a mesh file in it."
    except NotPlain as error:
        return f"{error.strerror}. Give a mesh file."
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        return f"cannot be read: {reason}. Give a file that this user may read."
    if not head.strip():
        return "the file is empty. Write the mesh again."
    found = _sniff(head)
    if found == kind:
        return ""
    if not found and (grid := re.search(rb'<VTKFile[^>]*type\s*=\s*"(\w+)"', head)):
        return f"it is a VTK file of {excerpt(grid[1])}, and unstructured grids (.vtu) are read. Write it as one."
    suffixes = " or ".join(suffix for suffix, name in FORMATS.items() if name == found)
    remedy = f"It is {NAMES[found]}: rename it to {suffixes}." if found else "Give a mesh file."
    return f"its content is not {NAMES[kind]}, as its suffix says. {remedy}"


def _sniff(head: bytes) -> str:
    """Format of a file by its first bytes, or an empty string."""
    text = head.lstrip(b"\xef\xbb\xbf \t\r\n")
    if text.startswith((b"$MeshFormat", b"$Comments")):
        return "gmsh"
    if head.startswith((b"CDF\x01", b"CDF\x02", b"CDF\x05", b"\x89HDF\r\n")):
        return "exodus"
    if b"<VTKFile" in head and b"UnstructuredGrid" in head:
        return "vtu"
    if text[:40].lower().startswith(b"# vtk datafile"):
        return "vtk"
    if b"\0" not in head and re.search(rb"(?im)^[ \t]*\*(\*|\s*(heading|node|part|element|include|preprint)\b)", head):
        return "abaqus"
    return ""


# --- from the file's content to a mesh of hexahedra ---------------------------------------------------------


def _refusals(raw: RawMesh, kind: str, scale: float) -> list[str]:
    """What keeps a file from being a mesh of hexahedra."""
    points = raw.points
    problems = []
    for block in raw.blocks:
        wrong = ((block.nodes < 0) | (block.nodes >= len(points))).any(axis=1)
        if wrong.any():
            problems.append(
                f"{np.count_nonzero(wrong)} cells ({block.kind}) name nodes that the file does not have, the first "
                f"cell {np.flatnonzero(wrong)[0]}. Write the mesh again."
            )
    if problems:
        return problems
    solids = [block for block in raw.blocks if block.dimension == 3 and len(block.nodes)]
    hexahedra = sum(len(block.nodes) for block in solids if block.kind == "hexahedron")
    others = [block for block in solids if block.kind != "hexahedron"]
    if others:
        problems.append(
            f"the mesh has cells that are not hexahedra of eight nodes: {_tally(others)} beside {hexahedra} hexahedra; "
            f"the first are {_first_places(points, others)}. Mesh the body with hexahedra of first order (in Gmsh: "
            "transfinite volumes, Recombine, ElementOrder = 1)."
        )
    elif not hexahedra:
        problems.append(_no_hexahedra(raw, kind))
    bad = np.flatnonzero(~np.isfinite(points).all(axis=1))
    if len(bad):
        problems.append(
            f"{len(bad)} nodes have coordinates that are not finite, the first node {bad[0]} at "
            f"{_place(points[bad[0]])}. Write the mesh again."
        )
    far = np.flatnonzero((np.abs(points) > LARGEST_COORDINATE / max(scale, 1.0)).any(axis=1))
    if len(far) and not len(bad):
        problems.append(
            f"{len(far)} nodes have coordinates beyond {LARGEST_COORDINATE:g}, the first node {far[0]} at "
            f"{_place(points[far[0]])}{'' if scale == 1.0 else f', times mesh.scale = {scale:g}'}. Write the mesh in "
            "other units."
        )
    return problems


def _tally(blocks: list[Block]) -> str:
    """How many cells of each kind."""
    count: dict[str, int] = {}
    for block in blocks:
        count[block.kind] = count.get(block.kind, 0) + len(block.nodes)
    return ", ".join(f"{number} of type {name}" for name, number in sorted(count.items()))


def _first_places(points: np.ndarray, blocks: list[Block]) -> str:
    """The first cell of each kind, and where it is."""
    first: dict[str, Block] = {}
    for block in blocks:
        first.setdefault(block.kind, block)
    places = []
    for name, block in sorted(first.items()):
        at = f" at {_place(points[block.nodes[0]].mean(axis=0))}" if block.nodes.size else ""
        places.append(f"a {name}{at} ({block.called})")
    return ", ".join(places)


def _no_hexahedra(raw: RawMesh, kind: str) -> str:
    blocks = [block for block in raw.blocks if len(block.nodes)]
    has = f", only {_tally(blocks)}" if blocks else ", and no other cells"
    if kind == "gmsh":
        grouped = any(not name.startswith("gmsh:geometrical") for name in raw.cells)
        remedy = "Mesh the volume with hexahedra (transfinite, Recombine)" + (
            ", and put it into a physical group as well, or set Mesh.SaveAll = 1." if grouped else "."
        )
    elif blocks and all(block.dimension == 0 for block in blocks):
        remedy = "Points with a volume each make no body here: mesh it with hexahedra."
    else:
        remedy = "Mesh the volume with hexahedra of eight nodes."
    return f"the mesh has no hexahedra{has}. {remedy}"


def _place(x: np.ndarray) -> str:
    return f"({', '.join(f'{c:.6g}' for c in x)})"


def _convert(raw: RawMesh, scale: float) -> MeshFile:
    """Hexahedra of all blocks in the file's order, without nodes that none of them has."""
    solid = [k for k, block in enumerate(raw.blocks) if block.kind == "hexahedron"]
    cells = np.concatenate([raw.blocks[k].nodes for k in solid])
    start = np.cumsum([0] + [len(raw.blocks[k].nodes) for k in solid])
    used = np.zeros(len(raw.points), bool)
    used[cells] = True
    number = np.where(used, np.cumsum(used) - 1, -1)

    table = FoldedNames if raw.folded else dict
    cell_sets, face_sets, node_sets = table(), table(), table()
    losers = {name for name, members in raw.nodes.items() if (number[members] < 0).any()}
    for name, members in raw.nodes.items():
        node_sets[name] = _on_body(number[members])
    for name, faces in raw.faces.items():
        face_sets[name] = number[faces].astype(np.int32)
    for name, of_blocks in raw.cells.items():
        kinds = {block.kind for block, members in zip(raw.blocks, of_blocks, strict=True) if len(members)}
        if "hexahedron" in kinds or not kinds.intersection(MAKE_SETS):  # a set without members is one all the same
            cell_sets[name] = np.unique(np.concatenate([start[j] + of_blocks[k] for j, k in enumerate(solid)]))
        if "quad" in kinds and name not in face_sets:
            face_sets[name] = number[_members(raw, of_blocks, ("quad",), 4)].astype(np.int32)
        if kinds.intersection(("line", "vertex")) and name not in node_sets:
            found = [number[_members(raw, of_blocks, (k,), n)].reshape(-1) for k, n in (("line", 2), ("vertex", 1))]
            node_sets[name] = _on_body(np.concatenate(found))
    nodes = np.asarray(raw.points, np.float64)[used] * scale + 0.0  # no -0.0: it would be another content
    notes = (*raw.notes, *_what_is_beside(raw), *_what_sets_lose(raw), *_what_is_off(used, losers))
    mesh = HexMesh(nodes, number[cells].astype(np.int32), cell_sets, face_sets, node_sets, notes)
    return MeshFile(mesh, np.flatnonzero(used))


def _members(raw: RawMesh, of_blocks: list[np.ndarray], kinds: tuple[str, ...], width: int) -> np.ndarray:
    """Nodes of the members of a set that are of some kinds; int64, shape (n, width)."""
    rows = [block.nodes[members] for block, members in zip(raw.blocks, of_blocks, strict=True) if block.kind in kinds]
    return np.concatenate([np.empty((0, width), np.int64), *rows])


def _what_is_beside(raw: RawMesh) -> list[str]:
    """Cells beside the hexahedra, with their number."""
    beside: dict[str, list[Block]] = {}
    for block in raw.blocks:
        if block.dimension < 3 and len(block.nodes):
            beside.setdefault(block.kind, []).append(block)
    notes = []
    for kind, blocks in beside.items():
        cells = f"{sum(len(block.nodes) for block in blocks)} cells of type {kind} ({blocks[0].called})"
        makes = f"{cells} beside the hexahedra carry nothing; sets are made of them"
        notes.append(makes if kind in MAKE_SETS else f"left out {cells}: they carry nothing here")
    return notes


def _what_sets_lose(raw: RawMesh) -> list[str]:
    """Sets with members of kinds that make no sets."""
    names = [
        name
        for name, of_blocks in raw.cells.items()
        if any(
            len(members) and block.dimension < 3 and block.kind not in MAKE_SETS
            for block, members in zip(raw.blocks, of_blocks, strict=True)
        )
    ]
    return [f"members of these kinds are left out of the sets {_listed(names)}"] if names else []


def _on_body(numbers: np.ndarray) -> np.ndarray:
    return np.unique(numbers[numbers >= 0])


def _listed(names: list[str]) -> str:
    return ", ".join(names[:LISTED]) + (f" and {len(names) - LISTED} more" if len(names) > LISTED else "")


def _what_is_off(used: np.ndarray, losers: set[str]) -> list[str]:
    """Nodes that no hexahedron has, and the sets that lose some."""
    off = int(np.count_nonzero(~used))
    if not off:
        return []
    of_sets = f"; the sets {_listed(sorted(losers))} have some" if losers else ""
    return [f"left out {off} nodes that no hexahedron has{of_sets}"]
