"""Strains and stresses have the same bits on any number of ranks."""

import numpy as np
import pytest

from pdfem_mpi.deck.field_names import GAUSS_FIELDS, MECHANICAL_FIELDS
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.peridynamics import Crack
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
        fields = gather_fields(body.discretization, body.forces, u, NAMES)
        found.append(broadcast(group, fields and (fields.of_points, fields.of_cells)))
    equal = all(
        set(one) == set(other) and all(np.array_equal(one[name], other[name], equal_nan=True) for name in one)
        for one, other in zip(*found, strict=True)
    )
    assert_all(comm, equal and len(found[0][0]) == len(MECHANICAL_FIELDS), "stresses differ from those of one rank")
