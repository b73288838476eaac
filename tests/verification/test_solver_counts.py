"""Equilibrium in about twenty sweeps, whatever the size: evaluations of conjugate gradients."""

from itertools import pairwise

import pytest

from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.solvers.sequence import Sequence
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


#: Linear solves more than at a Poisson's ratio of 1/4, at most.
NEWTON_STEPS = 2


def newton_steps(monkeypatch, nu, n_elements):
    """Linear solves of a bar in finite kinematics whose ends are pulled apart by 2 % and moved across by 10 %."""
    n, run, counted = 12, Sequence.run, []
    supports = (Support(face="x-", x=0.0, y=0.0, z=0.0), Support(face="x+", x=0.02 * n, y=0.1 * n, z=0.0))
    scene = make_scene(
        (n, 3, 3), n_elements, kinematics="finite", correction="virial", poissons_ratio=nu, loads=(), supports=supports,
        solver="cg", tolerance=1e-8,
    )  # fmt: skip
    body = build(scene)
    body.state.u[body.case.fixed] = body.case.prescribed[body.case.fixed]
    solve = make_solver(body.scene, body.share, body.forces, body.case, lambda text: pytest.fail(text))
    with monkeypatch.context() as patched:
        patched.setattr(Sequence, "run", lambda *words, **others: counted.append(run(*words, **others)))
        solve(body.state, body.case.external, lambda progress: None)
    return len(counted)


@pytest.mark.parametrize("n_elements", [0, 6], ids=["bonds", "coupled"])
def test_newton_steps_hardly_depend_on_poissons_ratio(monkeypatch, n_elements):
    """The tangent of the volumetric part is exact: as few linear solves as without it."""
    counts = {nu: newton_steps(monkeypatch, nu, n_elements) for nu in (0.25, 0.1, 0.33, 0.45)}
    assert all(abs(count - counts[0.25]) <= NEWTON_STEPS for count in counts.values()), counts
