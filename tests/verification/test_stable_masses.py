"""Masses that bound the stiffness: no eigenvalue of ``M^-1 K`` exceeds 4, whatever the body, at a time step of 1.

All eigenvalues of small bodies, from their forces; rods one cell thick are the ones that eq. (11) does not bound.
"""

import dataclasses

import numpy as np
import pytest

from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.mesh import generators
from pdfem_mpi.peridynamics.bonds import fictitious_masses
from pdfem_mpi.peridynamics.stable_masses import LIMIT, RAISED, stable_densities
from pdfem_mpi.stepping import make_solver
from support.bodies import build, make_scene
from support.measure import spectrum
from support.mesh_files import write_mesh

ROUND_OFF = 1e-9  # relative, of eigenvalues
#: Largest eigenvalue of a bar of 5 x 1 x 1 cells with the masses of eq. (11), by correction: both beyond 4.
UNSTABLE = {"appendix_a": 4.28, "virial": 4.27}
JITTER = 0.25  # of a cell's edge
CORRECTIONS = [("none", "free"), ("appendix_a", "free"), ("virial", "free"), ("fitted", "free"), ("fitted", "bounded")]


def densities(body):
    """Those of eq. (11), and what is made of them."""
    model = body.model
    of_eq_11 = fictitious_masses(model.comm, model.points, model.bonds)
    return of_eq_11, stable_densities(model.comm, model.points, model.bonds, of_eq_11)


def check(body):
    """The bound holds, and a body that eq. (11) bounds keeps its masses to the bit; the largest eigenvalue."""
    model = body.model
    top = spectrum(body)[-1]
    of_eq_11, stable = densities(body)
    n = 3 * model.unknowns.n_points
    free = np.repeat(of_eq_11.reshape(-1, 1, W)[: 2 * model.points.n_free], 3, axis=1).reshape(-1)
    assert model.raised_masses == stable.raised
    assert ((model.mass[:n] == free).all()) == (stable.raised == 0)
    assert (model.mass[:n] >= free).all()
    assert stable.bound <= (RAISED if stable.raised else LIMIT)
    if not model.elements and not model.overlap:
        assert top <= stable.bound * (1.0 + ROUND_OFF)
    assert top <= LIMIT * (1.0 - ROUND_OFF)
    return top


def cases():
    """Rods, plates one cell thick and blocks with every correction; few by default."""
    for correction, signs in CORRECTIONS:
        for kinematics in ("linear", "finite"):
            for cells in ((1, 1, 1), (2, 1, 1), (5, 1, 1), (3, 2, 1), (3, 3, 1), (2, 2, 2), (3, 2, 2)):
                default = (cells, correction, kinematics) in (
                    ((5, 1, 1), "appendix_a", "linear"),
                    ((5, 1, 1), "virial", "finite"),
                    ((1, 1, 1), "none", "linear"),
                    ((3, 3, 1), "appendix_a", "finite"),
                    ((2, 2, 2), "fitted", "linear"),
                )
                marks = () if default else pytest.mark.slow
                yield pytest.param(cells, correction, signs, kinematics, marks=marks)


@pytest.mark.parametrize(("cells", "correction", "signs", "kinematics"), list(cases()))
def test_thin_bodies(cells, correction, signs, kinematics):
    """Raised in rods, which eq. (11) leaves unstable, and nowhere in plates with a correction of the paper's kind."""
    body = build(make_scene(cells, correction=correction, signs=signs, kinematics=kinematics), loaded=False)
    check(body)
    if cells == (5, 1, 1) and correction in UNSTABLE:
        plain = spectrum(body, np.repeat(densities(body)[0].reshape(-1, 1, W), 3, axis=1).reshape(-1))[-1]
        assert plain == pytest.approx(UNSTABLE[correction], abs=0.01)
        assert body.model.raised_masses == 40
    if cells == (3, 3, 1) and correction != "fitted":
        assert body.model.raised_masses == 0


@pytest.mark.parametrize("cells", [(8, 4, 4), (6, 6, 1), (12, 2, 2)], ids=str)
@pytest.mark.parametrize("correction", ["none", "appendix_a", "virial"])
def test_thicker_bodies_keep_the_masses_of_the_paper(cells, correction):
    """The bound of bars and plates is below 4 with eq. (11), so the paper's counts of iterations stay."""
    body = build(make_scene(cells, correction=correction), loaded=False)
    of_eq_11, stable = densities(body)
    assert stable.raised == 0
    assert stable.values is of_eq_11
    assert stable.bound < LIMIT


