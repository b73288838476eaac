"""A surface correction that did not converge is told with the same place and numbers on any number of ranks."""

from dataclasses import replace

import numpy as np
import pytest

from pdfem_mpi.body.cutting import share_of
from pdfem_mpi.body.meshing import make_mesh
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.model.model import build_model
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.correction_notes import describe_correction
from support.bodies import YOUNGS_MODULUS, make_scene
from support.helpers import assert_all

pytestmark = pytest.mark.mpi(min_size=2)

CORNERS = 0.3  # shift of nodes, in cells


def told(comm):
    """Place and sentences of two materials, one cell thick, whose nodes are shifted at random."""
    regions = (
        Region(name="first", model="peridynamics", upper=(2.0, 2.0, 1.0)),
        Region(name="second", model="peridynamics", material="other", lower=(2.0, 0.0, 0.0)),
    )
    materials = {"other": Material(youngs_modulus=0.1 * YOUNGS_MODULUS)}
    scene = make_scene((4, 2, 1), correction="virial", loads=(), regions=regions, materials=materials)
    mesh = make_mesh(scene)
    shift = CORNERS * np.random.default_rng(1).uniform(-1.0, 1.0, mesh.nodes.shape)
    share = share_of(scene, comm, replace(mesh, nodes=mesh.nodes + shift))
    model = build_model(scene, share, comm)
    return model.most_uneven, list(describe_correction(scene, share, model))


def test_the_place_is_the_same_on_any_ranks(comm):
    place, sentences = told(mpi().COMM_SELF)
    found, others = told(comm)
    assert_all(comm, len(sentences) == 1, "the correction converged: nothing is told")
    assert_all(comm, np.array_equal(found, place), f"{found} is not {place}")
    assert_all(comm, others == sentences, "other sentences than on one rank")
