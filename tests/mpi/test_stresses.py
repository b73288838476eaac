"""Strains and stresses have the same bits on any number of ranks."""

import numpy as np
import pytest

from pdfem_mpi import Scene, Simulation
from pdfem_mpi.deck.field_names import GAUSS_FIELDS, MECHANICAL_FIELDS
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.mechanical_probes import CutProbe, PointProbe, SetProbe
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.temperatures import Temperature
from pdfem_mpi.measure.fields import gather_fields
from pdfem_mpi.parallel.comm import broadcast, mpi
from support.bodies import build, make_scene
from support.helpers import assert_all

pytestmark = pytest.mark.mpi(min_size=2)

NAMES = MECHANICAL_FIELDS + GAUSS_FIELDS
CRACK = Crack(polygon=((6.0, -1.0, -1.0), (6.0, 1.7, -1.0), (6.0, 1.7, 4.0), (6.0, -1.0, 4.0)))


def displacement(x):
    """Something that is no field of a low order."""
    return 1e-2 * np.sin(x[:, [1, 2, 0]] + 0.3 * x**2)


@pytest.mark.parametrize("n_elements", [0, 4], ids=["peridynamics", "coupled"])
@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_stresses_do_not_depend_on_the_number_of_ranks(comm, kinematics, n_elements):
    """All fields beside a crack and mirror planes, whose bonds stand on several ranks."""
    mesh = BoxMesh(lower=(0.0, 0.0, 0.0), upper=(9.0, 3.0, 3.0), spacing=1.0, symmetry=("z-",))
    scene = make_scene((9, 3, 3), n_elements, kinematics=kinematics, cracks=(CRACK,), mesh=mesh)
    found = []
    for group in (mpi().COMM_SELF, comm):
        body = build(scene, group, loaded=False)
        u = body.of_positions(displacement)
        u[body.model.rollers] = 0.0
        body.internal(u)
        fields = gather_fields(body.share, body.forces, u, NAMES)
        found.append(broadcast(group, fields and (fields.of_points, fields.of_cells)))
    equal = all(
        set(one) == set(other) and all(np.array_equal(one[name], other[name], equal_nan=True) for name in one)
        for one, other in zip(*found, strict=True)
    )
    assert_all(comm, equal and len(found[0][0]) == len(MECHANICAL_FIELDS), "stresses differ from those of one rank")


def thermal_scene(n_elements):
    """Two materials that expand differently, a load beside, and a probe of each kind."""
    materials = {
        "material": Material(youngs_modulus=1000.0, thermal_expansion=1e-4),
        "materials": {"other": Material(youngs_modulus=3000.0, thermal_expansion=-2e-5)},
        "temperature": Temperature(change=30.0),
    }
    probes = (
        CutProbe(kind="cut", name="cut", point=(4.6, 1.0, 1.0), normal=(1.0, 0.3, 0.0)),
        SetProbe(kind="set", name="set", lower=(1.0, 0.0, 0.0), upper=(8.0, 2.0, 3.0), fields=("stress", "von_mises")),
        PointProbe(kind="point", name="point", point=(5.3, 1.2, 0.4)),
    )
    scene = make_scene((9, 3, 3), n_elements, correction="virial", solver="cg", tolerance=1e-8, probes=probes)
    other = Region(name="other", model="peridynamics", material="other", lower=(5.0, 0.0, 0.0))
    regions = (*scene.regions[:-1], scene.regions[-1].model_copy(update={"upper": (5.0, 3.0, 3.0)}), other)
    return Scene(**(dict(scene) | materials | {"regions": regions}))


@pytest.mark.parametrize("n_elements", [0, 4], ids=["peridynamics", "coupled"])
def test_thermal_strain_and_probes_do_not_depend_on_the_number_of_ranks(comm, n_elements):
    """Displacements in equilibrium, and what probes of cuts, sets and points read."""
    found = []
    for group in (mpi().COMM_SELF, comm):
        simulation = Simulation(thermal_scene(n_elements), group)
        row = simulation.solve(0.7)
        fields, probes = simulation.fields("stress"), simulation.probes()
        found.append(broadcast(group, fields and (row["reaction"], fields.u_points, fields.of_points["stress"])))
        found.append(str(broadcast(group, probes)))
    fields = all(np.array_equal(one, other) for one, other in zip(found[0], found[2], strict=True))
    assert_all(comm, fields, "thermal strains differ from those of one rank")
    assert_all(comm, found[1] == found[3], "probes differ from those of one rank")
