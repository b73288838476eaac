"""A picture of the ranks shows what a run has, also where the run finds by itself where bonds are needed."""

import numpy as np
import pytest

from pdfem_mpi.body.owners import owners_of_cells
from pdfem_mpi.runs.prepare import prepare
from support.adaptive import plate
from support.helpers import assert_all

pytestmark = pytest.mark.mpi(min_size=2)


def test_ranks_of_a_region_that_is_found_are_those_of_its_first_bonds(comm):
    """Bonds weigh more than elements: with elements alone the cells would be dealt out otherwise."""
    share = prepare(plate(), comm)[0]
    owner = owners_of_cells(plate(), comm.size, share.found.turned)
    np.testing.assert_array_equal(owner[share.mesh.cell_id], share.cell_owner)
    three = owners_of_cells(plate(), 3, share.found.turned)  # two halves of a plate with a mirror are the same anyway
    assert_all(comm, (owners_of_cells(plate(), 3) != three).any())
