"""Rotation, torsion and affine displacements of a support are the formulas of these motions."""

import math

import numpy as np
import pytest

from pdfem_mpi.deck.displacements import Affine, Rotation, Torsion
from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.table import DeckError
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.model.formula_values import evaluate
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.simulation import Simulation
from support.bodies import make_scene
from support.tiny import TINY

PLACES = np.random.default_rng(4).uniform(-2.0, 2.0, (20, 3))
POINT = (0.5, -1.25, 3.0)
EXACT = 1e-14


def values(amounts, f):
    """Displacements of PLACES, as a support takes them: times f where a formula does not name it."""
    x = dict(zip("xyz", PLACES.T, strict=True)) | {"f": f}
    columns = [
        np.broadcast_to(evaluate(a, x) if isinstance(a, str) else a, len(PLACES)) * (1.0 if "f" in str(a) else f)
        for a in amounts
    ]
    return np.stack(columns, axis=1)


def turned(axis, angle):
    """Rodrigues' rotation matrix."""
    k = np.array(axis) / np.linalg.norm(axis)
    across = np.array([[0.0, -k[2], k[1]], [k[2], 0.0, -k[0]], [-k[1], k[0], 0.0]])
    return np.eye(3) + math.sin(angle) * across + (1.0 - math.cos(angle)) * across @ across


@pytest.mark.parametrize("axis", [(0.0, 0.0, 2.0), (1.0, -2.0, 0.5), (-3.0, 0.0, 0.0)])
def test_a_rotation(axis):
    y = PLACES - POINT
    small = Rotation(axis=axis, point=POINT, angle=0.02).amounts
    expected = 0.02 * np.cross(np.array(axis) / np.linalg.norm(axis), y)
    np.testing.assert_allclose(values(small, 0.5), 0.5 * expected, rtol=0, atol=EXACT)
    true = Rotation(axis=axis, point=POINT, angle=1.7, finite=True).amounts
    np.testing.assert_allclose(values(true, 0.5), y @ turned(axis, 0.85).T - y, rtol=0, atol=EXACT * 4)


def test_torsion_leaves_an_end_free_to_warp():
    support = Support(face="y+", torsion=Torsion(axis="y", point=POINT, angle=0.03))
    x, y, z = support.amounts
    assert y is None
    expected = 0.03 * np.cross((0.0, 1.0, 0.0), PLACES - POINT)
    np.testing.assert_allclose(values((x, 0.0, z), 2.0), 2.0 * expected, rtol=0, atol=EXACT)
    held = Support(face="y+", y=0.0, torsion=Torsion(axis="y", angle=0.03))
    assert held.amounts[1] == 0.0


def test_an_affine_displacement():
    gradient = ((1e-3, 0.5, 0.0), (0.0, 0.0, 0.0), (0.0, -2e-3, 1e-7))
    amounts = Affine(gradient=gradient, point=POINT).amounts
    assert amounts[1] == 0.0
    np.testing.assert_allclose(values(amounts, 1.0), (PLACES - POINT) @ np.array(gradient).T, rtol=0, atol=EXACT)


def test_decks_have_them_as_tables():
    text = TINY.replace("x = 0.0\ny = 0.0\nz = 0.0", "rotation = { axis = [1.0, 0.0, 0.0], angle = 0.01 }")
    assert parse_deck(text, "deck.toml").supports[0].amounts == (0.0, "-0.01*z", "0.01*y")
    text = TINY.replace("x = 0.0\ny = 0.0\nz = 0.0", "affine.gradient = [[0.01, 0, 0], [0, 0, 0], [0, 0, 0]]")
    assert parse_deck(text, "deck.toml").supports[0].amounts == ("0.01*x", 0.0, 0.0)


@pytest.mark.parametrize(
    ("keys", "says"),
    [
        (
            "x = 0.0\ntorsion = { axis = 'y', angle = 0.1 }",
            "supports.0 prescribes the same components by x and torsion",
        ),
        ("rotation = { axis = [0.0, 0.0, 0.0], angle = 0.1 }", "supports.0.rotation.axis = [0.0, 0.0, 0.0] has no dir"),
        ("rotation = { axis = [1.0, 0.0, 0.0] }", "supports.0.rotation.angle is missing. Give the angle in radians"),
        ("rotation = { axis = [1.0, 0.0, 0.0], angel = 0.1 }", "Did you mean angle?"),
        ("torsion = { axis = 'w', angle = 0.1 }", "supports.0.torsion.axis"),
        ("affine = { gradient = [[1.0, 0.0, 0.0]] }", "supports.0.affine.gradient"),
    ],
)
def test_what_is_no_motion_is_named(keys, says):
    with pytest.raises(DeckError) as caught:
        parse_deck(TINY.replace("x = 0.0\ny = 0.0\nz = 0.0", keys), "deck.toml")
    assert any(says in message for message in caught.value.messages), caught.value.messages


def test_a_true_rotation_needs_steps():
    turn = "rotation = { axis = [1.0, 0.0, 0.0], angle = 1.0, finite = true }"
    text = TINY.replace("x = 0.0\ny = 0.0\nz = 0.0", turn).replace(
        'kind = "cg"', 'kind = "cg"\n[stepping]\nkind = "events"'
    )
    text = text.replace("youngs_modulus = 1000.0", "youngs_modulus = 1000.0\ncritical_stretch = 0.01")
    with pytest.raises(DeckError, match=r"supports\.0 follows the load factor f by a formula"):
        parse_deck(text, "deck.toml")


def test_a_formula_that_names_what_is_unknown_is_told_where_bonds_break():
    text = TINY.replace("x = 0.0\ny = 0.0\nz = 0.0", 'x = "load_factor^2"').replace(
        'kind = "cg"', 'kind = "cg"\n[stepping]\nkind = "events"'
    )
    text = text.replace("youngs_modulus = 1000.0", "youngs_modulus = 1000.0\ncritical_stretch = 0.01")
    with pytest.raises(DeckError, match="names load_factor, which is unknown"):
        parse_deck(text, "deck.toml")


def test_each_component_follows_the_load_factor_by_itself():
    """Beside a formula of ``f``, one without it is multiplied by the load factor, as it is alone."""
    pulled = Support(face="x+", x="0.01*f**2", y="0.01*x", z=0.02)
    held = Support(face="x-", x=0.0, y=0.0, z=0.0)
    scene = make_scene((3, 1, 1), 3, loads=(), supports=(held, pulled), solver="cg")
    simulation = Simulation(scene, mpi().COMM_SELF)
    for factor in (0.25, 1.0):
        simulation.solve(factor)
        end = np.abs(simulation.nodes[:, 0] - 3.0) < 1e-9
        u = simulation.fields().u_nodes[end]
        np.testing.assert_allclose(
            u, np.tile([0.01 * factor**2, 0.03 * factor, 0.02 * factor], (len(u), 1)), rtol=1e-12
        )
