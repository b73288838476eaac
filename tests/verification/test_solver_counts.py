"""Equilibrium in about twenty sweeps, whatever the size: evaluations of conjugate gradients."""

from itertools import pairwise

import pytest

from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.stepping import make_solver
from support.bodies import build, make_scene

# The counts are independent of the size; relaxation needs about 8 N sweeps for a bar of N cells and N^2 in bending.
# Found: 13; 20, 21, 22; 30
TENSION, BENDING, CRACKED = 14, 23, 33
GROWTH = 2  # evaluations more, at most, when the length doubles


def evaluations(scene):
    body = build(scene)
    solve = make_solver(scene, body.share, body.forces, body.case, lambda text: pytest.fail(text))
    return solve(body.state, body.case.external, lambda progress: None).evaluations


def test_count_does_not_grow_with_the_length():
    """Bars of 16 to 128 cells under tension, to 1e-6."""
    counts = [evaluations(make_scene((n, 4, 4), solver="cg")) for n in (16, 32, 64, 128)]
    assert max(counts) <= TENSION
    assert all(after - before <= GROWTH for before, after in pairwise(counts))


@pytest.mark.parametrize("n", [16, 32, 64])
def test_bending(n):
    """Cantilevers under end shear, to 1e-6."""
    loads = (BodyForce(kind="body_force", face="x+", total=(0.0, 0.0, 1e-3)),)
    supports = (Support(face="x-", x=0.0, y=0.0, z=0.0),)
    assert evaluations(make_scene((n, 4, 4), loads=loads, supports=supports, solver="cg")) <= BENDING


def test_crack_through_half_the_width():
    """An edge crack that the coarse space knows nothing of."""
    crack = Crack(polygon=((16.0, -1.0, -1.0), (16.0, 8.0, -1.0), (16.0, 8.0, 4.0), (16.0, -1.0, 4.0)))
    intact = evaluations(make_scene((32, 16, 3), solver="cg"))
    cracked = evaluations(make_scene((32, 16, 3), solver="cg", cracks=(crack,)))
    assert intact < cracked <= CRACKED
