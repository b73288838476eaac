"""Mesh files that programs write every day and a reader may read by half: each gives the right numbers of one bar.

The bar has 10 x 2 x 2 unit hexahedra of finite elements, E = 1000 and nu = 1/4. Pulled by 4 at each end of 2 x 2 the
strain is 1e-3. Clamped at x = 0, propped in z at its tip and under a body force of -0.01 in z, an independent program
of eight-node elements with a direct solver gives u_z(5, 1, 1) = -1.7284011e-3.
"""

import lzma
import re
import zlib
from base64 import b64encode

import netCDF4
import numpy as np
import pytest

from pdfem_mpi.deck.loads import BodyForce, Support, Traction
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.measure.displacement import displacement_at
from pdfem_mpi.mesh.generators import box
from pdfem_mpi.mesh.reader import read_mesh
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import Silence, build, make_scene

CELLS = 10, 2, 2
SAG = -1.7284011e-3
SAG_DIGITS = 3e-8  # of the independent program's number as it is printed
STRAIN = 1e-3
ROUND_OFF = 1e-8  # a linear field is in the elements' space: what is left is the solver's tolerance of 1e-10
BODY = Region(name="body", model="finite_elements")


@pytest.fixture(scope="module")
def bar():
    """Nodes, cells and nodes of sets, counted from 1, as text rows of an Abaqus file."""
    mesh = box((0.0, 0.0, 0.0), (10.0, 2.0, 2.0), CELLS)
    x, _, z = mesh.nodes.T
    return {
        "mesh": mesh,
        "nodes": [f"{k}, {a!r}, {b!r}, {c!r}" for k, (a, b, c) in enumerate(mesh.nodes.tolist(), 1)],
        "cells": [", ".join(map(str, (k, *(cell + 1)))) for k, cell in enumerate(mesh.cells, 1)],
        "clamp": (np.flatnonzero(x == 0.0) + 1).tolist(),
        "tip": (np.flatnonzero((x == 10.0) & (z == 0.0)) + 1).tolist(),
    }


def abaqus(bar, *blocks):
    """Text of an Abaqus file with the nodes and some blocks of rows."""
    rows = ["*HEADING", "bar of 10 x 2 x 2 cells", "*NODE", *bar["nodes"]]
    for block in blocks:
        rows += [block] if isinstance(block, str) else block
    return "\n".join(rows) + "\n"


def solve(path, loads, supports=()):
    """Body and fields at load factor 1."""
    mesh = FileMesh(path=str(path))
    scene = make_scene(CELLS, regions=(BODY,), loads=loads, supports=supports, solver="cg", tolerance=1e-10, mesh=mesh)
    body = build(scene)
    solver = make_solver(scene, body.share, body.forces, body.case, Silence().line)
    assert len(list(follow_load_program(scene, solver, None, body.state, body.case))) == 1
    return body.geometry, body.fields(body.state.u)


def assert_pulled(path, **end):
    """E/E0 = 1 in the whole bar: the displacement is the closed form's at every node."""
    loads = (
        Traction(kind="traction", total=(4.0, 0.0, 0.0), **(end or {"face": "x+"})),
        Traction(kind="traction", total=(-4.0, 0.0, 0.0), face="x-"),
    )
    geometry, fields = solve(path, loads)
    assert len(geometry.mesh.cells) == 40
    x, u = geometry.mesh.nodes[:, 0], fields.u_nodes[:, 0]
    np.testing.assert_allclose(u - u[0], STRAIN * (x - x[0]), rtol=0, atol=ROUND_OFF * STRAIN * 10.0)


def assert_propped(path, clamp="clamp", tip="tip"):
    """The sag of the bar with its prop, and none at the prop."""
    supports = Support(set=clamp, x=0.0, y=0.0, z=0.0), Support(set=tip, z=0.0)
    geometry, fields = solve(path, (BodyForce(kind="body_force", region="body", density=(0.0, 0.0, -0.01)),), supports)
    assert displacement_at(geometry, fields, (5.0, 1.0, 1.0))[2] == pytest.approx(SAG, rel=SAG_DIGITS)
    assert displacement_at(geometry, fields, (10.0, 1.0, 0.0))[2] == 0.0


def with_sets(bar, clamp, tip):
    return abaqus(bar, "*ELEMENT, TYPE=C3D8, ELSET=body", bar["cells"], clamp, tip)


def rows_of(numbers, comma=", "):
    return [comma.join(map(str, numbers))]


# --- Abaqus: what was read by half, or refused with a wrong remedy ---------------------------------------------------

