"""One body in many dresses: a bar in mesh files by the rules of each format, as other programs like to write it.

Everything here writes; nothing of the package reads along. A dress is chosen by a seed: the format, the layout of
blocks, comments, blanks, upper and lower case, ranges, sets of sets, order and numbers of nodes and cells, what
stands beside.
"""

from __future__ import annotations

import struct
from dataclasses import dataclass, field

import netCDF4
import numpy as np
import vtk
from vtk.util.numpy_support import numpy_to_vtk, numpy_to_vtkIdTypeArray

from pdfem_mpi.mesh.generators import box
from pdfem_mpi.mesh.hexmesh import HexMesh

CELLS = 4, 2, 2
#: Local nodes of the faces S1 to S6 of a C3D8 in the manual, and of the sides 1 to 6 of an Exodus hexahedron; from 0.
ABAQUS_SIDES = [(0, 1, 2, 3), (4, 7, 6, 5), (0, 4, 5, 1), (1, 5, 6, 2), (2, 6, 7, 3), (3, 7, 4, 0)]
EXODUS_SIDES = [(0, 1, 5, 4), (1, 2, 6, 5), (2, 3, 7, 6), (0, 4, 7, 3), (0, 3, 2, 1), (4, 5, 6, 7)]
#: Nodes of a VTK voxel in terms of a hexahedron.
VOXEL = [0, 1, 3, 2, 4, 5, 7, 6]


@dataclass
class Bar:
    """The bar with its sets, in some order of nodes and cells."""

    nodes: np.ndarray
    cells: np.ndarray
    clamp: np.ndarray = field(init=False)
    tip: np.ndarray = field(init=False)
    end: np.ndarray = field(init=False)

    def __post_init__(self):
        mesh = HexMesh(self.nodes, self.cells.astype(np.int32))
        x, _, z = self.nodes.T
        self.clamp = np.flatnonzero(x == 0.0)
        self.tip = np.flatnonzero((x == CELLS[0]) & (z == 0.0))
        self.end = mesh.faces_on_face("x+")[1].astype(np.int64)


def make_bar(random=None):
    """The bar of 4 x 2 x 2 unit cells, nodes and cells in another order if random numbers are given."""
    mesh = box((0.0, 0.0, 0.0), tuple(map(float, CELLS)), CELLS)
    if random is None:
        return Bar(mesh.nodes, mesh.cells.astype(np.int64))
    place = random.permutation(len(mesh.nodes))
    nodes = np.empty_like(mesh.nodes)
    nodes[place] = mesh.nodes
    return Bar(nodes, place[mesh.cells][random.permutation(len(mesh.cells))])


def side_of(cells, face, sides):
    """Number of the cell and of its side, both from 1, that a face is."""
    wanted = set(face.tolist())
    for number, cell in enumerate(cells, start=1):
        for side, corners in enumerate(sides, start=1):
            if set(cell[list(corners)].tolist()) == wanted:
                return number, side
    raise ValueError(face)


# --- Abaqus and CalculiX ------------------------------------------------------------------------------------------


