"""Cells and integer arrays of VTK files, however they are written: blocks of one kind, and the sets of the arrays."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.mesh.raw import Block, RawMesh, Refusal, values_of

#: Shape and number of nodes of VTK's cell types; 0 nodes for those that have as many as they like.
TYPES = {
    0: ("empty", 0), 1: ("vertex", 1), 2: ("vertex", 0), 3: ("line", 2), 4: ("line", 0), 5: ("triangle", 3),
    6: ("surface", 0), 7: ("polygon", 0), 8: ("quad", 4), 9: ("quad", 4), 10: ("tetra", 4), 11: ("hexahedron", 8),
    12: ("hexahedron", 8), 13: ("wedge", 6), 14: ("pyramid", 5), 21: ("line3", 3), 22: ("triangle6", 6),
    23: ("quad8", 8), 24: ("tetra10", 10), 25: ("hexahedron20", 20), 26: ("wedge15", 15), 27: ("pyramid13", 13),
    28: ("quad9", 9), 29: ("hexahedron27", 27), 30: ("quad6", 6), 31: ("wedge12", 12), 32: ("wedge18", 18),
    33: ("hexahedron24", 24), 34: ("triangle7", 7), 35: ("line4", 4), 42: ("polyhedron", 0),
}  # fmt: skip
#: Pixels and voxels number their nodes along the axes, quadrilaterals and hexahedra around.
REORDERED = {8: [0, 1, 3, 2], 11: [0, 1, 3, 2, 4, 5, 7, 6]}
#: An array that marks cells which are there for the neighbours' sake.
GHOSTS = "vtkGhostType"


def make_mesh(points: np.ndarray, types: np.ndarray, offsets: np.ndarray, connectivity: np.ndarray) -> RawMesh:
    """Blocks of equal cells that follow each other.

    Parameters
    ----------
    points : float64, shape (n_nodes, 3)
    types : int64, shape (n_cells,)
    offsets : int64, shape (n_cells,)
        Where the nodes of each cell end.
    connectivity : int64
    """
    starts = np.concatenate([[0], offsets[:-1]]) if len(offsets) else offsets
    sizes = offsets - starts
    if (sizes < 0).any() or (offsets[-1] if len(offsets) else 0) != len(connectivity):
        raise Refusal(f"the offsets of the cells do not fit to their {len(connectivity)} nodes. Write the mesh again.")
    raw = RawMesh(points)
    changes = np.flatnonzero(types[1:] != types[:-1]) + 1 if len(types) else []
    for cells in np.split(np.arange(len(types)), changes) if len(types) else []:
        kind, width = TYPES.get(int(types[cells[0]]), (f"solid of VTK type {types[cells[0]]}, nodes", 0))
        if width and (sizes[cells] != width).any():
            cell = cells[np.flatnonzero(sizes[cells] != width)[0]]
            raise Refusal(
                f"cell {cell} of VTK type {types[cell]} has {sizes[cell]} nodes and not {width}. Write the mesh again."
            )
        first = starts[cells[0]]
        nodes = connectivity[first : first + width * len(cells)].reshape(len(cells), width)
        if int(types[cells[0]]) in REORDERED:
            nodes = nodes[:, REORDERED[int(types[cells[0]])]]
        raw.blocks.append(Block(kind, nodes, f"VTK type {types[cells[0]]}"))
    return raw


def add_cell_array(raw: RawMesh, name: str, values: np.ndarray) -> None:
    """Sets ``NAME=VALUE`` of an integer array over all cells."""
    if name == GHOSTS and values.any():
        raise Refusal(
            f"{np.count_nonzero(values)} cells are ghosts ({GHOSTS}), there for the neighbours' sake. Remove them."
        )
    for key, value in values_of(name, values):
        raw.set_of_cells(key, values == value)


def add_point_array(raw: RawMesh, name: str, values: np.ndarray) -> None:
    """Sets ``NAME=VALUE`` of an integer array over all nodes."""
    for key, value in values_of(name, values):
        raw.nodes.setdefault(key, np.flatnonzero(values == value))


def whole(values: np.ndarray, what: str) -> np.ndarray:
    """Values as int64; numbers with fractions are refused."""
    if values.dtype.kind == "f":
        raise Refusal(f"{what} are not whole numbers. Write the mesh again.")
    if values.dtype == np.uint64 and (values > np.iinfo(np.int64).max).any():
        raise Refusal(f"{what} hold {values.max()}. Write the mesh again.")
    return values.astype(np.int64)
