"""What a deck's ``set = "NAME"`` selects: cells, faces or nodes of a mesh file.

One name may belong to sets of several kinds, as in Abaqus, where a face has its nodes and the elements beneath it. Each
use takes the kind that fits it best: regions cells; body forces cells, else the layers beneath faces; tractions faces;
supports nodes, else the nodes of faces, else those of cells. A set of nodes stands for the faces of the boundary all of
whose nodes it holds.
"""

from __future__ import annotations

import numpy as np

from pdfem_mpi.deck.table import SceneError, did_you_mean, show
from pdfem_mpi.mesh.hexmesh import FACES, HexMesh, equal_rows
from pdfem_mpi.mesh.layers import cells_beneath

#: Kinds that serve each purpose, in order of preference; in words for messages.
KINDS = {
    "regions": ("cell_sets",),
    "body_force": ("cell_sets", "face_sets", "node_sets"),
    "traction": ("face_sets", "node_sets"),
    "pressure": ("face_sets", "node_sets"),
    "supports": ("node_sets", "face_sets", "cell_sets"),
}
WORDS = {"cell_sets": "cells", "face_sets": "faces", "node_sets": "nodes"}
#: Names that a message lists.
LISTED = 12


def kind_of(mesh: HexMesh, name: str, purpose: str, where: str) -> str:
    """The kind of set that a name means for a purpose: ``cell_sets``, ``face_sets`` or ``node_sets``.

    Parameters
    ----------
    purpose : str
        A key of ``KINDS``.
    where : str
        The deck's key, for the message.

    Raises
    ------
    SceneError
        No such set, none that can serve, one without members, or two of them that mean different nodes.
    """
    here = [kind for kind in KINDS[purpose] if name in getattr(mesh, kind)]
    filled = [kind for kind in here if (getattr(mesh, kind)[name] >= 0).any()]
    if purpose == "supports" and {"node_sets", "face_sets"} <= set(filled):
        held = [nodes(mesh, name, kind) for kind in ("node_sets", "face_sets")]
        if (held[0] != held[1]).any():
            counts = [np.count_nonzero(chosen) for chosen in held]
            raise SceneError(
                [
                    f"{where} = {show(name)} is a set of {counts[0]} nodes and one of faces with {counts[1]} nodes, "
                    "which "
                    "are not the same. Give the two sets two names in the mesh file."
                ]
            )
    if filled:
        return filled[0]
    if here:
        raise SceneError(
            [
                f"{where} = {show(name)} is an empty set: the mesh file names it, and nothing of the "
                "body is in it. Give it members, or take the table out of the deck."
            ]
        )
    fitting = " or ".join(WORDS[kind] for kind in KINDS[purpose])
    others = [WORDS[kind] for kind in WORDS if name in getattr(mesh, kind)]
    if others:
        raise SceneError([f"{where} = {show(name)} is a set of {others[0]}, and a set of {fitting} is needed here."])
    names = sorted({other for kind in KINDS[purpose] for other in getattr(mesh, kind)})
    listed = ", ".join(names[:LISTED]) + (f" and {len(names) - LISTED} more" if len(names) > LISTED else "")
    has = f"The mesh file's sets of {fitting} are {listed}." if names else f"The mesh file has no set of {fitting}."
    raise SceneError([f"{where} = {show(name)} is not a set of the mesh file.{did_you_mean(name, names)} {has}"])


def find_problems(mesh: HexMesh, entry, where: str) -> list[str]:
    """Why a load or support with a set cannot be, as far as the mesh tells; where is the table's path."""
    try:
        kind = kind_of(mesh, entry.set, purpose_of(entry), f"{where}.set")
        if kind != "cell_sets":
            found = faces(mesh, entry.set, kind, f"{where}.set")[0]
            if not len(found) and purpose_of(entry) != "supports":
                return [
                    f"{where}.set = {show(entry.set)} holds all nodes of no face of the boundary. Choose a set of "
                    "faces, or of all nodes of some."
                ]
        elif entry.layers != 1:
            return [
                f"{where}.layers = {entry.layers} counts layers beneath faces, and {show(entry.set)} is a set of "
                "cells. Leave layers out."
            ]
    except SceneError as error:
        return error.messages
    return []


def purpose_of(entry) -> str:
    """The key of ``KINDS`` for a load or support."""
    return getattr(entry, "kind", "supports")


def cells(mesh: HexMesh, name: str) -> np.ndarray:
    """Cells of a set of cells; bool, shape (n_cells,)."""
    chosen = np.zeros(len(mesh.cells), bool)
    chosen[mesh.cell_sets[name]] = True
    return chosen


def cells_of(mesh: HexMesh, entry, where: str) -> np.ndarray:
    """Cells that a body force or support means: those of its set, or layers beneath its faces; bool, (n_cells,)."""
    kind = kind_of(mesh, entry.set, purpose_of(entry), f"{where}.set")
    if kind == "cell_sets":
        return cells(mesh, entry.set)
    return cells_beneath(mesh, faces(mesh, entry.set, kind, f"{where}.set")[0], entry.layers)


def faces_of(mesh: HexMesh, entry, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Faces that a traction means, as `faces` gives them."""
    return faces(mesh, entry.set, kind_of(mesh, entry.set, purpose_of(entry), f"{where}.set"), f"{where}.set")


def nodes_of(mesh: HexMesh, entry, where: str) -> np.ndarray:
    """Nodes that a support means; bool, shape (n_nodes,)."""
    return nodes(mesh, entry.set, kind_of(mesh, entry.set, "supports", f"{where}.set"))


def nodes(mesh: HexMesh, name: str, kind: str) -> np.ndarray:
    """Nodes of a set of any kind; bool, shape (n_nodes,)."""
    chosen = np.zeros(len(mesh.nodes), bool)
    members = getattr(mesh, kind)[name]
    chosen[mesh.cells[members] if kind == "cell_sets" else members[members >= 0]] = True
    return chosen


def faces(mesh: HexMesh, name: str, kind: str, where: str) -> tuple[np.ndarray, np.ndarray]:
    """Faces of the boundary that a set of faces or nodes holds, in the order of their cells.

    Returns
    -------
    cells : int64, shape (n_faces,)
    nodes : int32, shape (n_faces, 4)
        Seen from outside counter-clockwise, whatever the file's order.

    Raises
    ------
    SceneError
        Faces of the set that are not on the boundary.
    """
    cell, side = mesh.boundary
    found = mesh.cells[cell[:, None], FACES[side]]
    if kind == "node_sets":
        on = nodes(mesh, name, kind)[found].all(axis=1)
        return cell[on], found[on]
    wanted = mesh.face_sets[name]
    number = equal_rows(np.sort(np.concatenate([found, wanted]), axis=1))
    stray = ~np.isin(number[len(found) :], number[: len(found)])
    if stray.any():
        corners = wanted[stray][0]
        known = mesh.nodes[corners[corners >= 0]]
        place = ", ".join(f"{c:.6g}" for c in known.mean(axis=0)) if len(known) else "off the body"
        raise SceneError(
            [
                f"{where} = {show(name)} has {np.count_nonzero(stray)} of {len(wanted)} faces that are not faces of "
                f"cells on the boundary of the body, the first at ({place}). Leave them out of the set."
            ]
        )
    on = np.isin(number[: len(found)], number[len(found) :])
    return cell[on], found[on]
