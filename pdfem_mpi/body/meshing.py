"""The mesh that a deck asks for, looked at as a whole with what the deck says of it."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.regions import assign_regions
from pdfem_mpi.deck.meshes import BoxMesh, FileMesh, PlateWithHoleMesh
from pdfem_mpi.deck.peridynamics import cutoff_problems
from pdfem_mpi.deck.removals import Removal
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError, show
from pdfem_mpi.mesh import generators, named_sets
from pdfem_mpi.mesh.carving import carve
from pdfem_mpi.mesh.defects import face_problems, find_defects, mirror_problems
from pdfem_mpi.mesh.extrusion import Extrusion
from pdfem_mpi.mesh.hexmesh import HexMesh, list_cells
from pdfem_mpi.mesh.quality import Quality, folded_cells
from pdfem_mpi.mesh.reader import read_mesh

#: A spacing of a deck may lie outside of the edges of the file's cells by this fraction.
SPACING_MISFIT = 1e-3


def make_mesh(scene: Scene) -> HexMesh:
    """The mesh a deck asks for; one from a file is looked at as a whole, with what the deck says of it.

    Raises
    ------
    SceneError
        A file that cannot be read, or all that is wrong with its cells, its nodes, and the sets that the deck names.
    """
    entry = scene.mesh
    if not isinstance(entry, FileMesh):
        mesh, removals = layers_of(entry).whole(), removals_of(entry)
        return carve(mesh, removals, entry.symmetry) if removals else mesh
    mesh, node_number = read_mesh(entry)
    messages = find_defects(mesh, node_number, entry.doubled_nodes == "crack") + _spacing_problems(scene, mesh)
    for face in entry.symmetry:
        messages += mirror_problems(mesh, face)
    springs = [spring.pull(1.0) for spring in scene.springs]
    for table, entries in (
        ("loads", scene.loads), ("supports", scene.supports), ("springs", springs), ("ties", scene.ties)
    ):  # fmt: skip
        for index, item in enumerate(entries):
            if getattr(item, "set", None) is not None:
                messages += named_sets.find_problems(mesh, item, f"{table}.{index}")
            elif getattr(item, "face", None) is not None:
                messages += face_problems(mesh, item.face, f"{table}.{index}")
    try:
        assign_regions(scene, mesh)
    except SceneError as error:
        messages += error.messages
    if messages:
        raise SceneError(messages)
    return mesh


def layers_of(entry: BoxMesh | PlateWithHoleMesh) -> Extrusion:
    """The layers of cells of a mesh that is made, before anything is removed."""
    if isinstance(entry, PlateWithHoleMesh):
        return generators.plate_layers(entry.lower, entry.upper, entry.hole_radius, entry.spacing, entry.symmetry)
    return generators.box_layers(entry.lower, entry.upper, entry.n_cells)


def removals_of(entry: BoxMesh | PlateWithHoleMesh) -> tuple[Removal, ...]:
    """What the deck takes out of a mesh that is made."""
    return getattr(entry, "remove", ())


def _spacing_problems(scene: Scene, mesh: HexMesh) -> list[str]:
    """A spacing that is not the cells', and what ``scene.CHECKS`` say of one that the deck leaves to the cells."""
    edge = scene.mesh.spacing
    if edge is None:
        if not scene.has_peridynamics:
            return []
        problems = cutoff_problems(scene.peridynamics, mesh.average_edge, "the mean edge of the cells")
        return [f"{problem.key} {problem.text}" for problem in problems]
    if mesh.smallest_edge * (1.0 - SPACING_MISFIT) <= edge <= mesh.largest_edge * (1.0 + SPACING_MISFIT):
        return []
    return [
        f"mesh.spacing = {show(edge)} is not between the shortest and the longest edge of the cells, "
        f"{mesh.smallest_edge:.6g} and {mesh.largest_edge:.6g}. Leave it out, or correct it or mesh.scale."
    ]


def describe_folded(mesh: HexMesh, folded: np.ndarray) -> str:
    return (
        f"mesh has {np.count_nonzero(folded)} cells that are folded at a corner (its Jacobian is not positive, those "
        "of the "
        f"Gauss points are), the first {list_cells(mesh, folded)}"
    )


def check_folded(mesh: HexMesh, quality: Quality, has_points: np.ndarray) -> None:
    """Refuse bonds in cells that are folded at a corner; elements take them."""
    if quality.smallest_scaled_jacobian > 0.0:
        return
    folded = np.zeros(len(mesh.cells), bool)
    folded[folded_cells(mesh)] = True
    folded &= has_points
    if mesh.everywhere.wrong(folded):
        raise SceneError(
            [
                f"{describe_folded(mesh, folded)}, in peridynamics or the overlap, where points would have bonds. "
                "Correct "
                "the places of their nodes, or give them to finite elements."
            ]
        )