class AbaqusDress:
    """Writes the bar as an .inp file; every choice is the random generator's."""

    def __init__(self, bar, random):
        self.bar, self.random, self.lines = bar, random, []
        self.step = int(random.choice([1, 1, 3, 10]))
        self.first = int(random.choice([1, 1, 7, 1000]))
        self.case = random.choice(["upper", "lower", "mixed", "as it is"])
        self.exponent = random.choice(["E", "D", "e", "d", ""])
        self.end_of_line = random.choice(["\n", "\r\n"])

    def chance(self, part=0.5):
        return self.random.random() < part

    def node(self, place):
        return self.first + self.step * int(place)

    def word(self, text):
        if self.case == "mixed":
            return "".join(c.upper() if self.chance() else c.lower() for c in text)
        return {"upper": text.upper, "lower": text.lower}.get(self.case, lambda: text)()

    def number(self, value):
        if not self.exponent or self.chance(0.3):
            return repr(float(value))
        return f"{value:.17E}".replace("E", self.exponent)

    def row(self, items, end=""):
        gap = ["", " ", "  ", "\t"]
        text = "".join(f"{self.random.choice(gap)}{item}{self.random.choice(gap)}," for item in items)[:-1]
        self.add(text + (end or ("," * self.chance(0.2) if len(items) > 1 else "")))

    def add(self, line):
        self.lines.append(line)
        if self.chance(0.05):
            self.lines.append(
                self.random.choice(["**", "** next, layer", "", "   ", "**ELEMENT, TYPE=C3D4", "** 1, 2, 3"])
            )

    def keyword(self, word, **options):
        parts = [self.word(word)] + [
            self.word(key.replace("_", " "))
            if value is True
            else f"{self.word(key)}{self.random.choice(['=', ' = '])}{value}"
            for key, value in options.items()
        ]
        text = "*" + parts[0]
        for part in parts[1:]:
            text += ","
            if self.chance(0.2):
                self.lines.append(text)
                text = "  "
            text += self.random.choice(["", " "]) + part
        self.lines.append(text)
        if self.chance(0.2):
            self.lines.append("** what follows")

    def rows_of_set(self, numbers):
        numbers = list(numbers)
        while numbers:
            count = int(self.random.integers(1, 17))
            self.row(numbers[:count], "," if self.chance(0.3) else "")
            numbers = numbers[count:]

    def set(self, kind, name, numbers, parts=None):
        """A set by lists, ranges, several parts or other sets."""
        numbers = sorted(int(number) for number in numbers)
        step = np.unique(np.diff(numbers))
        if len(numbers) > 1 and len(step) == 1 and self.chance(0.6):
            self.keyword(kind, **{kind: self.word(name), "GENERATE": True})
            self.row([numbers[0], numbers[-1]] + ([int(step[0])] if step[0] != 1 or self.chance() else []))
            return
        cut = int(self.random.integers(0, len(numbers) + 1))
        way = self.random.integers(4)
        if way == 0:
            self.keyword(kind, **{kind: self.word(name)})
            self.rows_of_set(numbers)
        elif way == 1:
            for part in filter(None, (numbers[:cut], numbers[cut:])):
                self.keyword(kind, **{kind: self.word(name)})
                self.rows_of_set(part)
        else:
            halves = [part for part in (numbers[:cut], numbers[cut:]) if part]
            names = [f"{name}_{k}" for k in range(len(halves))]
            for half, part in zip(names, halves, strict=True):
                self.keyword(kind, **{kind: self.word(half)})
                self.rows_of_set(part)
            self.keyword(kind, **{kind: self.word(name)})
            self.row([self.word(half) for half in names]) if way == 2 else [
                self.row([self.word(half)]) for half in names
            ]

    def write(self, path):
        bar, random = self.bar, self.random
        self.keyword("HEADING")
        self.add("a bar, in one of its dresses")
        wrapped = self.chance(0.3)
        if wrapped:
            self.keyword("PART", NAME="Part-1")
        number = self.nodes()
        if self.chance(0.3):
            self.set("NSET", "clamp", [self.node(k) for k in bar.clamp])
            self.set("NSET", "tip", [self.node(k) for k in bar.tip])
        else:
            number, self.late = self.elements(number), True
            self.set("NSET", "tip", [self.node(k) for k in bar.tip])
            self.set("NSET", "clamp", [self.node(k) for k in bar.clamp])
        if not hasattr(self, "late"):
            number = self.elements(number)
        self.beside(number)
        if wrapped:
            self.keyword("END PART")
            self.keyword("ASSEMBLY", NAME="A")
            self.keyword("INSTANCE", NAME="Part-1-1", PART="Part-1")
            self.keyword("END INSTANCE")
            if self.chance():
                self.keyword("NODE")
                self.row([1, 40.0, 0.0, 0.0])
                self.keyword("NSET", NSET="reference")
                self.row([1])
            self.keyword("END ASSEMBLY")
        if self.chance(0.3):
            self.keyword("STEP")
            self.keyword("STATIC")
            self.keyword("BOUNDARY")
            self.row(["clamp", 1, 3, "0."])
            self.keyword("NODE PRINT", NSET="clamp")
            self.add("U")
            self.keyword("END STEP")
        path.write_bytes(self.end_of_line.join([*self.lines, ""]).encode())
        del random

    def nodes(self):
        bar = self.bar
        blocks = np.array_split(np.arange(len(bar.nodes)), int(self.random.choice([1, 1, 2, 3])))
        for k, block in enumerate(blocks):
            self.keyword("NODE", **({"NSET": self.word("Nall")} if self.chance() else {}))
            for place in block:
                self.row([self.node(place), *(self.number(x) for x in bar.nodes[place])])
            if k == 0 and self.chance():
                self.row([self.node(len(bar.nodes)) + 5, *(self.number(x) for x in (50.0, -3.0, 1.0))])
        return 1

    def elements(self, number):
        bar = self.bar
        start = number
        one_set = self.chance()
        for k, block in enumerate(np.array_split(np.arange(len(bar.cells)), int(self.random.choice([1, 1, 2, 4])))):
            kind = self.random.choice(["C3D8", "C3D8R", "C3D8I", "C3D8H"])
            self.keyword("ELEMENT", TYPE=self.word(kind), ELSET=self.word("body" if one_set else f"body_{k}"))
            for cell in block:
                items = [number, *(self.node(place) for place in bar.cells[cell])]
                if self.chance(0.1):
                    self.row(items[:5], ",")
                    self.row(items[5:])
                else:
                    self.row(items)
                number += 1
        self.set("ELSET", "every", range(start, number))
        if self.chance():
            self.keyword("SURFACE", NAME=self.word("end"), TYPE=self.word("element"))
            for face in bar.end:
                cell, side = side_of(bar.cells, face, ABAQUS_SIDES)
                self.row([start + cell - 1, self.word(f"S{side}")])
        else:
            self.keyword(
                "ELEMENT", TYPE=self.word(self.random.choice(["S4", "S4R", "M3D4", "CPS4"])), ELSET=self.word("end")
            )
            for face in bar.end:
                self.row([number, *(self.node(place) for place in face)])
                number += 1
        return number

    def beside(self, number):
        bar = self.bar
        for kind, count in (("T3D2", 2), ("SPRINGA", 2), ("MASS", 1), ("B32", 3)):
            if self.chance(0.2):
                self.keyword("ELEMENT", TYPE=self.word(kind), ELSET=f"e_{kind}")
                self.row([number, *(self.node(place) for place in bar.cells[0][:count])])
                number += 1


