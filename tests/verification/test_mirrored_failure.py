"""Failure in a part of a symmetric body: the same events as in the whole body, and its bonds in the books.

Oracle: the whole body. A plate with a crack on one mirror plane and across the other is pulled apart.
"""

import numpy as np
import pytest

from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.measure.fields import gather_damage
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.peridynamics.point_blocks import point_blocks
from support.bodies import build
from support.notched import ROWS, notched, pull

EQUILIBRIA = 1e-6  # relative: energies and loads of states relaxed to a residual of ARREST


def broken_bonds(body, failure):
    """Both ends of each broken bond, deck units, folded into the part between the mirror planes; sorted, rounded."""
    x = body.geometry.point_positions
    sign, shift = body.share.reflections
    units = body.share.units
    sign, shift = np.concatenate([np.ones((1, 3)), sign]), np.concatenate([np.zeros((1, 3)), shift * units.length])
    ends = []
    for ids in failure.broken_pairs().T:
        point, reflection = body.geometry.rows_of_points(ids)
        ends.append(sign[reflection] * (x[point] - units.origin) + shift[reflection] + units.origin)
    folded = set()
    for a, b in zip(*ends, strict=True):
        images = [(s * a, s * b) for s in np.array(np.meshgrid([1, -1], [1, -1], [1, -1])).reshape(3, 8).T]
        pairs = [sorted(tuple(np.round(end, 6) + 0.0) for end in pair) for pair in images]
        folded.add(tuple(max(pairs)))
    return folded


@pytest.fixture(scope="module")
def whole():
    return pull(notched(()))


@pytest.mark.parametrize("faces", [("x-", "y-"), ("x-", "y-", "z-")], ids="".join)
def test_events_are_those_of_the_whole_body(whole, faces):
    """Loads, energies and broken bonds of every batch, arrest and next break."""
    n = 2 ** len(faces)
    body, failure, rows = pull(notched(faces))
    of_whole, expected = whole[1], whole[2]
    assert [row.event for row in rows] == [row.event for row in expected] and len(rows) == ROWS
    assert rows[-1].broken > 5 and rows[-1].dissipated > 0.0
    for row, other in zip(rows, expected, strict=True):
        assert row.load_factor == pytest.approx(other.load_factor, rel=EQUILIBRIA)
        assert n * row.stored == pytest.approx(other.stored, rel=EQUILIBRIA)
        assert n * row.dissipated == pytest.approx(other.dissipated, rel=EQUILIBRIA)
        assert n * row.released == pytest.approx(other.released, rel=1e3 * EQUILIBRIA)
        assert abs(row.ledger_error) < 1e-12
        assert n / 2 * row.reaction == pytest.approx(other.reaction, rel=10 * EQUILIBRIA)
    assert broken_bonds(body, failure) == broken_bonds(whole[0], of_whole)
    assert of_whole.count / n <= failure.count <= of_whole.count


def test_images_fail_like_their_cells():
    """Critical stretches go by regions; those of images are those of their cells."""
    cells = (
        Region(name="left", model="peridynamics", upper=(1.0, 9.0, 9.0)),
        Region(name="right", model="peridynamics", lower=(1.0, -9.0, -9.0), may_fail=False),
    )
    body = build(notched(("x-", "y-", "z-")).model_copy(update={"regions": cells}), loaded=False)
    images = body.model.points.images
    classes = make_failure(body.scene, body.share, body.model).class_of.reshape(-1, 2)
    of_images = classes[len(classes) - len(images.source) :]
    assert (of_images == classes[images.source]).all() and len(np.unique(of_images)) == 2


def test_blocks_of_points_lose_the_bonds_that_broke():
    """3x3 blocks of the preconditioner, renewed for broken bonds to images, against a new sum over what is left."""
    body = build(notched(("x-", "y-", "z-")))
    failure, u = make_failure(body.scene, body.share, body.model), body.state.u
    blocks = point_blocks(body.model.points, body.model.bonds)
    before = blocks.sums.copy()
    u[:] = body.of_positions(lambda x: 0.05 * np.sin(x + x[:, [1, 2, 0]]))
    body.forces.evaluate_surely(u, np.zeros_like(u), np.empty_like(u), failure)
    assert failure.close(body.model.comm) > 1000
    blocks.take_out(body.model.points, body.model.bonds, failure.take())
    assert (blocks.sums == point_blocks(body.model.points, body.model.bonds).sums).all()
    assert (blocks.sums != before).any()


@pytest.mark.parametrize("faces", [("x-", "y-", "z-"), ("y-",)], ids="".join)
def test_local_damage_is_that_of_the_whole_body(faces):
    """Eq. (5) beside the crack: bonds to images count, that of a point to its own image once."""
    damage = {}
    for chosen in ((), faces):
        body = build(notched(chosen).model_copy(update={"output": Output(damage=True)}), loaded=False)
        by_id = gather_damage(body.share, body.model)
        places = np.round(body.geometry.point_positions, 6) + 0.0
        damage[chosen] = dict(zip(map(tuple, places.tolist()), by_id.tolist(), strict=True))
    assert all(value == pytest.approx(damage[()][place], abs=1e-9) for place, value in damage[faces].items())
    assert max(damage[faces].values()) > 0.3


def test_broken_bonds_to_images_are_restored_from_the_books():
    """Bonds of a point to another, to its image and to those of others have ids of their own."""
    scene = notched(("x-", "y-", "z-"))
    body, failure, _ = pull(scene)
    pairs = failure.broken_pairs()
    assert len(np.unique(pairs, axis=0)) == failure.count
    assert (pairs // (8 * body.share.counts.cells)).any(), "no bond to an image broke"
    again = build(scene)
    books = make_failure(scene, again.share, again.model)
    books.restore(again.model.comm, again.model.points, again.model.bonds, pairs, failure.dissipated_digits)
    assert (books.count, books.dissipated) == (failure.count, failure.dissipated)
    again.forces.bounds.bond = body.forces.bounds.bond
    assert again.internal(body.state.u).tolist() == body.internal(body.state.u).tolist()
