"""Mesh files for tests: bodies written by meshio in every format that decks may name."""

from __future__ import annotations

import contextlib
import io

import meshio
import netCDF4
import numpy as np

SUFFIXES = (".msh", ".inp", ".vtu", ".exo")


def write_mesh(path, mesh, regions=None, faces=None, nodes=None):
    """Write a mesh with named sets, as far as the format has them.

    Parameters
    ----------
    path : Path
    mesh : HexMesh
    regions : dict from name to cells, each cell in one of them
        .vtu: an integer array ``region`` that numbers them in their order. .exo: element blocks, for which the cells of
        each must follow those of the one before.
    faces : dict from name to rows of four nodes
        Quadrilaterals (.msh, .inp), side sets (.exo); none in .vtu.
    nodes : dict from name to nodes
        An integer array 0 or 1 of that name in .vtu; none in .msh.
    """
    regions, faces, nodes = regions or {}, faces or {}, nodes or {}
    blocks = [("hexahedron", mesh.cells.astype(np.int64))]
    number = np.zeros(len(mesh.cells), np.int32)
    for value, cells in enumerate(regions.values()):
        number[cells] = value
    with contextlib.redirect_stderr(io.StringIO()):
        if path.suffix == ".vtu":
            every = np.arange(len(mesh.nodes))
            flags = {name: np.isin(every, members).astype(np.int32) for name, members in nodes.items()}
            meshio.Mesh(mesh.nodes, blocks, cell_data={"region": [number]}, point_data=flags).write(path)
            return
        if path.suffix == ".exo":
            hexes = [("hexahedron", mesh.cells[cells].astype(np.int64)) for cells in regions.values()] or blocks
            sets = {name: np.asarray(members, np.int64) for name, members in nodes.items()}
            meshio.Mesh(mesh.nodes, hexes, point_sets=sets).write(path)
            with netCDF4.Dataset(path, "a") as file:
                _add_names(file, "eb", list(regions), "num_el_blk")
                _add_sides(file, mesh, faces)
            return
        blocks += [("quad", np.asarray(rows, np.int64)) for rows in faces.values()]
        if path.suffix == ".inp":
            empty = np.empty(0, np.int64)
            sets = {name: [np.asarray(cells, np.int64), *(empty for _ in faces)] for name, cells in regions.items()} | {
                name: [empty, *(np.arange(len(rows)) if name == other else empty for other in faces)]
                for name, rows in faces.items()
            }
            meshio.Mesh(mesh.nodes, blocks, cell_sets=sets, point_sets=nodes).write(path)
            return
        groups = [number + 1] + [np.full(len(rows), 100 + k) for k, rows in enumerate(faces.values())]
        names = {name: np.array([1 + k, 3]) for k, name in enumerate(regions)}
        names |= {name: np.array([100 + k, 2]) for k, name in enumerate(faces)}
        data = {"gmsh:physical": groups, "gmsh:geometrical": groups} if regions or faces else {}
        meshio.Mesh(mesh.nodes, blocks, cell_data=data, field_data=names).write(path, "gmsh22", binary=False)


def _add_names(file, kind, names, dimension):
    if names:
        variable = file.createVariable(f"{kind}_names", "S1", (dimension, "len_string"))
        for k, name in enumerate(names):
            for i, letter in enumerate(name):
                variable[k, i] = letter.encode()


#: Local nodes of the sides 1 to 6 of a hexahedron in the Exodus II manual, counted from 0.
EXODUS_SIDES = [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (0, 4, 7, 3), (0, 3, 2, 1), (4, 5, 6, 7)]


def _add_sides(file, mesh, faces):
    if not faces:
        return
    side_of = {
        frozenset(cell[list(corners)].tolist()): (number, side)
        for number, cell in enumerate(mesh.cells, start=1)
        for side, corners in enumerate(EXODUS_SIDES, start=1)
    }
    file.createDimension("num_side_sets", len(faces))
    _add_names(file, "ss", list(faces), "num_side_sets")
    for k, rows in enumerate(faces.values(), start=1):
        file.createDimension(f"num_side_ss{k}", len(rows))
        pairs = np.array([side_of[frozenset(np.asarray(row).tolist())] for row in rows])
        for column, name in enumerate((f"elem_ss{k}", f"side_ss{k}")):
            file.createVariable(name, "i4", (f"num_side_ss{k}",))[:] = pairs[:, column]
