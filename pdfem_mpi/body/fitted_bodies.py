"""Which bodies the bond factors are fitted for, and how these are joined to each other and to the elements.

A fit balances the uniform strains of one stiffness. Cells with bonds whose materials differ in it therefore form
several bodies, each fitted by itself; no bonds run between them. They are joined as the exact coupling joins bonds and
elements: the points of cells that touch another body follow the nodes (eq. 25), and their forces go to these nodes
(eq. 26). A common face pulls at its nodes with the same integrals from both sides, so states of strain that are
uniform in each body and balanced at the faces are equilibria.

Overlap cells of another stiffness than the bonds beside them, and those at which a body would be too thin, are no part
of one. They stay elements, and the cells of bodies that touch them become overlap.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.materials import MaterialTable
from pdfem_mpi.mesh.faces import find_bodies, match_faces, outer_faces, refuse_pieces
from pdfem_mpi.mesh.hexmesh import HexMesh


@dataclass(frozen=True)
class FittedBodies:
    """The bodies of a scene.

    Attributes
    ----------
    number : int32, shape (n_cells,)
        Body of each cell with points, -1 for others.
    is_overlap : bool, shape (n_cells,)
        Cells whose points follow their nodes.
    thin : int64, shape (n_thin,)
        Cells at which a body is less than two cells thick: no fit serves.
    """

    number: np.ndarray
    is_overlap: np.ndarray
    thin: np.ndarray


def find_fitted_bodies(
    mesh: HexMesh, peridynamic: np.ndarray, is_overlap: np.ndarray, kind: np.ndarray
) -> FittedBodies:
    """Sort the cells with points into bodies of one stiffness.

    Parameters
    ----------
    peridynamic, is_overlap : bool, shape (n_cells,)
        Cells of peridynamic regions, and those of finite elements that share their points.
    kind : int, shape (n_cells,)
        Which of the materials with the same bonds each cell has; see `same_bonds`.

    Raises
    ------
    SceneError
        A boundary that is not closed, cells inside out, several pieces.
    """
    faces = match_faces(mesh, peridynamic | is_overlap)
    refuse_pieces(mesh, faces)
    kind = np.where(peridynamic | is_overlap, kind, -1)
    given_back = np.zeros(len(kind), bool)
    while True:
        number = find_bodies(faces, kind)
        with_bonds = np.zeros(int(number.max()) + 1, bool)
        with_bonds[number[peridynamic]] = True
        thin = thin_cells(*outer_faces(faces, number), len(number))
        further = is_overlap & (number >= 0) & (thin | ~with_bonds[number])
        if not further.any():
            break
        given_back |= further
        kind[further] = -1
    tied = (number >= 0) & (mesh.neighbours(given_back) | meets_another(mesh, number))
    return FittedBodies(number, (is_overlap & ~given_back) | tied, np.flatnonzero(thin))


def same_bonds(materials: MaterialTable) -> np.ndarray:
    """Number the materials so that those between which all bonds are alike have the same; int, shape (n_materials,)."""
    modulus, nu = materials.own_bond_modulus, materials.poissons_ratio
    alike = (modulus[:, None] == modulus) & (nu[:, None] == nu) & (materials.bond_modulus == modulus)
    alike &= alike.T
    number = np.arange(len(modulus))
    for k in number:
        # with all of its group: two may be like a third, and a table set them apart
        number[k] = next(j for j in range(k + 1) if alike[k, :k][number[:k] == j].all())
    return number


def meets_another(mesh: HexMesh, number: np.ndarray) -> np.ndarray:
    """Cells of a body that share a node with a cell of another; bool, shape (n_cells,)."""
    cells = np.flatnonzero(number >= 0)
    corners = mesh.cells[cells]
    lowest = np.full(len(mesh.nodes), np.iinfo(np.int32).max, np.int32)
    highest = np.full(len(mesh.nodes), -1, np.int32)
    for a in range(8):
        np.minimum.at(lowest, corners[:, a], number[cells])
        np.maximum.at(highest, corners[:, a], number[cells])
    meets = np.zeros(len(number), bool)
    meets[cells] = (lowest != highest)[corners].any(axis=1)
    return meets


def thin_cells(cell: np.ndarray, side: np.ndarray, n_cells: int) -> np.ndarray:
    """Cells with two opposite sides among those given; bool, shape (n_cells,)."""
    count = np.bincount(3 * cell + side // 2, minlength=3 * n_cells).reshape(-1, 3)
    return (count == 2).any(axis=1)
