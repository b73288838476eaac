"""Results are the same bits on any number of ranks, however the cells are shared out among them."""

from contextlib import suppress
from functools import cache, partial

import numpy as np
import pytest

from pdfem_mpi.body.partitioning import partition
from pdfem_mpi.deck.loads import BodyForce, Force, Pressure, Support, Traction
from pdfem_mpi.deck.materials import Interface, Material
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.peridynamics import Coupling, Crack
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.removals import RemovedBox
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.measure.fields import fields_sha256, gather_fields
from pdfem_mpi.parallel.comm import broadcast, mpi
from pdfem_mpi.peridynamics.bonds import count_by_material, total_bonds
from pdfem_mpi.solvers import adr
from pdfem_mpi.solvers.convergence import NotConverged
from pdfem_mpi.stepping import follow_load_program, make_solver
from support.bodies import build, make_scene, tension
from support.helpers import assert_all
from support.owners import deal_out_by

pytestmark = pytest.mark.mpi(min_size=2)

FEW = 12  # evaluations: the waves of both ends have met, bounds were fitted several times

#: A stiff half-space, a soft ball, bonds of their own between them, and elements of another Poisson's ratio.
MATERIALS = {
    "materials": {
        "stiff": Material(youngs_modulus=3e5),
        "soft": Material(youngs_modulus=7.0),
        "other": Material(youngs_modulus=2e3, poissons_ratio=0.4),
    },
    "interfaces": (Interface(between=("soft", "stiff"), youngs_modulus=100.0),),
    "regions": (
        Region(name="ball", model="peridynamics", material="soft", centre=(6.0, 1.5, 1.0), radius=1.2),
        Region(name="other", model="finite_elements", material="other", upper=(2.0, 3.0, 2.0)),
        Region(name="elements", model="finite_elements", lower=(2.0, 0.0, 0.0), upper=(4.0, 3.0, 2.0)),
        Region(name="bonds", model="peridynamics", lower=(4.0, 0.0, 0.0), upper=(6.0, 3.0, 2.0)),
        Region(name="stiff", model="peridynamics", material="stiff", lower=(6.0, 0.0, 0.0)),
    ),
}

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
    "coupled, virial": partial(make_scene, (9, 3, 2), 4, correction="virial"),
    "coupled, fitted, two bodies": partial(
        make_scene,
        (7, 3, 2),
        correction="fitted",
        coupling="exact",
        materials={"stiff": Material(youngs_modulus=7e3)},
        regions=(
            Region(name="elements", model="finite_elements", upper=(3.0, 3.0, 2.0)),
            Region(name="bonds", model="peridynamics", lower=(3.0, 0.0, 0.0), upper=(5.0, 3.0, 2.0)),
            Region(name="stiff", model="peridynamics", material="stiff", lower=(5.0, 0.0, 0.0)),
        ),
        loads=tension((7, 3, 2), 3),
    ),
    "peridynamics, fitted, bounded": partial(
        make_scene, (4, 3, 2), 0, correction="fitted", signs="bounded", kinematics="finite"
    ),
    "elements": partial(make_scene, (7, 3, 2), 7),
    "elements, finite": partial(make_scene, (7, 3, 2), 7, kinematics="finite", loads=tension((7, 3, 2), 7, 100.0)),
    "elements of another poissons ratio": partial(make_scene, (5, 3, 1), 5, poissons_ratio=0.4),
    "bonds of another poissons ratio": partial(make_scene, (9, 3, 2), 4, poissons_ratio=0.4, correction="virial"),
    "bonds of another poissons ratio, finite": partial(
        make_scene, (7, 3, 2), 3, poissons_ratio=0.1, kinematics="finite", solver="cg"
    ),
    "fitted bonds of another poissons ratio": partial(
        make_scene, (7, 3, 3), 3, poissons_ratio=0.4, correction="fitted", coupling="exact", solver="cg"
    ),
    "bonds of two poissons ratios": partial(
        make_scene,
        (7, 3, 2),
        0,
        poissons_ratio=0.1,
        materials={"other": Material(youngs_modulus=2e3, poissons_ratio=0.4)},
        regions=(
            Region(name="first", model="peridynamics", upper=(3.0, 3.0, 2.0)),
            Region(name="second", model="peridynamics", material="other", lower=(3.0, 0.0, 0.0)),
        ),
        loads=tension((7, 3, 2), 0),
    ),
    "coupled, reading A": partial(make_scene, (9, 3, 2), 4, coupling="paper_a"),
    "coupled, overlap 3": partial(make_scene, (9, 3, 2), 5, overlap=3, kinematics="finite"),
    "four materials": partial(make_scene, (9, 3, 2), 4, **MATERIALS),
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
OUTWARD = (
    BodyForce(kind="body_force", face="x+", total=(1.0, 0.0, 0.0)),
    BodyForce(kind="body_force", face="y+", total=(0.0, 0.5, 0.0)),
)
SCENES |= {
    "quarter": partial(make_scene, (7, 3, 2), 0, loads=OUTWARD, symmetry=("x-", "y-")),
    "quarter of another poissons ratio": partial(
        make_scene, (7, 3, 2), 3, loads=OUTWARD, symmetry=("x-", "y-"), poissons_ratio=0.33
    ),
    "coupled eighth, finite": partial(
        make_scene, (8, 3, 2), 4, loads=OUTWARD, symmetry=("x-", "y-", "z+"), kinematics="finite", coupling="paper_a"
    ),
    "cracked half": partial(
        make_scene,
        (6, 3, 2),
        0,
        symmetry=("y-",),
        cracks=(Crack(polygon=((2.9, -1.0, -1.0), (2.9, 1.2, -1.0), (2.9, 1.2, 3.0), (2.9, -1.0, 3.0))),),
    ),
    "slab of one cell between two mirrors": partial(make_scene, (7, 4, 1), 3, symmetry=("z-", "z+")),
    "rollers, a pin, a pressure and formulas": partial(
        make_scene,
        (9, 3, 2),
        4,
        loads=(
            Force(kind="force", line=((5.0, 3.0, 0.0), (5.0, 3.0, 2.0)), total=(0.0, -1.0, 0.0)),
            Pressure(kind="pressure", face="z+", pressure=0.1),
            Traction(kind="traction", lower=(9.0, 0.0, 0.0), upper=(9.0, 2.0, 2.0), traction=(0.3, 0.1, 0.0)),
        ),
        supports=(
            Support(line=((1.0, 0.0, 0.0), (1.0, 0.0, 2.0)), x=0.0, y="1e-3 * sin(z)"),
            Support(line=((8.0, 0.0, 0.0), (8.0, 0.0, 2.0)), y=0.0),
            Support(face="z-", z="1e-3 * x * y"),
        ),
    ),
    "notched half": partial(
        make_scene,
        (7, 4, 2),
        2,
        correction="virial",
        mesh=BoxMesh(
            lower=(0.0, 0.0, 0.0),
            upper=(7.0, 4.0, 2.0),
            spacing=1.0,
            symmetry=("z-",),
            remove=(RemovedBox(kind="box", lower=(4.0, 0.0, 0.0), upper=(5.0, 2.0, 2.0)),),
        ),
    ),
}


