"""No bond leaves the body: across what was taken out of a box of cells, or a void, slot or dent of a mesh file."""

import numpy as np
import pytest

from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.meshes import BoxMesh, FileMesh
from pdfem_mpi.deck.removals import RemovedBox, RemovedCylinder, RemovedPrism
from pdfem_mpi.mesh import generators
from pdfem_mpi.mesh.carving import carve, is_removed
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.peridynamics.bonds import total_bonds
from support.bodies import bond_list, build, make_scene
from support.mesh_files import write_mesh

CELLS = (7, 6, 2)
#: A bond that is inside of a removed cell for less than this part of its length touches it.
TOUCH = 1e-5
NOTCH = RemovedBox(kind="box", lower=(3.0, 0.0, 0.0), upper=(4.0, 3.0, 9.0))
HOLE = RemovedCylinder(kind="cylinder", axis="z", centre=(3.5, 3.0, 0.0), radius=1.2)
CORNER = RemovedBox(kind="box", lower=(4.0, 3.0, 0.0), upper=(9.0, 9.0, 9.0))


def scene(*removals, symmetry=(), cells=CELLS, **options):
    mesh = BoxMesh(lower=(0.0,) * 3, upper=tuple(map(float, cells)), spacing=1.0, remove=removals, symmetry=symmetry)
    return make_scene(cells, mesh=mesh, loads=(), **options)


def bonds_of(body):
    """Ends of all bonds in the deck's units, shape (n, 2, 3)."""
    x, i, j, _ = bond_list(body)
    x = x * body.model.units.length + body.model.units.origin
    return np.stack([x[i], x[j]], axis=1)


def leaves_the_body(ends, removals):
    """Whether the middle of some piece of a bond between planes of the grid is in a removed cell; bool, (n,)."""
    start, way = ends[:, 0], ends[:, 1] - ends[:, 0]
    planes = np.arange(-3, max(CELLS) + 4)
    with np.errstate(divide="ignore", invalid="ignore"):
        t = (planes[None, None] - start[:, :, None]) / way[:, :, None]
    t = np.where((t > 0.0) & (t < 1.0), t, 0.0).reshape(len(ends), -1)
    t = np.sort(np.column_stack([t, np.ones(len(ends))]), axis=1)
    gone = np.zeros(len(ends), bool)
    for before, after in zip(t[:, :-1].T, t[:, 1:].T, strict=True):
        long = np.flatnonzero(after - before > TOUCH)
        if len(long):
            middle = start[long] + (0.5 * (before + after))[long, None] * way[long]
            gone[long] |= is_removed(removals, np.floor(middle) + 0.5, 1e-6)
    return gone


@pytest.mark.parametrize("removal", [NOTCH, HOLE, CORNER], ids=["notch", "hole", "corner"])
def test_bonds_stay_inside_the_body(removal):
    """Of the bonds within the cutoff radius those are left that lie inside, cell by cell, and no others."""
    body = build(scene(removal, correction="none"))
    ends = bonds_of(body)
    assert not leaves_the_body(ends, (removal,)).any()
    x = np.unique(ends.reshape(-1, 3), axis=0)
    i, j = np.triu_indices(len(x), 1)
    near = np.linalg.norm(x[i] - x[j], axis=1) <= 2.5 * (1 + 1e-6)
    inside = ~leaves_the_body(np.stack([x[i][near], x[j][near]], axis=1), (removal,))
    assert inside.sum() == len(ends) == total_bonds(body.model.comm, body.model.bonds)
    assert inside.sum() < near.sum()


def test_a_mirrored_notch_is_half_of_the_whole():
    """Bonds of the half, those across the plane by half, are half of those of the whole body."""
    half_notch = RemovedBox(kind="box", lower=(0.0, 0.0, 0.0), upper=(1.0, 3.0, 9.0))
    mirrored = build(scene(half_notch, cells=(4, 6, 2), symmetry=("x-",), correction="none"))
    wide = RemovedBox(kind="box", lower=(3.0, 0.0, 0.0), upper=(5.0, 3.0, 9.0))
    whole = build(scene(wide, cells=(8, 6, 2), correction="none"))
    ends = bonds_of(mirrored)
    assert not leaves_the_body(np.abs(ends), (half_notch,)).any()  # an image's place is folded back
    sums = [bond_list(body)[3].sum() for body in (whole, mirrored)]  # stored numbers, in single precision
    assert sums[0] == pytest.approx(2 * sums[1], rel=1e-6)


@pytest.mark.parametrize("correction", ["appendix_a", "virial", "fitted"])
def test_the_correction_knows_the_notch(correction):
    """Uniform strain is an equilibrium of fitted factors; the others count the missing bonds as at a surface."""
    body = build(scene(NOTCH, correction=correction))
    assert not leaves_the_body(bonds_of(body), (NOTCH,)).any()
    if correction == "fitted":
        assert body.model.body_fit.fit.residual < 1e-8  # the moments of every point; 1.9e-9 is found
    else:
        assert body.model.correction_remaining < 0.1  # of legs that are three cells wide and two thick


