"""Surfaces of an Abaqus file that loads can use: sides of hexahedra, shells, and nodes."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.mesh.abaqus_cards import WHOLE, Card, fields_of, whole_number
from pdfem_mpi.mesh.abaqus_sets import Sets
from pdfem_mpi.mesh.hexmesh import FACES
from pdfem_mpi.mesh.raw import RawMesh, Refusal, excerpt, places_of

#: Rows of ``FACES`` of the faces S1 to S6 of a C3D8.
SIDES = {b"S1": 4, b"S2": 5, b"S3": 2, b"S4": 1, b"S5": 3, b"S6": 0}
#: What a row of a surface may say of a shell: one of its sides.
SHELL_SIDES = (b"SPOS", b"SNEG", b"")


def find_surfaces(raw: RawMesh, surfaces: list[tuple[Card, str]], sets: Sets) -> None:
    """Put the surfaces of element faces and of nodes into the mesh; others are named in a note."""
    faces: dict[str, list[np.ndarray]] = {}
    points: dict[str, list[np.ndarray]] = {}
    names: dict[str, str] = {}
    for card, space in surfaces:
        name = names.setdefault(card.options.get("NAME", "").upper(), card.options.get("NAME", ""))
        kind = card.options.get("TYPE", "ELEMENT").upper()
        if kind not in ("ELEMENT", "NODE") or set(card.options) - {"NAME", "TYPE", "INTERNAL"}:
            raw.notes.append(f"left out the surface {name} (line {card.line}), which is not made of faces or nodes")
            continue
        table, take = (faces, _faces_of) if kind == "ELEMENT" else (points, _points_of)
        try:
            rows = [take(raw, row, line, space, sets) for row, line in zip(card.rows, card.lines, strict=True)]
        except Refusal as refusal:  # most surfaces are made for contact, and no load of the deck speaks of them
            raw.notes.append(f"left out the surface {name}: {refusal}")
            continue
        table.setdefault(name, []).extend(rows)
    for name, rows in faces.items():
        raw.faces[name] = np.concatenate([np.empty((0, 4), np.int64), *rows])
    for name, rows in points.items():
        raw.nodes.setdefault(name, np.unique(np.concatenate([np.empty(0, np.int64), *rows])))


def _chosen(kind: str, item: bytes, line: int, space: str, sets: Sets) -> np.ndarray:
    """Places of the elements or nodes that the first field of a row of a surface means."""
    if WHOLE.fullmatch(item):
        place = places_of(sets.numbers[kind], np.array([whole_number(item, line, "an item")]))
        if place[0] >= 0:
            return place
    else:
        key = sets.find(space, kind, item.decode("utf-8", "replace"))
        if key is not None:
            return sets.found[key]
    raise Refusal(f"line {line}: {excerpt(item)} is no {kind} or member of the file. Correct the surface.")


def _points_of(raw: RawMesh, row: bytes, line: int, space: str, sets: Sets) -> np.ndarray:
    return _chosen("NSET", fields_of(row)[0], line, space, sets)


def _faces_of(raw: RawMesh, row: bytes, line: int, space: str, sets: Sets) -> np.ndarray:
    """Nodes of the faces that a row ``ELEMENT or ELSET, SIDE`` means; int64, shape (n, 4)."""
    item, label = (*fields_of(row), b"")[:2]
    label = label.upper()
    chosen = _chosen("ELSET", item, line, space, sets)
    start, rows = 0, []
    for block in raw.blocks:
        own = chosen[(chosen >= start) & (chosen < start + len(block.nodes))] - start
        start += len(block.nodes)
        if not len(own):
            continue
        if block.kind == "hexahedron" and label in SIDES:
            rows.append(block.nodes[own][:, FACES[SIDES[label]]])
        elif block.kind == "quad" and label in SHELL_SIDES:
            rows.append(block.nodes[own])
        else:
            raise Refusal(
                f"line {line}: the side {excerpt(label)} of elements of type {block.called.split(',')[0]} is not read. "
                "Write sides S1 to S6 of hexahedra."
            )
    return np.concatenate([np.empty((0, 4), np.int64), *rows])