#: Lines that a file must be refused for, and what the sentence says.
POISONS = (
    ("*INCLUDE, INPUT=more.inp", "*INCLUDE"),
    ("*NGEN\n1, 5, 1", "*NGEN"),
    ("*ELEMENT, TYPE=C3D10\n90001, 1, 2, 3, 4, 5, 6, 7, 8, 9, 10", "C3D10"),
    ("*ELEMENT, TYPE=C3D8\n90001, 1, 2, 3, 4, 5, 6, 7", "7 nodes"),
    ("*NODE\n90001, 0.0, 0.O, 1.0", '"0.O"'),
    ("*NODE\n90001, 0.0, 0.0", "2 coordinates"),
    ("*NSET, NSET=x\nnowhere", '"nowhere"'),
    ("*NSET, NSET=x\n987654321", "node 987654321"),
    ("*ELEMNT, TYPE=C3D8", "Did you mean *ELEMENT?"),
    ("*NSET, NSET=x, GENERATE\n9, 3", "no members"),
)


# --- Gmsh ---------------------------------------------------------------------------------------------------------


class GmshDress:
    """Writes the bar as a .msh file of one version: two volumes, the end as a surface, nodes of sets as points."""

    def __init__(self, bar, random):
        self.bar, self.random = bar, random
        self.version, self.binary = [("2.2", 0), ("2.2", 1), ("4", 0), ("4.1", 0), ("4.1", 1)][random.integers(5)]
        self.parts = []
        places = np.sort(random.choice(4 * len(bar.nodes), len(bar.nodes) + 1, replace=False)) + 1
        self.tags = places if random.random() < 0.5 else np.arange(1, len(bar.nodes) + 2)

    def write(self, path):
        bar = self.bar
        n = len(bar.cells)
        cut = int(self.random.integers(1, n))
        points = [
            (0, 100 + k, 15, [place], (4 if k < len(bar.clamp) else 5,))
            for k, place in enumerate((*bar.clamp, *bar.tip))
        ]
        self.blocks = [(dim, tag, kind, np.array([nodes]), groups) for dim, tag, kind, nodes, groups in points]
        self.blocks.append((2, 9, 3, bar.end, (3,)))
        self.blocks.append((3, 1, 5, bar.cells[:cut], (1, 2)))
        self.blocks.append((3, 2, 5, bar.cells[cut:], (1,)))
        self.text(f"$MeshFormat\n{self.version} {self.binary} 8\n")
        if self.binary:
            self.parts += [struct.pack("=i", 1), b"\n"]
        self.text("$EndMeshFormat\n")
        if self.random.random() < 0.3:
            self.text("$Comments\nany text, 1 2 3\n$EndComments\n")
        names = ['3 1 "body"', '3 2 "lower part"', '2 3 "end"', '0 4 "clamp"', '0 5 "tip"']
        self.text("\n".join(["$PhysicalNames", str(len(names)), *names, "$EndPhysicalNames", ""]))
        (self.version_2 if self.version == "2.2" else self.version_4)()
        path.write_bytes(b"".join(self.parts))

    def text(self, text):
        self.parts.append(text.encode())

    def put(self, code, *values):
        """Numbers by struct's letters, in text one line."""
        if self.binary:
            self.parts.append(struct.pack("=" + code, *values))
        else:
            self.text(" ".join(repr(v) if isinstance(v, float) else str(int(v)) for v in values) + "\n")

    def version_2(self):
        bar = self.bar
        nodes = [*zip(self.tags, bar.nodes.tolist(), strict=False), (self.tags[-1], [99.0, 0.0, 0.0])]
        self.text(f"$Nodes\n{len(nodes)}\n")
        for tag, x in nodes:
            self.put("iddd", tag, *x)
        total = sum(len(nodes) for _, _, _, nodes, _ in self.blocks)
        self.text(f"$EndNodes\n$Elements\n{total}\n")
        number = 0
        for _, tag, kind, nodes, groups in self.blocks:
            if self.binary:
                self.put("iii", kind, len(nodes), 2)
            for row in nodes:
                number += 1
                head = (number, groups[0], tag) if self.binary else (number, kind, 2, groups[0], tag)
                self.put("i" * (len(head) + len(row)), *head, *self.tags[row])
        self.text("$EndElements\n")

    def version_4(self):
        bar, old = self.bar, self.version == "4"
        self.text("$Entities\n")
        by_dimension = [[block for block in self.blocks if block[0] == d] for d in range(4)]
        self.put("QQQQ", *(len(blocks) for blocks in by_dimension))
        for dimension, blocks in enumerate(by_dimension):
            for _, tag, _, _, groups in blocks:
                box = [0.0] * (3 if dimension == 0 and not old else 6)
                counts = "i" + "d" * len(box) + "Q" + "i" * len(groups)
                bounds = (0,) if dimension else ()
                self.put(counts + "Q" * len(bounds), tag, *box, len(groups), *groups, *bounds)
        self.text("$EndEntities\n$Nodes\n")
        n = len(bar.nodes)
        halves = np.array_split(np.arange(n), int(self.random.choice([1, 2, 5])))
        places = [*bar.nodes.tolist(), [99.0, 0.0, 0.0]]
        halves[-1] = np.append(halves[-1], n)
        self.put(*(("QQ", len(halves), n + 1) if old else ("QQQQ", len(halves), n + 1, 1, max(self.tags))))
        for half in halves:
            parametric = int(self.random.random() < 0.3)
            self.put("iiiQ", *((9, 2) if old else (2, 9)), parametric, len(half))
            more = [0.5, 0.25] * parametric
            if old:
                for k in half:
                    self.put("i" + "d" * (3 + len(more)), self.tags[k], *places[k], *more)
                continue
            for k in half:
                self.put("Q", self.tags[k])
            for k in half:
                self.put("d" * (3 + len(more)), *places[k], *more)
        self.text("$EndNodes\n$Elements\n")
        total = sum(len(nodes) for _, _, _, nodes, _ in self.blocks)
        self.put(*(("QQ", len(self.blocks), total) if old else ("QQQQ", len(self.blocks), total, 1, total)))
        number, letter = 0, "i" if old else "Q"
        for dimension, tag, kind, nodes, _ in self.blocks:
            self.put("iiiQ", *((tag, dimension) if old else (dimension, tag)), kind, len(nodes))
            for row in nodes:
                number += 1
                self.put(letter * (1 + len(row)), number, *self.tags[row])
        self.text("$EndElements\n")