SOLIDS = "*ELEMENT, TYPE=C3D8, ELSET=body"
PULLED = {
    "clean": lambda cells: [SOLIDS, cells],
    "comment between elements": lambda cells: [SOLIDS, cells[:20], "** next layer", cells[20:]],
    "blank line between elements": lambda cells: [SOLIDS, cells[:20], "", "   ", cells[20:]],
    "comment after the keyword": lambda cells: [SOLIDS, "** number, nodes", cells],
    "comment between two lines of one keyword": lambda cells: ["*ELEMENT, TYPE=C3D8,", "** who", "ELSET=body", cells],
    "keyword on two lines": lambda cells: ["*ELEMENT, TYPE=C3D8,", "ELSET=body", cells],
    "keyword on three lines": lambda cells: ["*ELEMENT,", " TYPE=C3D8,", " ELSET=body", cells],
    "range of two numbers": lambda cells: [SOLIDS, cells, "*ELSET, ELSET=all, GENERATE", "1, 40"],
    "two ranges": lambda cells: [SOLIDS, cells, "*ELSET, ELSET=all, GENERATE", "1, 39, 2", "2, 40, 2"],
    "one set over two blocks": lambda cells: [SOLIDS, cells[:20], SOLIDS, cells[20:]],
    "blocks with and without a set": lambda cells: [SOLIDS, cells[:20], "*ELEMENT, TYPE=C3D8", cells[20:]],
    "lower case": lambda cells: ["*element, type=c3d8r, elset=Body", cells],
    "blanks in keywords": lambda cells: [" *ELEMENT , TYPE = C3D8 , ELSET = body ", cells],
    "element on two lines": lambda cells: [SOLIDS, cells[0].replace(", ", ",\n", 5).replace("\n", " ", 4), cells[1:]],
    "a spring beside": lambda cells: [SOLIDS, cells, "*ELEMENT, TYPE=SPRINGA, ELSET=sp", "90, 1, 2"],
    "trusses and shells beside": lambda cells: [
        "*ELEMENT, TYPE=T3D2", "90, 1, 2", SOLIDS, cells, "*ELEMENT, TYPE=S4R, ELSET=skin", "91, 1, 2, 13, 12"
    ],
    "a block without rows": lambda cells: [SOLIDS, cells, "*ELEMENT, TYPE=C3D8, ELSET=none", "*NSET, NSET=none"],
    "a set before the elements": lambda cells: ["*ELSET, ELSET=some", "1, 2", SOLIDS, cells],
    "a part, an instance and a reference point": lambda cells: [
        SOLIDS, cells, "*END PART", "*ASSEMBLY, NAME=a", "*INSTANCE, NAME=p-1, PART=p", "*END INSTANCE",
        "*NODE", "1, 99.0, 0.0, 0.0", "*NSET, NSET=rp", "1", "*NSET, NSET=left, INSTANCE=p-1", "1, 12", "*END ASSEMBLY",
    ],
}  # fmt: skip


@pytest.mark.parametrize("case", PULLED)
def test_abaqus_files_give_the_whole_body(tmp_path, bar, case):
    text = abaqus(bar, *PULLED[case](bar["cells"]))
    if "END PART" in text:
        text = text.replace("*NODE", "*PART, NAME=p\n*NODE", 1)
    (tmp_path / "bar.inp").write_text(text)
    assert_pulled(tmp_path / "bar.inp")


