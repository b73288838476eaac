"""Results are the same bits on any number of ranks, however the cells are shared out among them."""

from contextlib import suppress
from functools import cache, partial

import numpy as np
import pytest

from helpers import assert_all
from pdfem_mpi import model as model_module
from pdfem_mpi.bonds import total_bonds
from pdfem_mpi.fields import fields_sha256, gather_fields
from pdfem_mpi.parallel.comm import broadcast, mpi
from pdfem_mpi.scene import BodyForce, Coupling, SceneError, Support
from pdfem_mpi.solvers import adr
from pdfem_mpi.solvers.convergence import NotConverged
from pdfem_mpi.stepping import follow_load_program
from verification.bodies import build, make_scene

pytestmark = pytest.mark.mpi(min_size=2)

FEW = 12  # evaluations: the waves of both ends have met, bounds were fitted several times

LARGE = 400.0  # force that strains the bar by several per cent: |e| beyond the limit of the series

SCENES = {
    f"{body}, {kinematics}, {correction}": partial(
        make_scene, cells, n_elements, kinematics=kinematics, correction=correction
    )
    for body, (cells, n_elements) in {"coupled": ((9, 3, 2), 4), "peridynamics": ((7, 3, 3), 0)}.items()
    for kinematics in ("linear", "finite")
    for correction in ("none", "appendix_a")
}
SCENES |= {
    "elements": partial(make_scene, (7, 3, 2), 7),
    "elements of another poissons ratio": partial(make_scene, (5, 3, 1), 5, poissons_ratio=0.4),
    "coupled, reading A": partial(make_scene, (9, 3, 2), 4, coupling="paper_a"),
    "coupled, overlap 3": partial(make_scene, (9, 3, 2), 5, overlap=3, kinematics="finite"),
    "coupled plate of one cell": partial(make_scene, (6, 5, 1), 3),
    "large strain": partial(
        make_scene,
        (7, 3, 3),
        0,
        kinematics="finite",
        correction="none",
        loads=(
            BodyForce(kind="body_force", face="x+", total=(LARGE, 0.0, 0.0)),
            BodyForce(kind="body_force", face="x-", total=(-LARGE, 0.0, 0.0)),
        ),
    ),
    "supports": partial(
        make_scene,
        (9, 3, 2),
        4,
        loads=(BodyForce(kind="body_force", face="y+", density=(0.0, 0.02, 0.01)),),
        supports=(Support(face="x-", x=0.0, y=0.0, z=0.0), Support(face="x+", layers=2, x=0.01)),
    ),
}


def solve(body, evaluations=None):
    """Relax a body, for some evaluations or to equilibrium, and return all that must not depend on ranks.

    Collective; the same on every rank of the body's communicator.
    """
    model, case, state = body.model, body.case, body.state
    seen = []
    if evaluations is None:
        for equilibrium in follow_load_program(
            body.scene, body.forces, state, case, lambda step, progress: seen.append(progress)
        ):
            balances = equilibrium.force_balance, equilibrium.moment_balance
            seen.append((equilibrium.convergence, equilibrium.reaction.tolist(), balances))
    else:
        with suppress(NotConverged):
            adr.solve(body.forces, state, case.external, case.fixed, 1e-12, evaluations, seen.append)
        body.internal(state.u)
    fields = gather_fields(body.discretization, body.forces, state.u)
    counts = broadcast(model.comm, body.forces.evaluations), total_bonds(model.comm, model.bonds)
    return broadcast(model.comm, fields and fields_sha256(fields)), counts, seen


@cache
def on_one_rank(name, evaluations):
    """The same by this rank alone."""
    return solve(build(SCENES[name](), mpi().COMM_SELF), evaluations)


@pytest.mark.parametrize("evaluations", [FEW, None], ids=["few iterations", "equilibrium"])
@pytest.mark.parametrize("name", SCENES)
def test_fields_do_not_depend_on_the_number_of_ranks(comm, name, evaluations):
    """Displacements, residuals, damping, reactions and bonds of 1, 2, 3, 4 ranks: equal bits."""
    expected = on_one_rank(name, evaluations)
    found = solve(build(SCENES[name](), comm), evaluations)
    assert_all(comm, found[0] == expected[0], "displacement fields differ")
    assert_all(comm, found[1] == expected[1], "evaluations or bonds differ")
    assert_all(comm, found[2] == expected[2], "residuals, dampings, reactions or balances differ")


def random_owners(discretization, n_parts, seed):
    """Cells dealt out one by one, none left out: every cell has neighbours elsewhere."""
    rng = np.random.default_rng(seed)
    n_cells = len(discretization.mesh.cells)
    owner = rng.integers(0, n_parts, n_cells)
    owner[rng.permutation(n_cells)[:n_parts]] = np.arange(n_parts)
    return owner.astype(np.int32)


def by_model(discretization, n_parts):
    """The last rank has all peridynamic cells and nothing else, the others share the elements."""
    owner = np.arange(len(discretization.mesh.cells)) % max(1, n_parts - 1)
    owner[discretization.has_points & ~discretization.is_overlap] = n_parts - 1
    return owner.astype(np.int32)


