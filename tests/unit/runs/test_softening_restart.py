"""A run whose bonds soften goes on from any checkpoint as if it had not stopped."""

import pytest

from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.programs import Events
from support.restarts import StopAt, alone, differing, failing, outcome
from support.softening import remade, softening_material

FINISHED, STOPPED = 0, 75
FEW, TEN = (3, 7, 16), (3,) * 10


def scene(kinematics, nu=0.25):
    base = failing("events", kinematics)
    events = Events(kind="events", eta=1e-2, inner_iterations=4, report_every=5, end_load_factor=0.42)
    material = softening_material(ratio=6.0, stretch=0.02, poissons_ratio=nu)
    return remade(base, material=material, stepping=events, output=Output(figures=False, damage=True))


@pytest.mark.parametrize(
    "kinematics, nu, stops",
    [
        ("linear", 0.25, FEW),
        pytest.param("finite", 0.25, FEW, marks=pytest.mark.slow),
        pytest.param("linear", 0.25, TEN, marks=pytest.mark.slow),
        pytest.param("linear", 0.39, TEN, marks=pytest.mark.slow),
        pytest.param("finite", 0.2, FEW, marks=pytest.mark.slow),
    ],
)
def test_stops_change_nothing(tmp_path, kinematics, nu, stops):
    """Stopped again and again, it has the rows, frames, fields and checkpoints of the run that was left alone."""
    straight, stopped = tmp_path / "straight", tmp_path / "stopped"
    assert alone(scene(kinematics, nu), straight) == FINISHED
    codes = [alone(scene(kinematics, nu), stopped, requests=StopAt(n)) for n in stops]
    assert codes.count(STOPPED) == (len(stops) if stops is TEN else codes.count(STOPPED)) > 0
    for _ in range(3):
        if codes[-1] != FINISHED:
            codes.append(alone(scene(kinematics, nu), stopped))
    assert codes[-1] == FINISHED
    expected = outcome(straight)
    assert not differing(outcome(stopped), expected)
    names, *rows = expected["history"]
    assert int(rows[-1][names.index("softened_bonds")]) > 100
