"""Gmsh files of the formats 2.2, 4.0 and 4.1, in text and binary: cells, and groups by their dimension and name.

A physical group of volumes is a set of cells, of surfaces one of faces, of curves and points one of nodes; groups of
several dimensions may share a name. ``gmsh:physical=3`` and ``gmsh:geometrical=3`` are the sets of those tags. What a
section declares must be there, and nothing more.
"""

from __future__ import annotations

import re
from dataclasses import dataclass, field

import numpy as np

from pdfem_mpi.mesh.gmsh_elements import (
    TYPES,
    Rows,
    read_elements_2,
    read_elements_4,
    read_nodes_2,
    read_nodes_4,
)
from pdfem_mpi.mesh.gmsh_entities import Entities, read_entities
from pdfem_mpi.mesh.gmsh_numbers import BinaryNumbers, TextNumbers
from pdfem_mpi.mesh.raw import MOST_VALUES, Block, RawMesh, Refusal, excerpt, places_of, repeated

FIRST_ORDER = {"line": 2, "triangle": 3, "quad": 4, "tetra": 4, "hexahedron": 8, "wedge": 6, "pyramid": 5, "vertex": 1}
VERSIONS = {"2.2": 22, "2": 22, "2.1": 22, "4": 40, "4.0": 40, "4.1": 41}
#: Sections that hold the mesh, and those that may be passed over.
MESH_SECTIONS = ("PhysicalNames", "Entities", "PartitionedEntities", "Nodes", "Elements")


@dataclass
class _Content:
    """What the sections of a file have given."""

    names: dict[tuple[int, int], str] = field(default_factory=dict)
    entities: Entities | None = None
    numbers: np.ndarray | None = None
    points: np.ndarray | None = None
    rows: list[Rows] | None = None


def read_gmsh(content: bytes) -> RawMesh:
    """Read the content of a file.

    Raises
    ------
    Refusal
        With the line or the byte, what was found and what to do.
    """
    version, binary, swapped, place = _format(content)
    found = _Content()
    while (start := content.find(b"$", place)) >= 0:
        end_of_line = content.find(b"\n", start)
        end_of_line = len(content) if end_of_line < 0 else end_of_line
        name = content[start + 1 : end_of_line].strip().decode("utf-8", "replace")
        if content[place:start].strip() or not re.fullmatch(r"[A-Za-z]\w*", name):
            raise Refusal(f"line {_line(content, place)}: what stands here is no section. Write the mesh again.")
        inside = end_of_line + 1
        end = content.find(b"$End" + name.encode(), inside)
        if end < 0:
            raise Refusal(
                f"line {_line(content, start)}: the section ${name} does not end. The file was cut off: write it again."
            )
        if name in MESH_SECTIONS:
            if name == "PhysicalNames":
                found.names = _names(content[inside:end], _line(content, inside))
            else:
                numbers = (
                    BinaryNumbers(f"${name}", content, inside, swapped)
                    if binary
                    else TextNumbers(f"${name}", content[inside:end], _line(content, inside))
                )
                _section(name, numbers, version, found)
                numbers.finish()
                end = content.find(b"$End" + name.encode(), numbers.place) if binary else end
        place = end + len(name) + 4
    return _assemble(found)


def _line(content: bytes, place: int) -> int:
    return content.count(b"\n", 0, place) + 1


def _format(content: bytes) -> tuple[int, bool, bool, int]:
    """Version, whether binary, whether the bytes are swapped, and where the sections after it begin."""
    head = re.search(rb"\$MeshFormat\s*\n\s*(\S+)\s+(\S+)\s+(\S+)[^\n]*\n", content[:100_000])
    if not head:
        raise Refusal("the section $MeshFormat does not say the version. Write the mesh again.")
    version, kind, size = (item.decode("utf-8", "replace") for item in head.groups())
    if version not in VERSIONS:
        raise Refusal(
            f"line {_line(content, head.start(1))}: the format is {excerpt(version)}; 2.2, 4.0 and 4.1 are read. Save "
            "as "
            "one of them (in Gmsh: Mesh.MshFileVersion = 4.1)."
        )
    if kind not in ("0", "1") or size != "8":
        raise Refusal(
            f"line {_line(content, head.start(1))}: file type {excerpt(kind)} and size of numbers {excerpt(size)}; 0 "
            "or "
            "1, and 8, are read. Write the mesh again."
        )
    place, swapped = head.end(), False
    if kind == "1":
        one = content[place : place + 4]
        swapped = one == (1).to_bytes(4, "big")
        if not swapped and one != (1).to_bytes(4, "little"):
            raise Refusal(f"byte {place}: the mark of a binary file is missing. Write the mesh again.")
        place += 4
    end = content.find(b"$EndMeshFormat", place)
    if end < 0:
        raise Refusal("the section $MeshFormat does not end. The file was cut off: write it again.")
    return VERSIONS[version], kind == "1", swapped, end + len(b"$EndMeshFormat")