def test_a_box_has_no_surface():
    """No array, no kernel, no bit of difference."""
    body = build(scene(correction="none"))
    assert body.model.points.gaps is None
    assert not len(body.share.surface)


STAIRS = RemovedPrism(kind="prism", axis="z", polygon=((2.0, 1.6), (8.0, 5.6), (8.0, 4.1), (2.0, 0.6)))


def file_scene(path, mesh, symmetry=(), **options):
    write_mesh(path, mesh)
    entry = FileMesh(path=str(path), symmetry=symmetry, spacing=1.0)
    held = (Support(region="bonds", x=0.0, y=0.0, z=0.0),)
    return make_scene(CELLS, mesh=entry, loads=(), supports=held, **options)


@pytest.mark.parametrize("removal", [NOTCH, HOLE, CORNER, STAIRS], ids=["notch", "hole", "corner", "stairs"])
@pytest.mark.parametrize("symmetry", [(), ("z-",)], ids=["whole", "mirrored"])
def test_a_mesh_file_has_the_bonds_of_the_box(tmp_path, removal, symmetry):
    """The same bonds with the same numbers, whether cells were taken out by the deck or by a mesh tool."""
    mesh = carve(generators.box((0.0,) * 3, tuple(map(float, CELLS)), CELLS), (removal,), ())
    one = bond_list(build(scene(removal, symmetry=symmetry, correction="virial")))
    two = bond_list(build(file_scene(tmp_path / "part.vtu", mesh, symmetry, correction="virial")))
    for a, b in zip(one, two, strict=True):
        np.testing.assert_array_equal(a, b)


def dented(amount, seed=0):
    """A notch through cells whose corners are shifted at random, and faces are bent."""
    mesh = carve(generators.box((0.0,) * 3, (5.0, 4.0, 2.0), (5, 4, 2)), (SLOT,), ())
    shift = np.random.default_rng(seed).uniform(-amount, amount, mesh.nodes.shape)
    return HexMesh(mesh.nodes + shift, mesh.cells)


SLOT = RemovedBox(kind="box", lower=(2.0, 1.0, 0.0), upper=(3.0, 4.0, 9.0))


def longest_outside(ends, mesh, n=24):
    """How far the places along each bond are from all cells at most, in local coordinates of the nearest cell.

    Local coordinates of a place in a cell are found by Newton's method; inside, all three are within 1.
    """
    signs = np.array([(a, b, c) for c in (-1, 1) for a, b in ((-1, -1), (1, -1), (1, 1), (-1, 1))], float)
    corners = mesh.nodes[mesh.cells]
    t = (np.arange(n) + 0.5) / n
    places = (ends[:, :1] + t[:, None] * (ends[:, 1:] - ends[:, :1])).reshape(-1, 3)
    nearest = np.full(len(places), np.inf)
    for cell in corners:
        near = np.flatnonzero((np.abs(places - cell.mean(axis=0)) < 1.2).all(axis=1))
        local = np.zeros((len(near), 3))
        for _ in range(8):
            factors = 1.0 + signs * local[:, None]  # (n, 8, 3)
            shape = factors.prod(axis=2) / 8.0
            slopes = np.stack([signs[:, d] * np.delete(factors, d, 2).prod(axis=2) / 8.0 for d in range(3)], axis=2)
            miss = places[near] - shape @ cell
            local += np.clip(np.linalg.solve(np.einsum("nac,ad->ndc", slopes, cell), miss[..., None])[..., 0], -1, 1)
        nearest[near] = np.minimum(nearest[near], np.abs(local).max(axis=1) - 1.0)
    return nearest.reshape(len(ends), n).max(axis=1)


#: The surface is made of triangles, and faces of cells are bent: what is nearer than this to either is not judged.
BENT = 0.03
#: Of so many pairs of points one is looked at.
EVERY = 25


@pytest.mark.parametrize("seed", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_bonds_of_bent_cells_stay_inside(tmp_path, seed):
    """Of all pairs within the cutoff radius those are bonds whose places all lie in some cell."""
    mesh = dented(0.15, seed)
    body = build(file_scene(tmp_path / "bent.vtu", mesh, correction="none"))
    x, i, j, _ = bond_list(body)
    bonds = set(map(tuple, np.sort(np.stack([i, j], axis=1), axis=1).tolist()))
    edge = body.model.units.length
    i, j = np.triu_indices(len(x), 1)
    near = np.flatnonzero(np.linalg.norm(x[i] - x[j], axis=1) <= 2.5)[::EVERY]
    pairs = np.stack([i[near], j[near]], axis=1)
    outside = longest_outside(x[pairs] * edge + body.model.units.origin, mesh)
    kept = np.array([pair in bonds for pair in map(tuple, pairs.tolist())])
    assert not kept[outside > BENT].any()
    assert np.count_nonzero(outside > BENT) > 50
    inside = outside < 1e-9
    assert np.count_nonzero(inside & ~kept) < 0.1 * np.count_nonzero(~kept)  # those outside between two places
