"""Given load factors with failure: at each, bonds break and the rest relaxes until none is left to break."""

import numpy as np
import pytest

from pdfem_mpi.deck.programs import Steps
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