#: Scenes and solvers that are taken to equilibrium; the others only with --all.
TO_EQUILIBRIUM = (
    ("coupled, linear, appendix_a", "adr"),
    ("coupled, linear, appendix_a", "cg"),
    ("coupled, finite, none", "cg"),
    ("peridynamics, finite, appendix_a", "cg"),
    ("four materials", "cg"),
    ("elements", "adr"),
    ("elements", "cg"),
    ("supports", "cg"),
    ("coupled eighth, finite", "cg"),
    ("slab of one cell between two mirrors", "cg"),
    ("notched half", "cg"),
    ("rollers, a pin, a pressure and formulas", "cg"),
)


def few_iterations(body):
    """Relax a body for some evaluations and return all that must not depend on ranks. Collective."""
    seen = []
    case = body.case
    with suppress(NotConverged):
        adr.solve(body.forces, body.state, case.external, case.fixed, 1e-12, FEW, seen.append)
    body.internal(body.state.u)
    return outcome(body, seen)


def equilibrium(body):
    """Take a body through its load program and return all that must not depend on ranks. Collective."""
    seen = []
    solver = make_solver(body.scene, body.share, body.forces, body.case, seen.append)
    watch = lambda step, progress: seen.append(progress)  # noqa: E731
    for found in follow_load_program(body.scene, solver, None, body.state, body.case, watch):
        seen += [found.convergence, found.resultant.tolist(), (found.force_balance, found.moment_balance)]
    return outcome(body, seen)


