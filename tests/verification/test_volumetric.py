"""Bonds of any Poisson's ratio against a dense solution that shares no code with the program."""

from dataclasses import replace

import numpy as np
import pytest

from pdfem_mpi.body.cutting import make_share
from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.deck.loads import Support
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import make_load_case
from pdfem_mpi.model.model import build_model
from pdfem_mpi.model.state import new_state
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.solvers.equilibrium import make_solver
from support.bodies import YOUNGS_MODULUS, Body, make_scene
from support.dense_volumetric import VolumetricBody

CELLS, ELEMENTS = (5, 2, 2), 3
#: Nodes move by at most this, in edges; those on the ends stay in their planes.
MOVED = 0.12
#: Of the largest displacement: stored numbers of bonds are float32, 6e-8 each and of either sign; 1.2e-8 is found.
AGREES = 2e-8
PULL, SHEAR = 0.05, 0.03


def irregular(nu, kinematics, correction):
    """An irregular coupled body whose ends are moved, ready to be solved."""
    supports = (Support(face="x-", x=0.0, y=0.0, z=0.0), Support(face="x+", x=PULL, y=SHEAR, z=0.0))
    scene = make_scene(
        CELLS, ELEMENTS, kinematics=kinematics, correction=correction, poissons_ratio=nu, internal_length=1.0, loads=(),
        supports=supports, solver="cg", tolerance=3e-11,
    )  # fmt: skip
    mesh = discretize(scene).mesh
    moves = np.random.default_rng(3).uniform(-MOVED, MOVED, mesh.nodes.shape)
    moves[(mesh.nodes[:, 0] == 0.0) | (mesh.nodes[:, 0] == CELLS[0]), 0] = 0.0
    moved = discretize(scene, replace(mesh, nodes=mesh.nodes + moves))
    share = make_share(scene, moved, mpi().COMM_SELF)
    model = build_model(scene, share, share.comm)
    state = new_state(model)
    return moved, Body(scene, share, model, make_load_case(scene, share, model), Forces(model, state.bounds), state)


@pytest.mark.parametrize(("kinematics", "correction"), [("linear", "virial"), ("finite", "none"), ("finite", "virial")])
@pytest.mark.parametrize("nu", [0.1, 0.33, 0.45])
def test_displacements_of_an_irregular_coupled_body(nu, kinematics, correction):
    discretization, body = irregular(nu, kinematics, correction)
    state = body.state
    state.u[body.case.fixed] = body.case.prescribed[body.case.fixed]
    make_solver(body.scene, body.share, body.forces, body.case, print)(state, body.case.external)
    found = body.fields(state.u)

    mesh = discretization.mesh
    kind = np.where(discretization.is_overlap, "o", np.where(discretization.is_peridynamic, "b", "e"))
    dense = VolumetricBody(
        mesh.nodes,
        mesh.cells,
        kind,
        YOUNGS_MODULUS,
        nu,
        1.0,
        virial=correction == "virial",
        finite=kinematics == "finite",
    )
    prescribed = np.full_like(dense.places, np.nan)
    prescribed[dense.n_free :][dense.places[dense.n_free :, 0] == 0.0] = 0.0
    last = mesh.centroids[dense.free][:, 0] > CELLS[0] - 1.0
    prescribed[: dense.n_free][np.repeat(last, 8)] = PULL, SHEAR, 0.0
    expected = dense.solve(prescribed)
    own = np.repeat(discretization.is_peridynamic[discretization.has_points], 8)
    difference = np.concatenate([found.u_points[own], found.u_nodes]) - expected
    assert np.abs(difference).max() < AGREES * np.abs(expected).max()
