"""What a look at a state remembers, and what is told of cracks where no bonds can be."""

import numpy as np
import pytest

from pdfem_mpi import Simulation
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.parallel.comm import mpi
from support.adaptive import plate


def cracked():
    """A crack along x, from the middle of the plate out of its right end."""
    return (Crack(polygon=((9.0, 6.0, -1.0), (19.0, 6.0, -1.0), (19.0, 6.0, 2.0), (9.0, 6.0, 2.0))),)


def test_only_accepted_states_tell_of_elements_that_stay():
    """The first layer of cells beside a support, stretched to 2.5 times the critical stretch."""
    simulation = Simulation(plate(), mpi().COMM_SELF)
    simulation.displace(lambda x: np.where(x[:, :1] > 0.5, [[0.005, 0.0, 0.0]], 0.0))
    watch, state = simulation.region_watch, simulation.state
    watch.look(state, accepted=False)
    assert state.program["staying"] == 0.0
    watch.look(state)
    assert state.program["staying"] == pytest.approx(2.5, rel=0.3)


def test_a_crack_through_elements_that_stay_is_told():
    """It ends in the held cells, or before them."""
    told = Simulation(plate(remove=(), cracks=cracked()), mpi().COMM_SELF).share.crack_notes
    (note,) = (line for line in told if "must stay elements" in line)
    assert note.startswith("warning: cracks.0 passes through ") and "the first " in note
    inside = (Crack(polygon=((8.0, 6.0, -1.0), (10.0, 6.0, -1.0), (10.0, 6.0, 2.0), (8.0, 6.0, 2.0))),)
    scene = plate(remove=(), cracks=inside)
    assert not any("must stay" in line for line in Simulation(scene, mpi().COMM_SELF).share.crack_notes)