def outcome(body, seen):
    """Digest of the fields, counts, and what was seen, equal on all ranks of the body. Collective."""
    comm = body.model.comm
    fields = gather_fields(body.share, body.forces, body.state.u)
    counts = body.forces.evaluations, total_bonds(comm, body.model.bonds)
    return broadcast(comm, fields and fields_sha256(fields)), counts, seen


@cache
def on_one_rank(how, name, solver="adr"):
    """The same by this rank alone."""
    return how(build(SCENES[name](solver=solver), mpi().COMM_SELF))


def assert_same(comm, found, expected):
    """Agree on what differs. Collective."""
    for a, b, what in zip(found, expected, ("displacements", "evaluations or bonds", "progress"), strict=True):
        assert_all(comm, a == b, f"{what} differ from those of one rank")


@pytest.mark.parametrize("name", SCENES)
def test_iterations_do_not_depend_on_the_number_of_ranks(comm, name):
    """Displacements, residuals, dampings and bonds of 1, 2, 3, 4 ranks: equal bits."""
    expected = on_one_rank(few_iterations, name)
    found = few_iterations(build(SCENES[name](), comm))
    assert_same(comm, found, expected)


@pytest.mark.parametrize(
    ("name", "solver"),
    [
        pytest.param(name, solver, marks=() if (name, solver) in TO_EQUILIBRIUM else pytest.mark.slow)
        for name in SCENES
        for solver in ("adr", "cg")
    ],
)
def test_equilibrium_does_not_depend_on_the_number_of_ranks(comm, name, solver):
    """Displacements, reactions, balances and the solver's path to them: equal bits, with either solver."""
    expected = on_one_rank(equilibrium, name, solver)
    found = equilibrium(build(SCENES[name](solver=solver), comm))
    assert_same(comm, found, expected)


def random_owners(discretization, n_parts, neighbours, seed):
    """Cells dealt out one by one, none left out: every cell has neighbours elsewhere."""
    rng = np.random.default_rng(seed)
    n_cells = len(discretization.mesh.cells)
    owner = rng.integers(0, n_parts, n_cells)
    owner[rng.permutation(n_cells)[:n_parts]] = np.arange(n_parts)
    return owner.astype(np.int32)


def by_model(discretization, n_parts, neighbours):
    """The last rank has all peridynamic cells and nothing else, the others share the elements."""
    owner = np.arange(len(discretization.mesh.cells)) % max(1, n_parts - 1)
    owner[discretization.has_points & ~discretization.is_overlap] = n_parts - 1
    return owner.astype(np.int32)


def points_without_overlap(discretization, n_parts, neighbours):
    """Rank 0 has all cells with points, overlap included; the others have elements only."""
    owner = np.arange(len(discretization.mesh.cells)) % max(1, n_parts - 1) + (n_parts > 1)
    owner[discretization.has_points] = 0
    return owner.astype(np.int32)