SETS = {
    "blanks before commas": lambda c, t: (
        ["*NSET, NSET=clamp", *rows_of(c, " , ")],
        ["*NSET, NSET=tip", *rows_of(t, " , ")],
    ),
    "a comma at the end": lambda c, t: (
        ["*NSET, NSET=clamp", *(f"{k}," for k in c)],
        ["*NSET, NSET=tip", *(f"{k}," for k in t)],
    ),
    "a set of sets": lambda c, t: (
        ["*NSET, NSET=a", *rows_of(c[:4]), "*NSET, NSET=b", *rows_of(c[4:]), "*NSET, NSET=clamp", "a, b"],
        ["*NSET, NSET=t", *rows_of(t), "*NSET, NSET=tip", "T"],
    ),
    "a set of a set and numbers": lambda c, t: (
        ["*NSET, NSET=a", *rows_of(c[:4]), "*NSET, NSET=clamp", f"a, {c[4]}", *rows_of(c[5:])],
        ["*NSET, NSET=tip", "later", "*NSET, NSET=later", *rows_of(t)],
    ),
    "names in another case": lambda c, t: (["*Nset, nset=CLAMP", *rows_of(c)], ["*nset, NSET=Tip", *rows_of(t)]),
    "parts in two cases": lambda c, t: (
        ["*NSET, NSET=Clamp", *rows_of(c[:4]), "*NSET, NSET=CLAMP", *rows_of(c[4:])],
        ["*NSET, NSET=tip", *rows_of(t)],
    ),
    "a range and a list": lambda c, t: (
        ["*NSET, NSET=clamp, GENERATE", f"{c[0]}, {c[-1]}, 11"],
        ["*NSET, NSET=tip", f"{t[0]}", "** the others", *rows_of(t[1:])],
    ),
    "a set of nodes of elements": lambda c, t: (
        ["*NSET, NSET=clamp", *rows_of(c)],
        [
            "*ELEMENT, TYPE=T3D2, ELSET=edge",
            f"91, {t[0]}, {t[1]}",
            f"92, {t[1]}, {t[2]}",
            "*NSET, NSET=tip, ELSET=edge",
        ],
    ),
}


@pytest.mark.parametrize("case", SETS)
def test_abaqus_sets_hold_all_of_their_nodes(tmp_path, bar, case):
    (tmp_path / "bar.inp").write_text(with_sets(bar, *SETS[case](bar["clamp"], bar["tip"])))
    assert_propped(tmp_path / "bar.inp")


def test_the_block_of_nodes_makes_a_set(tmp_path, bar):
    """*NODE, NSET= as CalculiX and cgx write it, in two blocks, with exponents written with D."""
    tip = [row for row in bar["nodes"] if int(row.split(",")[0]) in bar["tip"]]
    others = [row for row in bar["nodes"] if row not in tip]
    tip = [re.sub(r"([\d.]+)$", lambda m: f"{float(m[1]):.3e}".replace("e", "D"), row) for row in tip]
    rows = [
        "*NODE",
        *others,
        "*NODE, NSET=tip",
        *tip,
        SOLIDS,
        *bar["cells"],
        "*NSET, NSET=clamp",
        *rows_of(bar["clamp"]),
    ]
    (tmp_path / "bar.inp").write_text("\n".join(rows) + "\n")
    assert_propped(tmp_path / "bar.inp")


def test_surfaces_of_element_faces_carry_loads(tmp_path, bar):
    """Sides of a set of elements, and of single ones; S4 is the side x+ of these cells."""
    rows = [
        SOLIDS,
        bar["cells"],
        "*ELSET, ELSET=last",
        "10, 20",
        "*SURFACE, NAME=End, TYPE=ELEMENT",
        "last, S4",
        "30, S4",
        "40, s4",
    ]
    (tmp_path / "bar.inp").write_text(abaqus(bar, *rows))
    assert_pulled(tmp_path / "bar.inp", set="end")


# --- the other formats ----------------------------------------------------------------------------------------------


