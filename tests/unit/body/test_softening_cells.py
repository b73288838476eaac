"""Planes take the energy of the lattice of those cells whose bonds can soften, and of no others."""

import numpy as np
import pytest

from pdfem_mpi.body.cutting import share_of
from pdfem_mpi.body.found_region import Turning
from pdfem_mpi.body.lattice_planes import energy_of_planes, lattice_energy
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.peridynamics import Peridynamics
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh import generators
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.softening_notes import cells_that_differ
from support.adaptive import plate
from support.bodies import make_scene
from support.softening import softening_material

CUTOFF = 2.5
#: Ten cells twice as long as the six behind them.
COARSE, FINE = 5, 3
X = np.array([0.0, 2.0, 4.0, 6.0, 8.0, 10.0, 11.0, 12.0, 13.0])


def graded(x=X, cells=(COARSE + FINE, 2, 1)):
    """Cells of edge 1 but along x, where they end at the given places."""
    mesh = generators.box((0.0, 0.0, 0.0), (float(cells[0]), float(cells[1]), float(cells[2])), cells)
    nodes = mesh.nodes.copy()
    nodes[:, 0] = x[np.rint(nodes[:, 0]).astype(int)]
    return HexMesh(nodes, mesh.cells)


def strip(model="finite_elements", may_fail=None, **peridynamics):
    """Fine cells of bonds that soften, and coarse ones."""
    box = BoxMesh(lower=(0.0, 0.0, 0.0), upper=(13.0, 2.0, 1.0), spacing=1.0)
    regions = (
        Region(name="coarse", model=model, may_fail=may_fail, upper=(10.0, 2.0, 1.0)),
        Region(name="fine", model="peridynamics", lower=(10.0, 0.0, 0.0)),
    )
    scene = make_scene((13, 2, 1), mesh=box, regions=regions, loads=())
    settings = {"kinematics": "linear", "surface_correction": "virial"} | peridynamics
    return scene.model_copy(update={"material": softening_material(), "peridynamics": Peridynamics(**settings)})


def share(scene, mesh=None):
    return share_of(scene, mpi().COMM_SELF, mesh or graded())


@pytest.mark.parametrize("scene", [strip(), strip("peridynamics", False)], ids=["elements", "bonds that hold"])
def test_coarse_cells_whose_bonds_cannot_soften_do_not_count(scene):
    """Most cells are coarse, of edge sqrt(2) as cubes; those that soften are one internal length long."""
    found = share(scene)
    assert found.typical_edge == pytest.approx(np.sqrt(2.0))
    assert energy_of_planes(scene, found) == lattice_energy(1.0, CUTOFF, "virial")
    assert not list(cells_that_differ(found))


def test_cells_that_differ_are_told_with_the_median():
    scene = strip("peridynamics")
    found = share(scene)
    cells = found.softening_cells
    np.testing.assert_allclose([cells.edge, cells.spread, cells.aspect], [np.sqrt(2.0), np.sqrt(2.0), 2.0], rtol=1e-12)
    (note,) = cells_that_differ(found)
    assert "1.41 times" in note and "median edge, 1.414" in note and "may_fail = false" in note


def test_regions_that_are_found_keep_their_law():
    """Cells count that could be turned, whichever are by now; coarse ones that stay elements do not."""
    auto = (
        Region(name="fine", model="auto", upper=(14.0, 12.0, 1.0)),
        Region(name="coarse", model="auto", always_elements=True, lower=(14.0, 0.0, 0.0)),
    )
    x = np.append(np.arange(15.0), 14.0 + 2.0 * np.arange(1, 21))
    mesh = graded(x, (34, 12, 1))
    scene = plate(auto, remove=()).model_copy(update={"material": softening_material()})
    scene = scene.model_copy(update={"mesh": scene.mesh.model_copy(update={"upper": (54.0, 12.0, 1.0)})})
    none = np.empty(0, np.int64)
    near = Turning(none, np.array([6 + 34 * 5]), 2.0)
    factors = []
    for turning in (None, near):
        found = share_of(scene, mpi().COMM_SELF, mesh, turning)
        factors.append(energy_of_planes(scene, found))
    assert found.found.is_turned.any() and found.typical_edge == pytest.approx(np.sqrt(2.0))
    assert factors == [lattice_energy(1.0, CUTOFF, "virial")] * 2


@pytest.mark.parametrize("correction", ["none", "virial", "appendix_a"])
def test_cells_without_bonds_are_refused(correction):
    """Cells so long that no two of their points are within the cutoff radius."""
    assert lattice_energy(0.16, CUTOFF, correction) == 0.0
    scene = strip(internal_length=0.2, surface_correction=correction)
    with pytest.raises(SceneError, match=r"internal_length = 0.2 is too small for cells of edge 1 .* from 0.5 to 1"):
        energy_of_planes(scene, share(scene))
    scene = strip(internal_length=0.01, cutoff_radius=1.0, surface_correction=correction)  # bonds that weigh nothing
    with pytest.raises(SceneError, match=r"internal_length = 0.01 is too small"):
        energy_of_planes(scene, share(scene))