def _names(text: bytes, line: int) -> dict[tuple[int, int], str]:
    """Names of groups by dimension and tag."""
    rows = [(n, row) for n, row in enumerate(text.splitlines(), start=line) if row.strip()]
    names: dict[tuple[int, int], str] = {}
    if not rows or not rows[0][1].strip().isdigit() or int(rows[0][1]) != len(rows) - 1:
        raise Refusal(
            f"line {line}: $PhysicalNames declares {excerpt(rows[0][1]) if rows else 'nothing'} names and holds "
            f"{max(len(rows) - 1, 0)}. Write the mesh again."
        )
    for number, row in rows[1:]:
        match = re.fullmatch(rb'\s*([0-3])\s+(\d+)\s+"?(.*?)"?\s*', row)
        if not match:
            raise Refusal(f"line {number}: {excerpt(row)} is no dimension, tag and name. Write the mesh again.")
        names[int(match[1]), int(match[2])] = match[3].decode("utf-8", "replace")
    return names


def _section(name: str, numbers: TextNumbers | BinaryNumbers, version: int, found: _Content) -> None:
    """Read one section of the mesh."""
    if name == "PartitionedEntities" and version != 41:
        raise Refusal(
            f"{numbers.where()}partitioned meshes are read in the format 4.1 only. Save as that (in Gmsh: "
            "Mesh.MshFileVersion = 4.1), or without partitions."
        )
    if name in ("Entities", "PartitionedEntities"):
        found.entities = found.entities or Entities()
        read_entities(numbers, version, found.entities, name == "PartitionedEntities")
    elif name == "Nodes":
        if found.points is not None:
            raise Refusal(f"{numbers.where()}a second section $Nodes. Write the mesh again.")
        found.numbers, found.points = read_nodes_2(numbers) if version == 22 else read_nodes_4(numbers, version)
        again = repeated(found.numbers)
        if len(again):
            raise Refusal(f"node {found.numbers[again[0]]} is there twice. Write the mesh again.")
    else:
        if found.rows is not None:
            raise Refusal(f"{numbers.where()}a second section $Elements. Write the mesh again.")
        found.rows = (
            read_elements_2(numbers)
            if version == 22
            else read_elements_4(numbers, version, found.entities or Entities())
        )


def _assemble(found: _Content) -> RawMesh:
    """Blocks of cells and sets of the groups."""
    if found.points is None or found.rows is None:
        missing = "$Nodes" if found.points is None else "$Elements"
        raise Refusal(f"the section {missing} is not there. Write the mesh again.")
    raw = RawMesh(found.points)
    for row in found.rows:
        shape, count = TYPES[row.type]
        kind = shape if FIRST_ORDER[shape] == count else f"{shape}{count}"
        places = places_of(found.numbers, row.nodes)
        if (places < 0).any():
            raise Refusal(
                f"{row.where}an element of type {row.type} ({kind}) names node {row.nodes[places < 0][0]}, which the "
                "file "
                "does not have. Write the mesh again."
            )
        raw.blocks.append(Block(kind, places, f"type {row.type}"))
    _add_groups(raw, found)
    return raw


def _add_groups(raw: RawMesh, found: _Content) -> None:
    members: dict[tuple[int, int], list[np.ndarray]] = {}
    geometry: dict[int, list[np.ndarray]] = {}
    nothing = [np.empty(0, np.int64)] * len(raw.blocks)
    for k, (row, block) in enumerate(zip(found.rows, raw.blocks, strict=True)):
        for groups in row.groups:
            for tag in np.unique(groups[groups != 0]).tolist():
                own = np.flatnonzero(np.broadcast_to(groups, len(block.nodes)) == tag)
                sets = members.setdefault((block.dimension, tag), list(nothing))
                sets[k] = np.union1d(sets[k], own)
        for tag in np.unique(row.geometry).tolist():
            geometry.setdefault(tag, list(nothing))[k] = np.flatnonzero(row.geometry == tag)
    for key in found.names:  # a group without elements is empty, and a deck that names it is refused
        members.setdefault(key, list(nothing))
    for (dimension, tag), sets in members.items():
        name = found.names.get((dimension, tag))
        for key in filter(None, (name, f"gmsh:physical={tag}")):
            before = raw.cells.get(key, nothing)
            raw.cells[key] = [np.union1d(a, b).astype(np.int64) for a, b in zip(before, sets, strict=True)]
    for tag, sets in geometry.items() if len(geometry) <= MOST_VALUES else ():
        raw.cells.setdefault(f"gmsh:geometrical={tag}", sets)