def lz4(data):
    """One block of literals: what a compressor writes that finds nothing to save."""
    head = bytes([0xF0]) + b"\xff" * ((len(data) - 15) // 255) + bytes([(len(data) - 15) % 255])
    return head + data


PACKERS = {"vtkLZ4DataCompressor": lz4, "vtkZLibDataCompressor": zlib.compress, "vtkLZMADataCompressor": lzma.compress}


@pytest.mark.parametrize("compressor", PACKERS)
def test_compressed_vtu_files(tmp_path, bar, compressor):
    mesh = bar["mesh"]

    def array(name, values, kind, more=""):
        data = np.ascontiguousarray(values).tobytes()
        half = len(data) // 2 // 8 * 8 or len(data)
        blocks = [data[:half], data[half:]] if 2 * half >= len(data) else [data]
        packed = [PACKERS[compressor](block) for block in blocks]
        size = len(blocks[0])
        head = np.array([len(blocks), size, len(blocks[-1]) % size, *map(len, packed)], "<u4").tobytes()
        text = (b64encode(head) + b64encode(b"".join(packed))).decode()
        return f'<DataArray type="{kind}" Name="{name}" {more} format="binary">\n{text}\n</DataArray>'

    cells = "".join(
        array(name, values, kind)
        for name, values, kind in (
            ("connectivity", mesh.cells.astype("<i8").reshape(-1), "Int64"),
            ("offsets", np.arange(8, 328, 8, dtype="<i8"), "Int64"),
            ("types", np.full(40, 12, "u1"), "UInt8"),
        )
    )
    points = array("Points", mesh.nodes.reshape(-1), "Float64", 'NumberOfComponents="3"')
    (tmp_path / "bar.vtu").write_text(
        f'<?xml version="1.0"?>\n<VTKFile type="UnstructuredGrid" byte_order="LittleEndian" header_type="UInt32" '
        f'compressor="{compressor}"><UnstructuredGrid><Piece NumberOfPoints="99" NumberOfCells="40">\n<Points>{points}'
        f"</Points><Cells>{cells}</Cells></Piece></UnstructuredGrid></VTKFile>\n"
    )
    assert_pulled(tmp_path / "bar.vtu")


def legacy(mesh, types, rows):
    """Text of a legacy VTK file."""
    flat = "\n".join(" ".join(map(str, (len(row), *row))) for row in rows)
    return (
        f"# vtk DataFile Version 3.0\nbar\nASCII\nDATASET UNSTRUCTURED_GRID\nPOINTS {len(mesh.nodes)} double\n"
        + "\n".join(" ".join(map(repr, x)) for x in mesh.nodes.tolist())
        + f"\nCELLS {len(rows)} {sum(len(row) + 1 for row in rows)}\n{flat}\nCELL_TYPES {len(types)}\n"
        + "\n".join(map(str, types))
        + "\n"
    )


def test_voxels_beside_hexahedra_are_cells(tmp_path, bar):
    """Half of the cells are VTK voxels, which number their nodes along the axes; all forty count."""
    mesh = bar["mesh"]
    rows = [cell[[0, 1, 3, 2, 4, 5, 7, 6]] if k % 2 else cell for k, cell in enumerate(mesh.cells)]
    (tmp_path / "bar.vtk").write_text(legacy(mesh, [11 if k % 2 else 12 for k in range(40)], rows))
    assert_pulled(tmp_path / "bar.vtk")
    np.testing.assert_array_equal(read_mesh(FileMesh(path=str(tmp_path / "bar.vtk"))).mesh.cells, mesh.cells)


def gmsh_4_0(mesh):
    """Text of the format 4.0: two volumes in groups of their own, and a surface and both volumes in one."""
    end = mesh.faces_on_face("x-")[1]
    blocks = [(2, 5, 3, end), (3, 1, 5, mesh.cells[:20]), (3, 2, 5, mesh.cells[20:])]
    rows = ["$MeshFormat", "4 0 8", "$EndMeshFormat", "$PhysicalNames", "4", '2 1 "fix"', '3 1 "lower"', '3 2 "upper"']
    rows += ['3 3 "fix"', "$EndPhysicalNames", "$Entities", "1 0 1 2", "7 0 0 0 0 0 0 0", "5 0 0 0 0 2 2 1 1 0"]
    rows += ["1 0 0 0 10 2 1 2 1 3 1 -5", "2 0 0 1 10 2 2 2 2 3 1 5", "$EndEntities", "$Nodes", f"2 {len(mesh.nodes)}"]
    rows += ["7 0 0 1", "1 " + " ".join(map(repr, mesh.nodes[0].tolist())), f"1 3 0 {len(mesh.nodes) - 1}"]
    rows += [f"{k} " + " ".join(map(repr, x)) for k, x in enumerate(mesh.nodes.tolist(), 1)][1:]
    rows += ["$EndNodes", "$Elements", f"3 {sum(len(nodes) for *_, nodes in blocks)}"]
    number = 0
    for dimension, tag, kind, nodes in blocks:
        rows.append(f"{tag} {dimension} {kind} {len(nodes)}")
        for row in nodes:
            number += 1
            rows.append(" ".join(map(str, (number, *(row + 1)))))
    return "\n".join([*rows, "$EndElements", ""])


def test_gmsh_files_of_version_4_0(tmp_path, bar):
    (tmp_path / "bar.msh").write_text(gmsh_4_0(bar["mesh"]))
    assert_pulled(tmp_path / "bar.msh")


def test_a_support_on_a_name_of_surfaces_and_volumes_holds_the_surfaces(tmp_path, bar):
    """Groups of two dimensions with one name: nine nodes are held, and not the whole body."""
    (tmp_path / "bar.msh").write_text(gmsh_4_0(bar["mesh"]))
    mesh = read_mesh(FileMesh(path=str(tmp_path / "bar.msh"))).mesh
    assert len(mesh.cell_sets["fix"]) == 40 and len(mesh.face_sets["fix"]) == 4
    scene = make_scene(
        CELLS, regions=(BODY,), loads=(), supports=(Support(set="fix", x=0.0, y=0.0, z=0.0),),
        mesh=FileMesh(path=str(tmp_path / "bar.msh")),
    )  # fmt: skip
    assert np.count_nonzero(build(scene).case.fixed) == 3 * 9


def exodus(path, mesh, shells, spheres=0):
    """Write the bar with the side set surface_2 at x+, perhaps with shells or points in a block before it."""
    blocks = [("HEX8", mesh.cells)] + [("SHELL4", mesh.faces_on_face("x+")[1])] * shells
    blocks += [("SPHERE", np.arange(spheres)[:, None])] * bool(spheres)
    with netCDF4.Dataset(path, "w", format="NETCDF3_64BIT_OFFSET") as file:
        for name, size in (
            ("num_dim", 3),
            ("num_nodes", len(mesh.nodes)),
            ("num_el_blk", len(blocks)),
            ("num_side_sets", 2),
        ):
            file.createDimension(name, size)
        file.createDimension("num_elem", sum(len(nodes) for _, nodes in blocks))
        for axis, x in zip("xyz", mesh.nodes.T, strict=True):
            file.createVariable(f"coord{axis}", "f8", ("num_nodes",))[:] = x
        for k, (kind, nodes) in enumerate(blocks, 1):
            file.createDimension(f"num_el_in_blk{k}", len(nodes))
            file.createDimension(f"num_nod_per_el{k}", nodes.shape[1])
            rows = file.createVariable(f"connect{k}", "i4", (f"num_el_in_blk{k}", f"num_nod_per_el{k}"))
            rows.elem_type = kind
            rows[:] = nodes + 1
        file.createVariable("ss_prop1", "i4", ("num_side_sets",))[:] = [1, 2]
        for k, (first, side) in enumerate(((1, 4), (10, 2)), 1):
            file.createDimension(f"num_side_ss{k}", 4)
            file.createVariable(f"elem_ss{k}", "i4", (f"num_side_ss{k}",))[:] = first + 10 * np.arange(4)
            file.createVariable(f"side_ss{k}", "i4", (f"num_side_ss{k}",))[:] = side


@pytest.mark.parametrize(("suffix", "shells", "spheres"), [(".g", 0, 0), (".e", 1, 0), (".gen", 1, 3), (".ex2", 0, 5)])
def test_side_sets_of_exodus_files(tmp_path, bar, suffix, shells, spheres):
    """Suffixes of Cubit and others; side sets survive shells and points beside the hexahedra."""
    path = tmp_path / f"bar{suffix}"
    exodus(path, bar["mesh"], shells, spheres)
    assert len(read_mesh(FileMesh(path=str(path))).mesh.face_sets["surface_2"]) == 4
    assert_pulled(path, set="surface_2")


def test_what_is_left_out_is_told_with_its_number(tmp_path, bar):
    rows = [
        SOLIDS,
        bar["cells"],
        "*ELEMENT, TYPE=SPRINGA, ELSET=sp",
        "90, 1, 2",
        "91, 2, 3",
        "*STEP",
        "*STATIC",
        "*END STEP",
    ]
    (tmp_path / "bar.inp").write_text(abaqus(bar, *rows).replace("*ELEMENT", "500, 9.0, 9.0, 9.0\n*ELEMENT", 1))
    notes = read_mesh(FileMesh(path=str(tmp_path / "bar.inp"))).mesh.notes
    assert any(
        re.fullmatch(r"left out 2 cells of type spring \(SPRINGA, line \d+\): they carry nothing here", n)
        for n in notes
    )
    assert "only the mesh is read; passed over: *END STEP, *STATIC, *STEP" in notes
    assert "left out 1 nodes that no hexahedron has" in notes


def test_an_empty_set_in_a_support_is_refused(tmp_path, bar):
    """Named in the file and without members, or with members off the body only."""
    rows = [SOLIDS, bar["cells"], "*NSET, NSET=none", "*NSET, NSET=off", "500", "*ELSET, ELSET=nothing"]
    text = abaqus(bar, *rows).replace("*ELEMENT", "500, 9.0, 9.0, 9.0\n*ELEMENT", 1)
    (tmp_path / "bar.inp").write_text(text)
    for name in ("none", "off", "NOTHING"):
        with pytest.raises(SceneError) as caught:
            solve(tmp_path / "bar.inp", (), (Support(set=name, x=0.0, y=0.0, z=0.0),))
        assert caught.value.messages[0].startswith(f'supports.0.set = "{name}" is an empty set: the mesh file names it')