@pytest.mark.parametrize("coupling", ["paper", "paper_a"])
@pytest.mark.parametrize(("cells", "n_elements"), [((5, 1, 1), 2), ((5, 1, 1), 4), ((4, 2, 1), 2)], ids=str)
def test_coupled_rods(cells, n_elements, coupling):
    """Raised densities of the overlap's points pass to its nodes, whose elements have the masses of eq. (22)."""
    check(build(make_scene(cells, n_elements, coupling=coupling), loaded=False))


JITTERED = [
    pytest.param((5, 1, 1), 2, "virial"),
    *(
        pytest.param(cells, seed, correction, marks=pytest.mark.slow)
        for cells in ((5, 1, 1), (3, 2, 1), (1, 1, 1))
        for seed in range(6)
        for correction in ("none", "appendix_a", "virial")
        if (cells, seed, correction) != ((5, 1, 1), 2, "virial")
    ),
]


@pytest.mark.parametrize(("cells", "seed", "correction"), JITTERED)
def test_jittered_cells(cells, seed, correction, tmp_path):
    """No two cells are alike, and none has a symmetry that a bound could lean on."""
    box = generators.box((0.0, 0.0, 0.0), tuple(map(float, cells)), cells)
    nodes = box.nodes + np.random.default_rng(seed).uniform(-JITTER, JITTER, box.nodes.shape)
    path = tmp_path / "jittered.inp"
    write_mesh(path, dataclasses.replace(box, nodes=nodes))
    mesh = FileMesh(kind="file", path=str(path), spacing=1.0)
    check(build(make_scene(cells, correction=correction, mesh=mesh, loads=()), loaded=False))


TWO_MATERIALS = {
    "materials": {"hard": Material(youngs_modulus=1e6)},
    "regions": (
        Region(name="a", model="peridynamics", upper=(2.0, 1.0, 1.0)),
        Region(name="b", model="peridynamics", material="hard", lower=(2.0, 0.0, 0.0)),
    ),
}
NOTCH = Crack(polygon=((2.45, -1.0, -1.0), (2.45, 9.0, -1.0), (2.45, 9.0, 0.6), (2.45, -1.0, 0.6)))


@pytest.mark.parametrize(
    "options",
    [
        {"loads": (), **TWO_MATERIALS},
        {"cracks": (NOTCH,)},
        {"internal_length": 2.0},
        {"internal_length": 0.5},
        {"symmetry": ("x-",)},
        {"symmetry": ("z-", "z+")},
    ],
    ids=["contrast of 1000", "notch", "long bonds", "short bonds", "mirror plane", "plane strain"],
)
def test_other_rods(options):
    """Stored bond constants are what counts: materials, cracks, lengths, and images beyond mirror planes."""
    check(build(make_scene((5, 1, 1), **options), loaded=False))


def test_half_a_rod_has_the_masses_of_the_whole():
    """Images count: the bound of the part is that of the body."""
    whole = build(make_scene((6, 1, 1)), loaded=False).model
    half = build(
        make_scene((3, 1, 1), symmetry=("x-",)), loaded=False
    ).model  # the other half of the bar, beyond x = 0, is its image
    assert half.raised_masses * 2 == whole.raised_masses == 48
    np.testing.assert_allclose(half.mass, whole.mass[len(whole.mass) // 2 :], rtol=ROUND_OFF)


HELD = (Support(face="x-", x=0.0, y=0.0, z=0.0),)
PULL = (BodyForce(kind="body_force", face="x+", total=(1.0, 0.1, 0.0)),)


@pytest.mark.parametrize("correction", ["appendix_a", "virial"])
def test_a_rod_relaxes_to_the_answer_of_conjugate_gradients(correction):
    """Six cells in a row, clamped and pulled askew: relaxation diverged with the masses of eq. (11)."""
    found = []
    for solver in ("adr", "cg"):
        scene = make_scene((6, 1, 1), correction=correction, loads=PULL, supports=HELD, solver=solver, tolerance=1e-9)
        body, told = build(scene), []
        make_solver(scene, body.share, body.forces, body.case, told.append)(body.state, body.case.external)
        found.append(body.state.u)
        assert [text.startswith("relaxation: the masses") for text in told] == [True] * (solver == "adr")
    assert np.abs(found[0] - found[1]).max() <= 1e-6 * np.abs(found[1]).max()


def test_relaxation_that_takes_over_has_stable_masses_too():
    """Where conjugate gradients break down, a rod goes on with masses that bound its stiffness."""
    scene = make_scene((6, 1, 1), loads=PULL, supports=HELD, solver="cg", tolerance=1e-8)
    body = build(scene)
    assert body.model.raised_masses == 0  # nothing is spent on what may never be needed
    solve = make_solver(scene, body.share, body.forces, body.case, lambda text: None)
    body.state.program["relaxing"] = 1
    assert solve(body.state, body.case.external).residual <= 1e-8
    assert body.forces.model.raised_masses == 48
