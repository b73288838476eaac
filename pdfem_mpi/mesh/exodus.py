"""Exodus II files: element blocks, side sets and node sets.

They go by their names; without one, they are ``block_ID``, ``surface_ID`` and ``nodelist_ID``.
"""

from __future__ import annotations

import re
from pathlib import Path

import numpy as np

from pdfem_mpi.mesh.hexmesh import FACES
from pdfem_mpi.mesh.netcdf_header import check_header
from pdfem_mpi.mesh.raw import Block, RawMesh, Refusal, excerpt

#: Rows of ``FACES`` of the sides 1 to 6 of a hexahedron.
SIDES = np.array([2, 1, 3, 0, 4, 5])
#: Sides of a shell: 1 and 2 are the shell itself, the others its edges.
SHELL_FACES = 2
#: Deflation packs at most so many bytes into one.
SMALLEST_PACKED = 1032
#: Element types by the letters they begin with, and the nodes of those of first order.
KINDS = (
    ("HEX", "hexahedron", 8), ("SHELL", "quad", 4), ("QUAD", "quad", 4), ("TRISHELL", "triangle", 3),
    ("TRI", "triangle", 3), ("BAR", "line", 2), ("BEAM", "line", 2), ("TRUSS", "line", 2), ("EDGE", "line", 2),
    ("ROD", "line", 2), ("SPRING", "spring", 2), ("SPHERE", "vertex", 1), ("CIRCLE", "vertex", 1),
    ("POINT", "vertex", 1), ("NODE", "vertex", 1),
    ("TET", "tetra", 4), ("WEDGE", "wedge", 6), ("PYR", "pyramid", 5),
)  # fmt: skip


def read_exodus(path: Path) -> RawMesh:
    """Read a file.

    Raises
    ------
    Refusal
        With the variable, what was found and what to do.
    ImportError
        netCDF4 is not installed.
    """
    import netCDF4

    content = path.read_bytes()
    if content[:3] == b"CDF":
        check_header(content)
    try:
        with netCDF4.Dataset(str(path)) as file:
            file.set_auto_mask(False)
            return _File(file, len(content)).read()
    except (OSError, RuntimeError, UnicodeDecodeError) as error:  # what the library meets in a damaged file
        reason = excerpt(getattr(error, "strerror", None) or str(error))
        raise Refusal(f"netCDF cannot read it: {reason}. It was cut off or changed: write the mesh again.") from None


