"""The damping of block smoothing follows the cells: smaller where they are flat or distorted."""

import numpy as np
import pytest

from pdfem_mpi.deck.loads import Support, Traction
from pdfem_mpi.deck.meshes import PlateWithHoleMesh
from pdfem_mpi.kernels.multigrid import add_block_products
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.solvers.preconditioner.preconditioner import OMEGA, make_preconditioner
from pdfem_mpi.solvers.preconditioner.smoothing import PRODUCT, damping
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import build, make_scene

HELD = (Support(face="x-", x=0.0, y=0.0, z=0.0),)
PULL = (Traction(kind="traction", face="x+", total=(1.0, 0.0, 0.0)),)
# One layer of cells, rings of 12 edges around a hole of 2 cells' radius: broke down with the damping for cubes.
PLATE = PlateWithHoleMesh(lower=(0.0, 0.0, 0.0), upper=(15.0, 13.0, 1.0), hole_radius=2.0, spacing=1.0)


def elements(**keys):
    return build(make_scene((6, 3, 2), 6, loads=PULL, supports=HELD, solver="cg", tolerance=1e-8, **keys))


def largest_eigenvalue(preconditioner):
    """Of ``B^-1 K``, by its whole matrix: columns are answers to unit displacements."""
    free = np.flatnonzero(~preconditioner.fixed)
    n = len(preconditioner.fixed)
    matrix = np.empty((n, len(free)))
    for k, unknown in enumerate(free):
        x, force, step = np.zeros(n), np.empty(n), np.zeros(n)
        x[unknown] = 1.0
        preconditioner.forces.evaluate_surely(x, np.zeros(n), force)
        force[preconditioner.fixed] = 0.0
        add_block_products(preconditioner.cycle.blocks, 1.0, -force, step)
        matrix[:, k] = step
    return float(np.abs(np.linalg.eigvals(matrix[free])).max())


@pytest.mark.parametrize("mesh", [{}, {"mesh": PLATE}], ids=["cubes", "plate"])
def test_the_product_is_kept_and_the_sum_positive(mesh):
    """Damping times the largest eigenvalue is the product within a tenth, and leaves the preconditioner positive."""
    body = elements(**mesh)
    preconditioner = make_preconditioner(body.share, body.model, body.case)
    top = largest_eigenvalue(preconditioner)
    found = preconditioner.cycle.damping * top
    assert PRODUCT <= found < 1.1 * PRODUCT
    assert found * (found - 2.0) < 0.8 * OMEGA * top


def test_gradients_converge_on_distorted_cells():
    """With the damping of cubes the preconditioner was not positive definite, and relaxation took 351 evaluations."""
    body, said = elements(mesh=PLATE), []
    solve = make_solver(body.scene, body.share, body.forces, body.case, said.append)
    (step,) = follow_load_program(body.scene, solve, None, body.state, body.case)
    assert said == [] and step.convergence.evaluations <= 40


def test_nothing_moves():
    """All held: any damping will do."""
    body = elements()
    n = 3 * body.model.nodes.n_owned
    blocks = np.zeros((n // 3, 6))
    assert damping(Forces(body.model), blocks, np.ones(n, bool)) == PRODUCT