def points_without_overlap(discretization, n_parts):
    """Rank 0 has all cells with points, overlap included; the others have elements only."""
    owner = np.arange(len(discretization.mesh.cells)) % max(1, n_parts - 1) + (n_parts > 1)
    owner[discretization.has_points] = 0
    return owner.astype(np.int32)


def single_cell(discretization, n_parts, kind):
    """The last rank owns one cell: of elements, of overlap, or peridynamic."""
    free = discretization.has_points & ~discretization.is_overlap
    chosen = {"element": ~discretization.has_points, "overlap": discretization.is_overlap, "free": free}[kind]
    owner = np.arange(len(chosen)) % max(1, n_parts - 1)
    owner[np.flatnonzero(chosen)[len(np.flatnonzero(chosen)) // 2]] = n_parts - 1
    return owner.astype(np.int32)


def reversed_ranks(discretization, n_parts, partition):
    """The parts of a run, given to the ranks in reverse."""
    return n_parts - 1 - partition(discretization, n_parts)


OWNERS = {
    "random": partial(random_owners, seed=1),
    "random again": partial(random_owners, seed=2),
    "reversed": partial(reversed_ranks, partition=model_module.partition),
    "elements here, points there": by_model,
    "elements only elsewhere": points_without_overlap,
    "a single element": partial(single_cell, kind="element"),
    "a single cell of overlap": partial(single_cell, kind="overlap"),
    "a single peridynamic cell": partial(single_cell, kind="free"),
}


@pytest.mark.parametrize(
    "name", ["coupled, linear, appendix_a", "coupled, finite, appendix_a", "coupled, reading A", "supports"]
)
@pytest.mark.parametrize("owners", OWNERS)
def test_fields_do_not_depend_on_who_owns_what(comm, monkeypatch, owners, name):
    """Any map of cells to ranks gives the same bits, also where a rank has one description only or one cell."""
    expected = on_one_rank(name, FEW)
    monkeypatch.setattr(model_module, "partition", OWNERS[owners])
    found = solve(build(SCENES[name](), comm), FEW)
    assert_all(comm, found[0] == expected[0], "displacement fields differ")
    assert_all(comm, found[1:] == expected[1:], "bonds, residuals or dampings differ")


@pytest.mark.parametrize("cells", [(1, 1, 1), (2, 1, 1), (4, 1, 1)], ids=str)
@pytest.mark.parametrize("model", ["peridynamics", "elements"])
def test_body_with_hardly_more_cells_than_ranks(comm, model, cells):
    """Every rank has a cell or two; one rank too many is refused on all ranks with the number that fits."""
    n_cells = cells[0]
    scene = make_scene(cells, 0 if model == "peridynamics" else n_cells)
    if comm.size > n_cells:
        with pytest.raises(SceneError, match=f"Use at most {n_cells} ranks"):
            build(scene, comm)
        return
    expected = solve(build(scene, mpi().COMM_SELF), FEW)
    found = solve(build(scene, comm), FEW)
    assert_all(comm, found == expected, "results differ")


def test_each_bond_is_on_one_rank(comm):
    """The ranks' numbers of bonds add up, and every rank with points has some."""
    scene = make_scene((12, 3, 3))
    alone = build(scene, mpi().COMM_SELF).model.bonds.count
    model = build(scene, comm).model
    total = total_bonds(comm, model.bonds)
    assert_all(comm, model.bonds.count > 0, "a rank without bonds")
    assert_all(comm, total == alone, "bonds are lost or counted twice")


def test_masses_do_not_depend_on_the_number_of_ranks(comm):
    """Eqs 11 and 22, and the lumped densities of the overlap, node by node and point by point."""
    scene = make_scene((9, 3, 2), 4, coupling="paper_a")
    alone, ours = build(scene, mpi().COMM_SELF).model, build(scene, comm).model

    def by_number(model):
        n = model.n_point_unknowns
        cells = model.points.cell_number[: model.points.n_free]
        nodes = model.nodes.number[: model.nodes.n_owned]
        return dict(zip(cells, model.mass[:n].reshape(-1, 24).tolist(), strict=True)), dict(
            zip(nodes, model.mass[n:].reshape(-1, 3).tolist(), strict=True)
        )

    for found, expected in zip(by_number(ours), by_number(alone), strict=True):
        assert_all(comm, all(expected[number] == row for number, row in found.items()), "masses differ")


def test_problems_of_a_scene_are_found_on_all_ranks_alike(comm):
    """Unbalanced loads, an overlap that does not fit: the same sentences everywhere, nobody left waiting."""
    pull = (BodyForce(kind="body_force", face="x+", total=(1.0, 0.0, 0.0)),)
    scenes = [
        make_scene((6, 2, 2), loads=pull),
        make_scene((6, 2, 2), 3, overlap=1).model_copy(update={"coupling": Coupling(overlap=3)}),
    ]
    sentences = []
    for scene in scenes:
        with pytest.raises(SceneError) as caught:
            build(scene, comm)
        sentences.append(caught.value.messages)
    assert_all(comm, broadcast(comm, sentences) == sentences, "ranks tell different problems")
