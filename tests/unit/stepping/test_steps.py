"""Given load factors with failure: at each, bonds break and the rest relaxes until none is left to break."""

import numpy as np
import pytest

from pdfem_mpi import Simulation
from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.programs import Steps
from support.bodies import make_scene, tension
from support.failing import followed, strip

OVERSHOOT = 1.02


def steps(*factors):
    return Steps(load_factors=factors)


@pytest.mark.parametrize("solver", ["cg", "adr"])
def test_steps_end_in_equilibrium_with_nothing_left_to_break(solver):
    """After a load above the first break: bonds are gone, the residual is small, no bond is beyond critical."""
    first = followed(strip(), 1).rows[0].load_factor
    run = followed(strip(solver=solver, tolerance=1e-6, stepping=steps(0.5 * first, OVERSHOOT * first)))
    below, above = run.rows
    assert (below.broken, below.dissipated) == (0, 0.0)
    assert above.broken > 0
    assert above.convergence.residual <= 1e-6
    assert run.ratio() <= 1.0
    assert above.reaction < OVERSHOOT / 0.5 * below.reaction
    assert (below.work, below.released, below.ledger_error) == (None, None, None)


def test_broken_bonds_stay_broken():
    """A second step below the first load: no bond heals, the body is softer than it was."""
    first = followed(strip(), 1).rows[0].load_factor
    intact, damaged = (followed(strip(stepping=steps(*f))) for f in ((0.9 * first,), (OVERSHOOT * first,)))
    state = damaged.body.state
    state.step = 0
    damaged.body.scene = damaged.body.scene.model_copy(update={"stepping": steps(0.9 * first)})
    broken = damaged.failure.count
    (again,) = damaged.follow()
    assert again.broken == broken > 0
    assert again.new_broken == 0
    assert again.reaction < intact.rows[-1].reaction
    assert np.isfinite(again.stored)


def test_displacement_of_a_formula_is_what_it_prescribes():
    """A square of the load factor, and one that is nothing at load factor 1."""
    for formula, expected in (("1e-3 * f^2", [2.5e-4, 1e-3]), ("4e-3 * f * (1 - f)", [1e-3, 0.0])):
        supports = (Support(face="x-", x=0.0, y=0.0, z=0.0), Support(face="x+", x=formula))
        scene = make_scene((4, 2, 2), supports=supports, loads=(), solver="cg", stepping=steps(0.5, 1.0))
        rows = list(Simulation(scene).steps())
        assert [row["displacement"] for row in rows] == pytest.approx(expected, rel=1e-12)
        held = [abs(row["reaction_x"]) for row in rows]
        assert rows[0]["reaction"] > 0.0 and max(held) <= 1e-3 * rows[0]["reaction"]


def test_constant_loads_alone_are_there_at_every_load_factor():
    loads = tuple(load.model_copy(update={"constant": True}) for load in tension((4, 2, 2), 0))
    rows = list(Simulation(make_scene((4, 2, 2), loads=loads, solver="cg", stepping=steps(0.5, 1.0))).steps())
    grown = list(Simulation(make_scene((4, 2, 2), solver="cg", stepping=steps(0.5, 1.0))).steps())
    for name in ("reaction", "displacement"):
        assert [row[name] for row in rows] == pytest.approx([grown[1][name]] * 2, rel=1e-5)