# --- VTK ----------------------------------------------------------------------------------------------------------


def write_vtk(path, bar, random):
    """Writes the bar by VTK itself: XML in all codings or legacy, some cells as voxels, quadrilaterals beside."""
    voxels = random.random() < 0.4
    axes = [set(np.ptp(bar.nodes[cell], axis=0).tolist()) == {1.0} for cell in bar.cells]
    types, rows = [], []
    for k, cell in enumerate(bar.cells):
        as_voxel = voxels and axes[k] and random.random() < 0.5
        types.append(11 if as_voxel else 12)
        rows.append(cell[VOXEL] if as_voxel else cell)
    if random.random() < 0.5:
        types += [9] * len(bar.end)
        rows += list(bar.end)
    grid = vtk.vtkUnstructuredGrid()
    points = vtk.vtkPoints()
    points.SetDataTypeToDouble()
    points.SetData(numpy_to_vtk(np.ascontiguousarray(bar.nodes), deep=True))
    grid.SetPoints(points)
    cells = vtk.vtkCellArray()
    offsets = np.concatenate([[0], np.cumsum([len(row) for row in rows])])
    cells.SetData(numpy_to_vtkIdTypeArray(offsets, deep=True), numpy_to_vtkIdTypeArray(np.concatenate(rows), deep=True))
    grid.SetCells(numpy_to_vtk(np.array(types, np.uint8), deep=True), cells)
    every = np.arange(len(bar.nodes))
    kind = random.choice([np.int32, np.int64, np.uint8])
    for name, members in (("clamp", bar.clamp), ("tip", bar.tip), ("end", bar.end)):
        array = numpy_to_vtk(np.isin(every, members).astype(kind), deep=True)
        array.SetName(name)
        grid.GetPointData().AddArray(array)
    strain = numpy_to_vtk(random.random((len(rows), 6)), deep=True)
    strain.SetName("strain")
    grid.GetCellData().AddArray(strain)
    if path.suffix == ".vtk":
        writer = vtk.vtkUnstructuredGridWriter()
        writer.SetFileVersion(int(random.choice([42, 51])))
        (writer.SetFileTypeToASCII if random.random() < 0.5 else writer.SetFileTypeToBinary)()
    else:
        writer = vtk.vtkXMLUnstructuredGridWriter()
        [writer.SetDataModeToAscii, writer.SetDataModeToBinary, writer.SetDataModeToAppended][random.integers(3)]()
        [
            lambda: writer.SetCompressorTypeToNone(),
            writer.SetCompressorTypeToZLib,
            writer.SetCompressorTypeToLZ4,
            writer.SetCompressorTypeToLZMA,
        ][random.integers(4)]()
        writer.SetEncodeAppendedData(int(random.integers(2)))
        [writer.SetHeaderTypeToUInt32, writer.SetHeaderTypeToUInt64][random.integers(2)]()
        [writer.SetByteOrderToLittleEndian, writer.SetByteOrderToBigEndian][random.integers(2)]()
        writer.SetBlockSize(int(random.choice([512, 4096, 32768])))
    writer.SetInputData(grid)
    writer.SetFileName(str(path))
    writer.Write()


