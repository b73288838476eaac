"""The boundary of a body of hexahedra: its faces, the area vectors of its collocation points, and their compatibility.

A body is what hangs together and has one stiffness; where two meet, the common face belongs to the boundary of both.
The area vector of a point is ``N(i) = int L_i n dA`` over the body's boundary, with ``L_i`` the trilinear function of
a cell that is 1 at Gauss point i and 0 at the other seven. A uniform stress ``sigma`` pulls at the body's points with
``sigma N(i)``.

Bonds can balance such forces for every uniform strain only where the area vectors do no work on the traces of the
symmetric Killing tensors of rank 3, of which there are fifty: ``(P.Q) R + (P.R) Q + (Q.R) P`` for every choice of
three rigid motions. Blocks and symmetric meshes fulfil this by themselves; elsewhere the smallest change of the area
vectors restores it.

With a volumetric part beside the bonds, eight conditions more hold: ``sum_i N(i) . v(x_i) = sum_i w_i div v(x_i)`` for
the quadratic fields ``v = x cross (S x)``, ``S`` symmetric, and ``v = a |x|^2 - x (a . x)`` (`dilatation`).

Everything here is computed from the whole mesh, alike on every rank: the same bits everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import combinations_with_replacement

import numpy as np

from pdfem_mpi.kernels.dense import eigen, product
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS, REFERENCE_NODES
from pdfem_mpi.mesh.faces import match_faces, outer_faces
from pdfem_mpi.mesh.hexmesh import FACES, HexMesh
from pdfem_mpi.mesh.rigid_motions import rigid_motions

#: Directions of the compatibility conditions weaker than this fraction of the strongest are none.
INDEPENDENT = 1e-11
#: Works on the traces below this fraction of the sum of their magnitudes are round-off.
COMPATIBLE = 1e-12
#: Turns of the correction of the area vectors; each gains ten digits or more.
TURNS = 3
#: Points of the boundary treated together.
BATCH = 2**14

_FACE_CORNERS = np.array([(-1, -1), (1, -1), (1, 1), (-1, 1)])
_FACE_POINTS = _FACE_CORNERS / np.sqrt(3.0)


@dataclass(frozen=True)
class Boundary:
    """Boundary faces of bodies, each of one cell.

    Attributes
    ----------
    cell : int64, shape (n_faces,)
        Cell of the mesh.
    side : int64, shape (n_faces,)
        Which of its `FACES`.
    areas : float64, shape (n_faces, 8, 3)
        Each face's share in the area vectors of its cell's eight points.
    """

    cell: np.ndarray
    side: np.ndarray
    areas: np.ndarray


def find_boundary(mesh: HexMesh, nodes: np.ndarray, body: np.ndarray) -> Boundary:
    """Faces of the cells of bodies that no other cell of the same body shares.

    Parameters
    ----------
    nodes : float64, shape (n_nodes, 3)
        Positions, in any unit.
    body : int, shape (n_cells,)
        Number of each cell's body, -1 for cells of none.

    Raises
    ------
    SceneError
        As `match_faces`.
    """
    cell, side = outer_faces(match_faces(mesh, body >= 0), body)
    return Boundary(cell, side, _face_areas(nodes, mesh.cells[cell], side))


def _face_areas(nodes: np.ndarray, cells: np.ndarray, side: np.ndarray) -> np.ndarray:
    """``int L_g n dA`` of the eight points of each cell over one of its faces, shape (n_faces, 8, 3)."""
    corners = nodes[cells[np.arange(len(cells))[:, None], FACES[side]]]
    areas = np.zeros((len(cells), 8, 3))
    for r, s in _FACE_POINTS:
        along_r, along_s = np.zeros((len(cells), 3)), np.zeros((len(cells), 3))
        place = np.zeros((6, 3))
        for a, (ra, sa) in enumerate(_FACE_CORNERS):
            # differences to corner 0: faces of the same shape at different places agree up to rounding
            offset = corners[:, a] - corners[:, 0]
            along_r += ra * (1 + sa * s) / 4 * offset
            along_s += sa * (1 + ra * r) / 4 * offset
            place += (1 + ra * r) * (1 + sa * s) / 4 * REFERENCE_NODES[FACES[:, a]]
        normal = np.cross(along_r, along_s)
        share = np.prod((1.0 + 3.0 * place[:, None, :] * GAUSS_POINTS) / 2.0, axis=2)  # (sides, 8 points)
        areas += share[side][:, :, None] * normal[:, None, :]
    return areas


def area_vectors(boundary: Boundary, n_cells: int) -> np.ndarray:
    """``N(i)`` of the points of all cells, shape (n_cells, 8, 3): sums over their faces, in the order of the faces."""
    total = np.zeros((n_cells, 8, 3))
    for side in range(6):
        chosen = boundary.side == side  # a cell has each side once
        total[boundary.cell[chosen]] += boundary.areas[chosen]
    return total


def face_vectors(mesh: HexMesh, nodes: np.ndarray, cells: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """``int L_i n dA`` of the points of cells over one face of each, given by its nodes (n, 4); shape (n, 8, 3)."""
    sides = np.sort(mesh.cells[cells][:, FACES], axis=2) == np.sort(faces, axis=1)[:, None, :]
    return _face_areas(nodes, mesh.cells[cells], np.argmax(sides.all(axis=2), axis=1))


def face_shares(mesh: HexMesh, nodes: np.ndarray, cells: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """The same along the mean normal of each face, ``int L_i dA`` of one that is flat; shape (n, 8)."""
    areas = face_vectors(mesh, nodes, cells, faces)
    whole = areas.sum(axis=1)
    size = np.sqrt((whole**2).sum(axis=1))
    return (areas * (whole / size[:, None])[:, None, :]).sum(axis=2)


def restore_compatibility(
    x: np.ndarray, areas: np.ndarray, changeable: np.ndarray, moments: np.ndarray | None = None
) -> tuple[np.ndarray, float]:
    """Change area vectors as little as possible, so that they do no work on the fifty traces, and stay closed.

    Closed means that ``sum N`` and ``sum N_c x_d - V delta_cd`` keep their values.

    Parameters
    ----------
    x : float64, shape (n, 3), dimension length
        Points with an area vector.
    areas : float64, shape (n, 3)
    changeable : bool, shape (n,)
    moments : float64, shape (4,), optional
        Volume and first moments of the body's points: the eight quadratic fields count too.

    Returns
    -------
    areas : float64, shape (n, 3)
    change : float
        Root of the sum of the squares of the change, relative to that of the area vectors.
    """
    centre = 0.5 * (x.min(axis=0) + x.max(axis=0))
    half = 0.5 * (x.max(axis=0) - x.min(axis=0)).max()
    scaled = (x - centre) / half
    wanted = np.append(np.zeros(N_TRACES), () if moments is None else _divergences(moments, centre, half))
    n_works, conditions = len(wanted), _conditions if moments is None else _conditions_with_fields
    works, sizes = -wanted, np.abs(wanted)
    for k in range(0, len(x), BATCH):
        rows = conditions(scaled[k : k + BATCH])[:n_works]
        works += _work(rows, areas[k : k + BATCH])
        sizes += _work(np.abs(rows), np.abs(areas[k : k + BATCH]))
    if (np.abs(works) <= COMPATIBLE * sizes.max()).all():
        return areas, 0.0
    of_changeable = scaled[changeable]
    gram = sum(_gram(conditions(of_changeable[k : k + BATCH])) for k in range(0, len(of_changeable), BATCH))
    size = 1.0 / np.sqrt(np.maximum(np.diagonal(gram), 1e-300))
    values, vectors = eigen(size[:, None] * gram * size)
    usable = values > INDEPENDENT * values[-1]
    inverse = size[:, None] * product(vectors[:, usable] / values[usable], vectors[:, usable].T) * size
    change = np.zeros_like(areas)
    for _ in range(TURNS):
        defect = np.zeros(len(gram))
        defect[:n_works] -= wanted
        for k in range(0, len(x), BATCH):
            rows, part = conditions(scaled[k : k + BATCH]), slice(k, k + BATCH)
            defect[:n_works] += _work(rows[:n_works], areas[part] + change[part])
            defect[n_works:] += _work(rows[n_works:], change[part])
        amounts = -product(inverse, defect)
        correction = np.zeros_like(of_changeable)
        for k in range(0, len(correction), BATCH):
            correction[k : k + BATCH] = product(amounts, conditions(of_changeable[k : k + BATCH]))
        change[changeable] += correction
    return areas + change, float(np.sqrt((change**2).sum() / (areas**2).sum()))


#: Rigid motions taken three at a time, with repetitions.
N_TRACES = 56


def _conditions(x: np.ndarray) -> np.ndarray:
    """Traces of the Killing tensors, translations and linear displacements at some positions, shape (68, n, 3).

    The 56 products of three rigid motions span the 50 Killing tensors of rank 3, six of them twice.
    """
    motions = rigid_motions(x)
    dots = (motions[:, None] * motions[None]).sum(axis=3)
    rows = np.empty((N_TRACES + 12, len(x), 3))
    for k, (p, q, r) in enumerate(combinations_with_replacement(range(6), 3)):
        rows[k] = dots[p, q][:, None] * motions[r] + dots[p, r][:, None] * motions[q] + dots[q, r][:, None] * motions[p]
    rows[N_TRACES : N_TRACES + 3] = motions[:3]
    for k in range(9):
        rows[N_TRACES + 3 + k] = x[:, [k // 3]] * motions[k % 3]
    return rows


def _conditions_with_fields(x: np.ndarray) -> np.ndarray:
    """`_conditions`, and the eight quadratic fields behind the traces; shape (76, n, 3)."""
    rows = _conditions(x)
    return np.concatenate([rows[:N_TRACES], _quadratic_fields(x), rows[N_TRACES:]])


def _quadratic_fields(x: np.ndarray) -> np.ndarray:
    """The eight quadratic displacements without symmetric second gradient, shape (8, n, 3)."""
    rows = np.empty((8, len(x), 3))
    for k, (a, b) in enumerate(((0, 0), (1, 1), (0, 1), (1, 2), (2, 0))):  # a multiple of 1 turns nothing
        symmetric = np.zeros((3, 3))
        symmetric[a, b] = symmetric[b, a] = 1.0
        rows[k] = np.cross(x, product(x, symmetric))
    square = (x**2).sum(axis=1)
    for d in range(3):
        rows[5 + d] = -x * x[:, [d]]
        rows[5 + d][:, d] += square
    return rows


def _divergences(moments: np.ndarray, centre: np.ndarray, half: float) -> np.ndarray:
    """``sum_i w_i div v`` of the eight fields in scaled coordinates, from volume and first moments; shape (8,)."""
    return np.append(np.zeros(5), -2.0 / half**2 * (moments[1:] - moments[0] * centre))


def _work(rows: np.ndarray, vectors: np.ndarray) -> np.ndarray:
    return product(rows.reshape(len(rows), -1), vectors.reshape(-1))


def _gram(rows: np.ndarray) -> np.ndarray:
    rows = rows.reshape(len(rows), -1)
    return product(rows, rows.T)