def single_cell(discretization, n_parts, neighbours, kind):
    """The last rank owns one cell: of elements, of overlap, or peridynamic."""
    free = discretization.has_points & ~discretization.is_overlap
    chosen = {"element": ~discretization.has_points, "overlap": discretization.is_overlap, "free": free}[kind]
    owner = np.arange(len(chosen)) % max(1, n_parts - 1)
    owner[np.flatnonzero(chosen)[len(np.flatnonzero(chosen)) // 2]] = n_parts - 1
    return owner.astype(np.int32)


def reversed_ranks(discretization, n_parts, neighbours, partition):
    """The parts of a run, given to the ranks in reverse."""
    return n_parts - 1 - partition(discretization, n_parts, neighbours)


OWNERS = {
    "random": partial(random_owners, seed=1),
    "random again": partial(random_owners, seed=2),
    "reversed": partial(reversed_ranks, partition=partition),
    "elements here, points there": by_model,
    "elements only elsewhere": points_without_overlap,
    "a single element": partial(single_cell, kind="element"),
    "a single cell of overlap": partial(single_cell, kind="overlap"),
    "a single peridynamic cell": partial(single_cell, kind="free"),
}


@pytest.mark.parametrize(
    "name",
    [
        "coupled, finite, appendix_a",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("supports", "coupled, reading A", "coupled eighth, finite")
        ),
    ],
)
@pytest.mark.parametrize("owners", OWNERS)
def test_iterations_do_not_depend_on_who_owns_what(comm, monkeypatch, owners, name):
    """Any map of cells to ranks gives the same bits, also where a rank has one description only or one cell."""
    expected = on_one_rank(few_iterations, name)
    deal_out_by(monkeypatch, OWNERS[owners])
    found = few_iterations(build(SCENES[name](), comm))
    assert_same(comm, found, expected)


def test_mirror_images_do_not_depend_on_who_owns_what(comm, monkeypatch):
    """Images of own cells and of ghosts, through one, two and three planes, with cells dealt out one by one."""
    expected = on_one_rank(few_iterations, "coupled eighth, finite")
    deal_out_by(monkeypatch, OWNERS["random"])
    found = few_iterations(build(SCENES["coupled eighth, finite"](), comm))
    assert_same(comm, found, expected)


@pytest.mark.parametrize("owners", ["random", "elements here, points there"])
def test_conjugate_gradients_do_not_depend_on_who_owns_what(comm, monkeypatch, owners):
    """The coarse space is the same whatever the map of cells to ranks."""
    expected = on_one_rank(equilibrium, "coupled, linear, appendix_a", "cg")
    deal_out_by(monkeypatch, OWNERS[owners])
    found = equilibrium(build(SCENES["coupled, linear, appendix_a"](solver="cg"), comm))
    assert_same(comm, found, expected)


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
    expected = few_iterations(build(scene, mpi().COMM_SELF))
    found = few_iterations(build(scene, comm))
    assert_same(comm, found, expected)


def test_each_bond_is_on_one_rank(comm):
    """The ranks' numbers of bonds add up, and every rank with points has some."""
    scene = make_scene((12, 3, 3))
    alone = build(scene, mpi().COMM_SELF).model.bonds.count
    model = build(scene, comm).model
    total = total_bonds(comm, model.bonds)
    assert_all(comm, model.bonds.count > 0, "a rank without bonds")
    assert_all(comm, total == alone, "bonds are lost or counted twice")


def test_bonds_between_materials_do_not_depend_on_the_number_of_ranks(comm):
    """Those across an interface may stand on either side of it, in either order of its materials."""
    alone, model = (build(SCENES["four materials"](), c).model for c in (mpi().COMM_SELF, comm))
    expected, found = count_by_material(alone.comm, alone.bonds), count_by_material(comm, model.bonds)
    assert_all(comm, (found == expected).all() and found[1, 2] > 0, "bonds are lost or counted twice")


@pytest.mark.parametrize("cells", [(9, 3, 2), (12, 1, 1)], ids=["bar", "rod, with raised masses"])
def test_masses_do_not_depend_on_the_number_of_ranks(comm, cells):
    """Eqs 11 and 22, and the lumped densities of the overlap, node by node and point by point."""
    scene = make_scene(cells, 4, coupling="paper_a")
    alone, ours = build(scene, mpi().COMM_SELF).model, build(scene, comm).model
    assert_all(comm, ours.raised_masses == alone.raised_masses, "another number of raised masses")
    assert_all(comm, (ours.raised_masses > 0) == (cells[1] == 1), "raised masses")

    def by_number(model):
        n = 3 * model.unknowns.n_points
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