# --- Exodus II ----------------------------------------------------------------------------------------------------


def write_exodus(path, bar, random):
    """Writes the bar by netCDF: several blocks, perhaps shells and points beside; names of the sets."""
    with netCDF4.Dataset(
        path, "w", format=str(random.choice(["NETCDF3_CLASSIC", "NETCDF3_64BIT_OFFSET", "NETCDF4"]))
    ) as file:
        blocks = [("HEX8", part) for part in np.array_split(bar.cells, int(random.choice([1, 2, 3])))]
        if random.random() < 0.5:
            blocks.insert(int(random.integers(len(blocks) + 1)), ("SHELL4", bar.end))
        if random.random() < 0.3:
            blocks.append(("SPHERE", np.array([[0], [5]])))
        n = len(bar.nodes)
        sizes = {
            "len_string": 33, "num_dim": 3, "num_nodes": n + 1, "num_elem": sum(len(nodes) for _, nodes in blocks),
            "num_el_blk": len(blocks), "num_node_sets": 2, "num_side_sets": 1, "num_nod_ns1": len(bar.clamp),
            "num_nod_ns2": len(bar.tip), "num_side_ss1": len(bar.end),
        }  # fmt: skip
        for name, size in sizes.items():
            file.createDimension(name, size)
        nodes = np.concatenate([bar.nodes, [[77.0, 0.0, 0.0]]])
        if random.random() < 0.5:
            file.createVariable("coord", "f8", ("num_dim", "num_nodes"))[:] = nodes.T
        else:
            for axis, x in zip("xyz", nodes.T, strict=True):
                file.createVariable(f"coord{axis}", "f8", ("num_nodes",))[:] = x
        solids, start = {}, 0
        for k, (kind, rows) in enumerate(blocks, start=1):
            file.createDimension(f"num_el_in_blk{k}", len(rows))
            file.createDimension(f"num_nod_per_el{k}", rows.shape[1])
            variable = file.createVariable(f"connect{k}", "i4", (f"num_el_in_blk{k}", f"num_nod_per_el{k}"))
            variable.elem_type = kind if random.random() < 0.5 else kind.rstrip("48")
            variable[:] = rows + 1
            if kind == "HEX8":
                solids |= {tuple(sorted(row)): start + j for j, row in enumerate(rows.tolist())}
            start += len(rows)
        named = random.random() < 0.5
        for key, ids, names in (("ns", [10, 20], ["clamp", "tip"]), ("ss", [30], ["end"])):
            dimension = {"ns": "num_node_sets", "ss": "num_side_sets"}[key]
            file.createVariable(f"{key}_prop1", "i4", (dimension,))[:] = ids
            if named:
                letters = np.zeros((len(names), 33), "S1")
                for row, name in enumerate(names):
                    letters[row, : len(name)] = list(name)
                file.createVariable(f"{key}_names", "S1", (dimension, "len_string"))[:] = letters
        file.createVariable("node_ns1", "i4", ("num_nod_ns1",))[:] = bar.clamp + 1
        file.createVariable("node_ns2", "i4", ("num_nod_ns2",))[:] = bar.tip + 1
        pairs = [side_of(bar.cells, face, EXODUS_SIDES) for face in bar.end]
        elements = [solids[tuple(sorted(bar.cells[cell - 1].tolist()))] + 1 for cell, _ in pairs]
        file.createVariable("elem_ss1", "i4", ("num_side_ss1",))[:] = elements
        file.createVariable("side_ss1", "i4", ("num_side_ss1",))[:] = [side for _, side in pairs]
    if named:
        return {}
    return {"clamp": "nodelist_10", "tip": "nodelist_20", "end": "surface_30"}


