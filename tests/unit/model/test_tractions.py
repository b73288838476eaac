"""Loads on faces that are not flat: totals act in full, pressures close, on elements and on bonds."""

import dataclasses

import numpy as np
import pytest

from pdfem_mpi.deck.loads import Pressure, Support, Traction
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.restraints import Spring
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.mesh.generators import box
from pdfem_mpi.model.tractions import traction_forces
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.simulation import Simulation
from support.bodies import build, make_scene
from support.mesh_files import write_mesh

ROUND_OFF = 1e-13
SOLVED = 1e-7
JITTER = 0.2
CELLS = (5, 3, 3)
BODIES = pytest.mark.parametrize("n_elements", [5, 0, 3], ids=["elements", "bonds", "both"])
END = {"lower": (4.7, -1.0, -1.0), "upper": (9.0, 9.0, 9.0)}  # with all of the jitter
AROUND = {"lower": (-1.0, -1.0, -1.0), "upper": (9.0, 9.0, 9.0)}


@pytest.fixture
def warped(tmp_path):
    """A bar in cells all of whose corners are moved at random."""
    mesh = box((0.0, 0.0, 0.0), tuple(map(float, CELLS)), CELLS)
    shift = np.random.default_rng(3).uniform(-JITTER, JITTER, mesh.nodes.shape)
    write_mesh(tmp_path / "warped.vtu", dataclasses.replace(mesh, nodes=mesh.nodes + shift))
    return FileMesh(kind="file", path=str(tmp_path / "warped.vtu"), spacing=1.0)


def scene_of(mesh, n_elements, loads, **tables):
    scene = make_scene(CELLS, n_elements, correction="virial", mesh=mesh, loads=loads, solver="cg", tolerance=1e-9)
    scene = Scene.model_validate({**dict(scene), **tables})
    if 0 < n_elements < CELLS[0]:  # of centroids, which are moved
        elements, bonds = scene.regions
        wide = {"lower": (-1.0, -1.0, -1.0), "upper": (9.0, 9.0, 9.0)}
        elements = elements.model_copy(update=wide | {"upper": (3.0, 9.0, 9.0)})
        bonds = bonds.model_copy(update=wide | {"lower": (3.0, -1.0, -1.0)})
        scene = scene.model_copy(update={"regions": (elements, bonds)})
    return scene


def resultant(body):
    """Force of the first load, from its parts on nodes and points; the deck's units."""
    (load,), (chosen,) = body.scene.loads, body.share.selections.loads
    nodal, on_points = traction_forces(body.share, load, chosen, "loads.0")
    return (nodal.sum(axis=0) + on_points.sum(axis=(0, 1))) * body.model.units.force


@BODIES
def test_a_total_on_faces_that_are_not_flat_acts_in_full(warped, n_elements):
    load = Traction(kind="traction", total=(9.0, -2.0, 0.5), **END)
    found = resultant(build(scene_of(warped, n_elements, (load,), supports=(Support(x=0.0, y=0.0, z=0.0, **AROUND),))))
    np.testing.assert_allclose(found, load.total, rtol=ROUND_OFF)


def test_a_traction_acts_on_the_same_area_of_elements_and_bonds(warped):
    hold = (Support(x=0.0, y=0.0, z=0.0, **AROUND),)
    load = Traction(kind="traction", traction=(1.0, 0.0, 0.0), **END)
    one, two = (resultant(build(scene_of(warped, n, (load,), supports=hold))) for n in (5, 0))
    np.testing.assert_allclose(one, two, rtol=ROUND_OFF, atol=1e-15)
    assert one[0] > 9.05


@BODIES
def test_a_spring_on_faces_that_are_not_flat_has_its_stiffness(warped, n_elements):
    springs = (Spring(stiffness=(7.0, 0.0, 3.0), **END),)
    body = build(scene_of(warped, n_elements, (), springs=springs))
    found, units = body.model.springs, body.model.units
    along = body.model.unknowns.components()[found.index]
    total = [found.stiffness[along == d].sum() * units.force / units.length for d in range(3)]
    assert total == pytest.approx([7.0, 0.0, 3.0], rel=1e-11)


@BODIES
def test_a_pressure_all_around_is_in_balance(warped, n_elements):
    """A free body under it is at a uniform stress; force and moment vanish as integrals of the normal do."""
    scene = scene_of(warped, n_elements, (Pressure(kind="pressure", pressure=2.0, **AROUND),))
    simulation = Simulation(scene, mpi().COMM_SELF)
    row = simulation.solve(1.0)
    assert row["force_balance"] < ROUND_OFF
    assert row["moment_balance"] < ROUND_OFF
    if n_elements == CELLS[0]:
        stress = np.array(simulation.fields("stress").of_cells["stress"]).reshape(-1, 6)
        np.testing.assert_allclose(stress[:, :3], -2.0, rtol=SOLVED)
        np.testing.assert_allclose(stress[:, 3:], 0.0, atol=2.0 * SOLVED)
