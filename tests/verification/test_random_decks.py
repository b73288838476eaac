"""Decks drawn from seeds keep what every deck must keep; another evaluation, bond by bond, says so.

One solution a seed serves all tests of it. Where a surface correction does not converge in its twenty sweeps, what they
leave behind is told by the last digits of float32: its factors are then taken from the program (`CORRECTED`).
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache
from pathlib import Path
from tempfile import mkdtemp
from typing import Any

import numpy as np
import pytest

from pdfem_mpi.deck.programs import Solver
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.peridynamics.bonds import total_bonds
from pdfem_mpi.solvers.convergence import NotConverged
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import bond_list, build
from support.dense_reference import DenseBody
from support.random_decks import random_scene
from support.transformed import Transform

SEEDS = range(64)
DEFAULT = (0, 3, 5, 13, 14, 30, 39, 61)
#: Residual in the other evaluation over the sums of the magnitudes of its parts: bond constants are float32, 6e-8.
RESIDUAL = 2e-8
#: Where bonds can break, places are rounded to 2**-24 = 6e-8 internal lengths; the other evaluation does not.
ROUNDED = 1e-7
#: Energy over work in linear statics by the program's own numbers, and by those of the other evaluation (float32).
ENERGY, ENERGY_OF_FLOAT32 = 1e-8, 1e-7
BALANCE = 1e-10
#: The same answer in other units, elsewhere, and mirrored; where a deck's own tolerance is not below that, another
#: place may cost an iteration more or less, and the answer is as good as a few tolerances.
SAME, TOLERANCES = 1e-8, 10.0
#: Load factor at which the first bond is about to break: finite kinematics bracket it to 1e-6.
LOAD = 1e-6
#: Displacements of relaxation to a residual of 1e-9, relative to the largest: some bodies are a hundred times softer
#: in bending than in tension.
RELAXED, RELAXED_TOLERANCE = 1e-5, 1e-9
#: Largest ``|G / g_inf - 1|`` left by the sweeps of a correction that has converged well enough to be the same in
#: float32 and float64.
CORRECTED = 0.2


@dataclass
class Solved:
    """A scene, its last row that is in equilibrium, and the displacements there; ``reason`` where there is none."""

    scene: Scene
    body: Any
    row: Any = None
    fields: Any = None
    reason: str = ""


def solve(scene: Scene) -> Solved:
    """The last load step, or the state in which the first bond is about to break."""
    body = build(scene)
    failure = make_failure(scene, body.share, body.model)
    solver = make_solver(scene, body.share, body.forces, body.case, lambda text: None)
    body.state.began = 0.0
    found = Solved(scene, body)
    try:
        for row in follow_load_program(scene, solver, failure, body.state, body.case, lambda *progress: None):
            found = Solved(scene, body, row, body.fields(body.state.u))
            if scene.stepping.kind == "events":
                break
    except NotConverged as error:
        found.reason = str(error)
    return found


@cache
def folder() -> Path:
    """Where mesh files of the seeds are written."""
    return Path(mkdtemp(prefix="random_decks_"))


@cache
def of_seed(seed: int) -> Solved:
    """The solution of a seed's deck."""
    return solve(random_scene(seed, folder()))


@cache
def reference(seed: int) -> DenseBody:
    """The other body of a seed; fitted factors are those of the program."""
    solved = of_seed(seed)
    fitted, scene = None, solved.scene
    own = scene.has_peridynamics and scene.peridynamics.surface_correction == "fitted"
    if own or (solved.body.model.correction_remaining > CORRECTED and not scene.mesh.symmetry):
        fitted = factors(solved, DenseBody(solved.scene, fitted=np.ones((10**4,) * 2, bool)))
    return DenseBody(solved.scene, fitted)


