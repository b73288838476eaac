"""Local damage is the same bits on any number of ranks."""

import numpy as np
import pytest

from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.measure.fields import gather_damage
from pdfem_mpi.parallel.comm import broadcast, mpi
from support.bodies import build, make_scene
from support.helpers import assert_all

pytestmark = pytest.mark.mpi(min_size=2)

CRACK = Crack(polygon=((6.0, -1.0, -1.0), (6.0, 1.7, -1.0), (6.0, 1.7, 4.0), (6.0, -1.0, 4.0)))


@pytest.mark.parametrize("n_elements", [0, 4], ids=["peridynamics", "coupled"])
@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_damage_does_not_depend_on_the_number_of_ranks(comm, kinematics, n_elements):
    """Eq. 5 beside a crack whose bonds stand on several ranks."""
    scene = make_scene((9, 3, 3), n_elements, kinematics=kinematics, cracks=(CRACK,), output=Output(damage=True))
    alone, together = (build(scene, c, loaded=False) for c in (mpi().COMM_SELF, comm))
    expected = gather_damage(alone.share, alone.model)
    found = broadcast(comm, gather_damage(together.share, together.model))
    assert_all(comm, np.array_equal(found, expected) and found.max() > 0.3, "damage differs from that of one rank")
