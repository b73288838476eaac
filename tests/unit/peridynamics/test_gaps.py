"""No bond reaches across what was taken out of a box of cells."""

import numpy as np
import pytest

from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.removals import RemovedBox, RemovedCylinder
from pdfem_mpi.mesh.carving import is_removed
from pdfem_mpi.peridynamics.bonds import total_bonds
from support.bodies import bond_list, build, make_scene

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


def test_decks_without_the_table_have_no_window():
    """No array, no kernel, no bit of difference."""
    assert build(scene(correction="none")).model.points.gaps is None
