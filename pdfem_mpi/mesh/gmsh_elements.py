"""Nodes and elements of a Gmsh file: rows in 2.2, blocks of one entity each in 4.0 and 4.1."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.mesh.gmsh_entities import Entities
from pdfem_mpi.mesh.gmsh_numbers import BinaryNumbers, TextNumbers
from pdfem_mpi.mesh.raw import Refusal, excerpt

#: Shape and number of nodes of each element type.
TYPES = {
    1: ("line", 2), 2: ("triangle", 3), 3: ("quad", 4), 4: ("tetra", 4), 5: ("hexahedron", 8), 6: ("wedge", 6),
    7: ("pyramid", 5), 8: ("line", 3), 9: ("triangle", 6), 10: ("quad", 9), 11: ("tetra", 10), 12: ("hexahedron", 27),
    13: ("wedge", 18), 14: ("pyramid", 14), 15: ("vertex", 1), 16: ("quad", 8), 17: ("hexahedron", 20),
    18: ("wedge", 15), 19: ("pyramid", 13), 20: ("triangle", 9), 21: ("triangle", 10), 22: ("triangle", 12),
    23: ("triangle", 15), 24: ("triangle", 15), 25: ("triangle", 21), 26: ("line", 4), 27: ("line", 5), 28: ("line", 6),
    29: ("tetra", 20), 30: ("tetra", 35), 31: ("tetra", 56), 36: ("quad", 16), 37: ("quad", 25), 92: ("hexahedron", 64),
    93: ("hexahedron", 125),
}  # fmt: skip


@dataclass
class Rows:
    """Elements of one type that stand together: the tag of their geometry, their groups, their nodes' numbers."""

    type: int
    where: str
    nodes: np.ndarray
    geometry: np.ndarray
    groups: list[np.ndarray]  # groups of all elements, or one array with the group of each


def read_nodes_2(numbers) -> tuple[np.ndarray, np.ndarray]:
    """Numbers (n,) and places (n, 3) of all nodes."""
    if isinstance(numbers, BinaryNumbers):
        count = _count_in_text(numbers)
    else:
        count = int(numbers.ints(1)[0])
    number, places = numbers.rows(count, "iddd")
    return number[:, 0], places


def _count_in_text(numbers: BinaryNumbers) -> int:
    """The count that version 2.2 writes in text before binary rows."""
    end = numbers.content.find(b"\n", numbers.place)
    text = numbers.content[numbers.place : end].strip()
    if end < 0 or not text.isdigit() or len(text) > 18:
        raise Refusal(f"{numbers.where()}{excerpt(text)} is not the count of {numbers.name}. Write the mesh again.")
    numbers.place = end + 1
    return int(text)


def read_nodes_4(numbers, version: int) -> tuple[np.ndarray, np.ndarray]:
    """Blocks of nodes of entities; in 4.1 the numbers of a block stand before its places."""
    blocks, total, *_ = numbers.sizes(4 if version == 41 else 2)
    tags, places, seen = [np.empty(0, np.int64)], [np.empty((0, 3))], 0
    for _ in range(blocks):
        first, second, parametric = numbers.ints(3)
        count = int(numbers.sizes(1)[0])
        seen += count
        if seen > total:
            break
        dimension = int(first if version == 41 else second)
        width = 3 + (dimension if parametric else 0)
        if version == 41:
            tags.append(numbers.sizes(count))
            places.append(numbers.rows(count, "d" * width)[0][:, :3])
        else:
            number, place = numbers.rows(count, "i" + "d" * width)
            tags.append(number[:, 0])
            places.append(place[:, :3])
    _agree(numbers, "nodes", total, seen)
    return np.concatenate(tags), np.concatenate(places)


def _agree(numbers, what: str, declared: int, seen: int) -> None:
    if declared != seen:
        raise Refusal(
            f"{numbers.where()}the section {numbers.name} declares {declared} {what}, and its blocks {seen}. Write the "
            "mesh again."
        )


def read_elements_4(numbers, version: int, entities: Entities) -> list[Rows]:
    """Blocks of elements of one entity and type; the groups are those of the entity."""
    blocks, total, *_ = numbers.sizes(4 if version == 41 else 2)
    rows, seen = [], 0
    for _ in range(blocks):
        where = numbers.where() if isinstance(numbers, BinaryNumbers) else ""
        first, second, kind = (int(k) for k in numbers.ints(3))
        dimension, tag = (first, second) if version == 41 else (second, first)
        count = int(numbers.sizes(1)[0])
        seen += count
        if seen > total:
            break
        width = _width(numbers, kind)
        nodes = numbers.rows(count, ("n" if version == 41 else "i") * (1 + width))[0][:, 1:]
        groups = [np.array([group]) for group in entities.groups.get((dimension, tag), ())]
        entities.met(dimension, tag)
        rows.append(Rows(kind, where, nodes, np.full(count, tag), groups))
    _agree(numbers, "elements", total, seen)
    entities.check_partitions()
    return rows


def _width(numbers, kind: int) -> int:
    if kind not in TYPES:
        raise Refusal(
            f"{numbers.where()}elements of type {kind}, which is not known. Mesh the body with hexahedra of eight "
            "nodes."
        )
    return TYPES[kind][1]


def read_elements_2(numbers) -> list[Rows]:
    """Rows of number, type, count of tags, tags (group, geometry, partitions), nodes; together where they are alike."""
    rows: list[Rows] = []
    if isinstance(numbers, BinaryNumbers):
        total, seen = _count_in_text(numbers), 0
        while seen < total:
            kind, count, n_tags = (int(k) for k in numbers.ints(3))
            if count < 1 or not 0 <= n_tags < 1000:
                raise Refusal(f"{numbers.where()}a block of {count} elements of {n_tags} tags. Write the mesh again.")
            table = numbers.rows(count, "i" * (1 + n_tags + _width(numbers, kind)))[0]
            rows.append(_row_2(kind, n_tags, table[:, 1:]))
            seen += count
        _agree(numbers, "elements", total, seen)
        return rows
    total, seen = int(numbers.ints(1)[0]), 0
    while seen < total:
        head = numbers.peek(3)
        if len(head) < 3 or not np.isfinite(head).all():
            numbers.ints(3)  # which says what is missing
        kind, n_tags = int(head[1]), int(head[2])
        width = 3 + n_tags + _width(numbers, kind)
        if n_tags < 0:
            raise Refusal(f"{numbers.where()}an element of {n_tags} tags. Write the mesh again.")
        count = _run(numbers, width, head[1:3], total - seen)
        table = numbers.rows(count, "i" * width)[0]
        rows.append(_row_2(kind, n_tags, table[:, 3:]))
        seen += count
    return rows


def _run(numbers: TextNumbers, width: int, head: np.ndarray, most: int) -> int:
    """How many rows from here on are of one type and count of tags: at least 1."""
    count, step = 1, 1
    while count < most:
        step = min(2 * step, most - count)
        ahead = numbers.peek((count + step) * width)[count * width :]
        ahead = ahead[: len(ahead) // width * width].reshape(-1, width)
        alike = (ahead[:, 1:3] == head).all(axis=1)
        if not alike.all():
            return count + int(np.argmin(alike))
        count += len(ahead)
        if len(ahead) < step:
            break
    return count


def _row_2(kind: int, n_tags: int, table: np.ndarray) -> Rows:
    none = np.zeros(len(table), np.int64)
    groups = np.abs(table[:, 0]) if n_tags > 0 else none
    return Rows(kind, "", table[:, n_tags:], table[:, 1] if n_tags > 1 else none, [groups])
