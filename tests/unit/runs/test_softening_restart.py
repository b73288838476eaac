"""A run whose bonds soften goes on from any checkpoint as if it had not stopped."""

import pytest

from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.programs import Events
from support.restarts import StopAt, alone, differing, failing, outcome
from support.softening import remade, softening_material

FINISHED, STOPPED = 0, 75
STOPS = (3, 7, 16)


def scene(kinematics):
    base = failing("events", kinematics)
    events = Events(kind="events", eta=1e-2, inner_iterations=4, report_every=5, end_load_factor=0.42)
    material = softening_material(ratio=6.0, stretch=0.02)
    return remade(base, material=material, stepping=events, output=Output(figures=False, damage=True))


@pytest.mark.parametrize("kinematics", ["linear", pytest.param("finite", marks=pytest.mark.slow)])
def test_stops_change_nothing(tmp_path, kinematics):
    """Stopped again and again, it has the rows, frames, fields and checkpoints of the run that was left alone."""
    straight, stopped = tmp_path / "straight", tmp_path / "stopped"
    assert alone(scene(kinematics), straight) == FINISHED
    codes = [alone(scene(kinematics), stopped, requests=StopAt(n)) for n in STOPS]
    assert STOPPED in codes
    for _ in range(3):
        if codes[-1] != FINISHED:
            codes.append(alone(scene(kinematics), stopped))
    assert codes[-1] == FINISHED
    expected = outcome(straight)
    assert not differing(outcome(stopped), expected)
    names, *rows = expected["history"]
    assert int(rows[-1][names.index("softened_bonds")]) > 100