class _File:
    """An open file, with a refusal for each way in which it may not hold what it declares."""

    def __init__(self, file, n_bytes: int) -> None:
        self.file = file
        self.most = n_bytes * (SMALLEST_PACKED if file.data_model.startswith("NETCDF4") else 1)
        self.variables = file.variables

    def size(self, name: str) -> int:
        """A dimension; 0 if it is not there."""
        return len(self.file.dimensions[name]) if name in self.file.dimensions else 0

    def array(self, name: str, shape: tuple[int, ...] | None = None) -> np.ndarray:
        """A variable of a shape."""
        if name not in self.variables:
            raise Refusal(f"the variable {name} is not there. Write the mesh again.")
        variable = self.variables[name]
        if variable.dtype is str or variable.dtype.kind not in "iufS" or (shape and variable.shape != shape):
            raise Refusal(
                f"the variable {name} has the shape {variable.shape}, and the file declares {shape}. Write the mesh "
                "again."
            )
        if variable.size * variable.dtype.itemsize > self.most:
            raise Refusal(
                f"the variable {name} declares {variable.size} values, more than the file can hold. It was cut off, or "
                "a "
                "count is wrong: write the mesh again."
            )
        return np.asarray(variable[:])

    def whole(self, name: str, shape: tuple[int, ...] | None = None) -> np.ndarray:
        """A variable of whole numbers; int64."""
        values = self.array(name, shape)
        if values.dtype.kind not in "iu":
            raise Refusal(f"the variable {name} does not hold whole numbers. Write the mesh again.")
        return values.astype(np.int64)

    def read(self) -> RawMesh:
        """All of the mesh."""
        if self.size("num_dim") != 3:
            raise Refusal(f"its nodes have {self.size('num_dim')} coordinates. Write a mesh in space.")
        raw = RawMesh(self._points())
        n_blocks = self.size("num_el_blk")
        for place in range(n_blocks):
            raw.blocks.append(self._block(place))
        total = sum(len(block.nodes) for block in raw.blocks)
        if total != self.size("num_elem"):
            raise Refusal(
                f"the file declares {self.size('num_elem')} elements, and its blocks have {total}. Write the mesh "
                "again."
            )
        extra = [name for name in self.variables if re.fullmatch(r"connect\d+", name)]
        if len(extra) > n_blocks:
            raise Refusal(f"the file declares {n_blocks} element blocks, and has {len(extra)}. Write the mesh again.")
        for place in range(n_blocks):
            name = self._name("eb", "block", place)
            before = raw.cells.get(name, [np.empty(0, np.int64)] * n_blocks)
            raw.cells[name] = [
                np.arange(len(block.nodes)) if k == place else before[k] for k, block in enumerate(raw.blocks)
            ]
        for place in range(self.size("num_node_sets")):
            self._node_set(raw, place)
        for place in range(self.size("num_side_sets")):
            self._side_set(raw, place)
        return raw

    def _points(self) -> np.ndarray:
        n = self.size("num_nodes")
        if "coord" in self.variables:
            return self.array("coord", (3, n)).astype(np.float64).T
        return np.stack([self.array(f"coord{axis}", (n,)).astype(np.float64) for axis in "xyz"], axis=1)

    def _block(self, place: int) -> Block:
        n, width = self.size(f"num_el_in_blk{place + 1}"), self.size(f"num_nod_per_el{place + 1}")
        key = f"connect{place + 1}"
        if key not in self.variables and not n:
            return Block("vertex", np.empty((0, 1), np.int64), f"empty block {place + 1}")
        called = str(getattr(self.variables[key], "elem_type", "")) if key in self.variables else ""
        nodes = self.whole(key, (n, width)) - 1
        word = re.sub(r"[\d_\s\0]+$", "", called.upper())
        kind, first = next(((kind, first) for start, kind, first in KINDS if word.startswith(start)), ("", 0))
        if not kind:
            raise Refusal(
                f"the block {self._name('eb', 'block', place)} has {n} elements of type {excerpt(called)}, which is "
                "not "
                "read. Mesh the body with HEX8."
            )
        if kind == "line":
            nodes, width = nodes[:, :first], min(width, first)  # a beam may name a node for its direction
        return Block(kind if width == first else f"{kind}{width}", nodes, f"{called}, block {place + 1}")

    def _name(self, kind: str, word: str, place: int) -> str:
        """Name of a block or set; without one, by its ID."""
        name = b""
        if f"{kind}_names" in self.variables:
            rows = self.variables[f"{kind}_names"]
            if rows.ndim == 2 and place < rows.shape[0] and rows.dtype is not str and rows.dtype.kind == "S":
                name = b"".join(np.asarray(rows[place]).tolist()).split(b"\0")[0].strip()
        if name:
            return name.decode("utf-8", "replace")
        ids = self.variables.get(f"{kind}_prop1")
        return f"{word}_{place + 1 if ids is None or place >= len(ids) else int(ids[place])}"

    def _node_set(self, raw: RawMesh, place: int) -> None:
        name = self._name("ns", "nodelist", place)
        n = self.size(f"num_nod_ns{place + 1}")
        members = self.whole(f"node_ns{place + 1}", (n,)) - 1 if n else np.empty(0, np.int64)
        self._check(members, len(raw.points), f"the node set {name}", "nodes")
        raw.nodes[name] = np.union1d(raw.nodes.get(name, members), members)

    def _check(self, members: np.ndarray, count: int, what: str, of: str) -> None:
        wrong = (members < 0) | (members >= count)
        if wrong.any():
            raise Refusal(
                f"{what} names {np.count_nonzero(wrong)} {of} that the file does not have, the first "
                f"{members[wrong][0] + 1} of {count}. Write the mesh again."
            )

    def _side_set(self, raw: RawMesh, place: int) -> None:
        """Sides of hexahedra and shells as faces, in the order of the blocks; edges of shells are counted."""
        name = self._name("ss", "surface", place)
        n = self.size(f"num_side_ss{place + 1}")
        rows = [np.empty((0, 4), np.int64)]
        left = 0
        cells, sides = (
            (self.whole(f"{key}_ss{place + 1}", (n,)) - 1 if n else np.empty(0, np.int64)) for key in ("elem", "side")
        )
        self._check(cells, sum(len(block.nodes) for block in raw.blocks), f"the side set {name}", "elements")
        start = 0
        for block in raw.blocks:
            own = (cells >= start) & (cells < start + len(block.nodes))
            cell, side = cells[own] - start, sides[own]
            start += len(block.nodes)
            if block.kind == "hexahedron":
                self._check(side, len(SIDES), f"the side set {name}", "sides")
                rows.append(block.nodes[cell[:, None], FACES[SIDES[side]]])
            elif block.kind == "quad":
                flat = (side >= 0) & (side < SHELL_FACES)
                rows.append(block.nodes[cell[flat]])
                left += int(np.count_nonzero(~flat))
            else:
                left += len(cell)
        if left:
            raw.notes.append(f"left out {left} sides of the set {name}, which are no faces of hexahedra or shells")
        faces = np.concatenate(rows)
        raw.faces[name] = np.concatenate([raw.faces[name], faces]) if name in raw.faces else faces
