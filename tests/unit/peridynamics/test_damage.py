"""Local damage as an output: asked for in the deck, a point field of points.vtkhdf."""

import h5py
import numpy as np
import pytest

from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.table import DeckError
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.measure.fields import gather_damage
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.peridynamics.damage import Remaining
from pdfem_mpi.runs.run import run
from support.bodies import build, make_scene
from support.reporters import Silence

SINGLE = 2.0**-24  # fields are stored in single precision
DECK = """
[mesh]
lower = [0, 0, 0]
upper = [4, 2, 2]
spacing = 1
[material]
youngs_modulus = 1
[[regions]]
name = "body"
model = "{model}"
[[loads]]
kind = "{load}"
face = "x+"
total = [1, 0, 0]
[output]
{output}
"""


def test_points_file_has_the_damage_beside_displacements(tmp_path):
    corners = ((3.0, -1.0, -1.0), (3.0, 1.0, -1.0), (3.0, 1.0, 4.0), (3.0, -1.0, 4.0))
    scene = make_scene((6, 3, 3), 0, solver="cg", cracks=(Crack(polygon=corners),), output=Output(damage=True))
    assert run(scene, mpi().COMM_SELF, tmp_path, "", True, Silence()) == 0
    body = build(scene)
    expected = gather_damage(body.share, body.model)
    with h5py.File(tmp_path / "points.vtkhdf") as file:
        fields = file["VTKHDF/PointData"]
        assert len(fields["displacement"]) == len(expected)
        np.testing.assert_allclose(fields["damage"][:], expected, rtol=0, atol=SINGLE)
    assert expected.max() > 0.3


@pytest.mark.parametrize(
    "scene",
    [
        make_scene((5, 2, 2), 2, cracks=(Crack(polygon=((3.0, -1.0, -1.0), (3.0, 1.0, -1.0), (3.0, 1.0, 3.0))),)),
        make_scene((2, 2, 1), kinematics="finite", symmetry=("x-", "y-", "z-")),
    ],
    ids=["coupled, linear", "eighth, finite"],
)
def test_weights_from_row_to_row_are_those_of_all_bonds_left(scene):
    """Bonds that break are taken off, those between a point and its own mirror images too: the same bits."""
    breaking = Material(youngs_modulus=scene.material.youngs_modulus, critical_stretch=0.01)
    body = build(scene.model_copy(update={"material": breaking, "output": Output(damage=True)}), loaded=False)
    failure = make_failure(body.scene, body.share, body.model)
    remaining, means = Remaining(), []
    for size in (0.0, 0.01, 0.03, 0.03):
        u = body.of_positions(lambda x, size=size: size * np.sin(x + 2.0 * x[:, [1, 2, 0]]))
        body.forces.evaluate_surely(u, np.zeros_like(u), np.empty_like(u), failure)
        failure.close(body.model.comm)
        expected = gather_damage(body.share, body.model)
        found = gather_damage(body.share, body.model, remaining, failure)
        assert (found == expected).all()
        means.append(found.mean())
    assert means[0] < means[1] < means[2] == means[3] < 1.0 and failure.count > 100


def test_nothing_is_computed_that_was_not_asked_for():
    body = build(make_scene((3, 2, 2)))
    assert body.model.intact_weights is None
    assert gather_damage(body.share, body.model) is None


@pytest.mark.parametrize(
    ("model", "load", "output", "sentence"),
    [
        (
            "peridynamics", "body_force", "damage = true\nfields = false",
            "output.damage = true is a field, and fields = false writes none. Change one of the two.",
        ),
        (
            "finite_elements", "traction", "damage = true",
            "output.damage = true counts broken bonds, and no region has any. Remove it.",
        ),
    ],
    ids=["no fields", "no bonds"],
)  # fmt: skip
def test_damage_that_cannot_be_had_is_refused(model, load, output, sentence):
    with pytest.raises(DeckError) as caught:
        parse_deck(DECK.format(model=model, load=load, output=output), "deck.toml")
    assert caught.value.messages == [f"deck.toml: {sentence}"]