def factors(solved: Solved, plain: DenseBody) -> np.ndarray:
    """Stored strength of each bond over that without correction, (n_points, n_points); no mirror planes."""
    model = solved.body.model
    x, i, j, stored = bond_list(solved.body)
    share = solved.body.share
    number = share.point_row[share.subdomain.point_cells]
    i, j = (8 * number[k // 8] + k % 8 for k in (i, j))
    r = np.linalg.norm(x[bond_list(solved.body)[2]] - x[bond_list(solved.body)[1]], axis=1)
    strength = np.zeros((len(plain.x),) * 2)
    strength[i, j] = strength[j, i] = (2.0 * stored * r if model.bonds.finite else stored * r**3) * model.units.force
    pairs = plain.pairs
    strength[pairs.i, pairs.j] /= pairs.stiffness
    return strength


def equilibrium(seed: int) -> Solved:
    """The solution of a seed that has one."""
    solved = of_seed(seed)
    assert solved.row is not None, solved.reason
    return solved


def state(seed: int):
    """Displacements, internal forces and magnitudes, energy, loads and what is held, in the other evaluation."""
    solved, dense = equilibrium(seed), reference(seed)
    u = dense.places_of(solved.fields.u_points, solved.fields.u_nodes)
    inner, size, energy = dense.internal(u)
    prescribed = dense.prescribed() * solved.row.load_factor
    return u, inner, size, energy, dense.external() * solved.row.load_factor, prescribed


def seeds(keeps=lambda scene: True):
    """All seeds whose scenes ``keeps`` chooses, most of them slow."""
    return [
        pytest.param(seed, marks=() if seed in DEFAULT else pytest.mark.slow)
        for seed in SEEDS
        if keeps(random_scene(seed, folder()))
    ]


def is_linear(scene: Scene) -> bool:
    return scene.stepping.kind == "steps" and (not scene.has_peridynamics or scene.peridynamics.kinematics == "linear")


def has_bonds(scene: Scene) -> bool:
    return scene.has_peridynamics


@pytest.mark.parametrize("seed", seeds(has_bonds))
def test_bonds_are_those_counted_one_by_one(seed):
    """Cut ones as well, mirror images once."""
    model, dense = of_seed(seed).body.model, reference(seed)
    assert sum(model.cut) == dense.n_cut
    assert total_bonds(model.comm, model.bonds) - sum(model.cut) == dense.n_bonds


@pytest.mark.parametrize("seed", seeds())
def test_forces_balance_in_another_evaluation(seed):
    """Loads, supports, bonds, corrections, elements, overlap: nothing is taken from the program but displacements."""
    u, inner, size, _, external, prescribed = state(seed)
    fixed = ~np.isnan(prescribed)
    residual = (external + inner)[~fixed]
    least = ROUNDED if equilibrium(seed).body.share.units.quantum else RESIDUAL
    assert np.linalg.norm(residual) <= least * np.linalg.norm(size)
    assert np.abs((u - prescribed)[fixed]).max(initial=0.0) <= RESIDUAL * np.abs(u).max()


@pytest.mark.parametrize("seed", seeds(is_linear))
def test_energy_is_half_the_work(seed):
    """In linear statics: by the program's own sums, and by the other evaluation's."""
    solved = equilibrium(seed)
    body, factor = solved.body, solved.row.load_factor
    case, u = body.case, body.state.u
    internal = body.internal(u)
    work = 0.5 * (factor * case.external @ u - internal[case.fixed] @ u[case.fixed])
    assert body.forces.stored_energy(u) == pytest.approx(work, rel=ENERGY)
    units = body.model.units
    assert state(seed)[3] == pytest.approx(work * units.force * units.length, rel=ENERGY_OF_FLOAT32)


@pytest.mark.parametrize("seed", seeds())
def test_forces_and_moments_balance(seed):
    """Net internal forces over the sums of their magnitudes; moments where all that is bent turns with the body."""
    row = equilibrium(seed).row
    assert row.force_balance <= BALANCE
    assert row.moment_balance <= BALANCE


@pytest.mark.parametrize("seed", seeds(lambda scene: scene.stepping.kind == "steps"))
def test_relaxation_comes_to_the_same_equilibrium(seed):
    """Every body relaxes, with masses that bound its stiffness."""
    solved = equilibrium(seed)
    settings = Solver(kind="adr", tolerance=RELAXED_TOLERANCE, max_evaluations=100_000)
    relaxed = solve(solved.scene.model_copy(update={"solver": settings}))
    assert relaxed.row is not None, relaxed.reason
    u, v = solved.body.state.u, relaxed.body.state.u
    assert np.abs(u - v).max() <= RELAXED * np.abs(u).max()


def placed(solved: Solved):
    """Positions and displacements of all points and nodes."""
    d = solved.body.share
    x, u = [], []
    if solved.fields.u_points is not None:
        x.append(solved.body.geometry.point_positions)
        u.append(solved.fields.u_points)
    if solved.fields.u_nodes is not None:
        x.append(d.mesh.nodes[d.node_row >= 0])
        u.append(solved.fields.u_nodes)
    return x, u


@pytest.mark.parametrize("kind", ["units", "translation", "mirror image"])
@pytest.mark.parametrize("seed", seeds())
def test_the_same_answer_in_other_units_elsewhere_and_mirrored(seed, kind):
    """Lengths x 3.7e-3 and stresses x 6,895; moved by (17, -5, 1000) cells; x turned round.

    Of bodies whose bonds can break, other units and another place change no bit.
    """
    from scipy.spatial import cKDTree

    solved = equilibrium(seed)
    cell = solved.scene.mesh.spacing
    transform = {
        "units": Transform(length=3.7e-3, stress=6895.0),
        "translation": Transform(shift=(17.0 * cell, -5.0 * cell, 1000.0 * cell)),
        "mirror image": Transform(mirror=0),
    }[kind]
    other = solve(transform.scene(solved.scene, folder()))
    assert other.row is not None, other.reason
    if solved.body.share.units.quantum and kind != "mirror image":
        assert other.row.load_factor == solved.row.load_factor
        np.testing.assert_array_equal(other.body.state.u, solved.body.state.u)
    assert other.row.load_factor == pytest.approx(solved.row.load_factor, rel=LOAD)
    same = max(SAME, TOLERANCES * solved.scene.solver.tolerance)
    for x, u, y, v in zip(*placed(solved), *placed(other), strict=True):
        there = transform.positions(x)
        distance, index = cKDTree(y).query(there)
        assert distance.max() <= 1e-6 * transform.length * cell
        assert np.abs(v[index] - transform.displacements(u)).max() <= same * np.abs(v).max()