SUFFIXES = (".inp", ".inp", ".inp", ".msh", ".msh", ".vtu", ".vtk", ".exo", ".e", ".g")


def write_dress(folder, seed):
    """Write the bar in the dress of a seed.

    Returns
    -------
    path : Path
    names : dict
        What the sets clamp, tip and end are called in the file.
    in_order : bool
        Nodes and cells stand in the order of the clean file.
    poison : str
        What the refusal must name; empty for a sound file.
    """
    random = np.random.default_rng(seed)
    suffix = SUFFIXES[seed % len(SUFFIXES)]
    in_order = bool(random.random() < 0.5)
    bar = make_bar(None if in_order else random)
    path, names, poison = folder / f"bar{seed}{suffix}", {}, ""
    if suffix == ".inp":
        dress = AbaqusDress(bar, random)
        dress.write(path)
        if random.random() < 0.15:
            line, poison = POISONS[random.integers(len(POISONS))]
            path.write_bytes(path.read_bytes() + line.encode() + b"\n")
    elif suffix == ".msh":
        GmshDress(bar, random).write(path)
    elif suffix in (".vtu", ".vtk"):
        write_vtk(path, bar, random)
        names = {name: f"{name}=1" for name in ("clamp", "tip", "end")}
    else:
        names = write_exodus(path, bar, random)
    return path, {name: names.get(name, name) for name in ("clamp", "tip", "end")}, in_order, poison
