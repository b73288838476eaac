"""The error that a region three times as wide tells, and that looking for it changes nothing."""

import json
import weakref

import pytest

from pdfem_mpi import Simulation
from pdfem_mpi.deck.programs import Events
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs import assembly, widening
from support.adaptive import DRAWN, FAST, plate, rows_of
from support.restarts import StopAt, alone, differing, outcome

FINISHED, STOPPED = 0, 75
#: Loads of equal numbers of broken bonds: of a region of three cells, of which the widening check tells some 0.3 %.
OF_LOADS = 0.01
#: Ends some batches after the first break, and after the peak.
FEW = Events(kind="events", **FAST | {"end_reaction": 0.9})


def test_the_error_is_estimated():
    """Three times as wide a region tells most of what bonds everywhere would change, with its sign."""
    stepping = Events(kind="events", **FAST | {"end_load_factor": 0.41})
    scene, drawn = plate(adaptive={"widening_check": True}, stepping=stepping), plate(DRAWN, stepping=stepping)
    simulation = Simulation(scene, mpi().COMM_SELF)
    first, reference = rows_of(simulation)[0], next(Simulation(drawn, mpi().COMM_SELF).steps())
    true = first["reaction"] / reference["reaction"] - 1.0
    assert abs(true) < OF_LOADS
    assert simulation.state.program["error"] == pytest.approx(true, rel=0.7)


def test_the_error_of_the_peak_is_estimated():
    """With the bonds that are broken there."""
    scene = plate(adaptive={"widening_check": "peak"})
    simulation = Simulation(scene, mpi().COMM_SELF)
    rows, expected = rows_of(simulation), rows_of(Simulation(plate(DRAWN), mpi().COMM_SELF))
    loads, wanted = ([row["reaction"] for row in some if row["event"] == "critical"] for some in (rows, expected))
    program = simulation.state.program
    assert max(loads) > 1.01 * loads[0]
    assert program["widened_at"] > 0.99 * max(loads) / simulation.share.units.force
    assert abs(program["error_of_peak"]) < OF_LOADS
    assert program["error_of_peak"] == pytest.approx(max(loads) / max(wanted) - 1.0, abs=0.005)


@pytest.mark.parametrize("wanted", [True, pytest.param("peak", marks=pytest.mark.slow)])
def test_a_narrow_body_that_goes_first_changes_nothing(monkeypatch, tmp_path, wanted):
    """Rows, frames, checkpoints and the error are those of a run that holds both; also stopped again and again."""
    scene = plate(adaptive={"widening_check": wanted}, stepping=FEW)
    both, one, stopped = (tmp_path / name for name in ("both", "one", "stopped"))
    assert alone(scene, both) == FINISHED
    monkeypatch.setattr(widening, "MANY_BONDS", 0)
    assert alone(scene, one) == FINISHED
    assert not differing(all_of(one), all_of(both))
    codes = [alone(scene, stopped, requests=StopAt(n)) for n in (1, 2, 1, 1, 3)]
    assert codes.count(STOPPED) > 3
    assert alone(scene, stopped) == FINISHED
    assert not differing(all_of(stopped), all_of(both))


def all_of(out):
    """The outcome of a run, with what it says of its region."""
    return outcome(out) | {"adaptive": json.loads((out / "summary.json").read_text(encoding="utf-8"))["adaptive"]}


def test_two_bodies_are_never_there_at_once(monkeypatch):
    """Neither model nor solver of the narrow one when the wider one is made, and the other way round."""
    monkeypatch.setattr(widening, "MANY_BONDS", 0)
    simulation, alive = Simulation(plate(adaptive={"widening_check": True}), mpi().COMM_SELF), []
    simulation.prepare_solver()
    held = [weakref.ref(simulation.model), weakref.ref(simulation.solver)]
    build_wider, build = widening.build_model, Simulation.build

    def wider(*body, **more):
        alive.append([one() is not None for one in held])
        model = build_wider(*body, **more)
        held[:] = [weakref.ref(model)]
        return model

    def narrow(self, share, again=False):
        alive.append([one() is not None for one in held])
        build(self, share, again)

    monkeypatch.setattr(widening, "build_model", wider)
    monkeypatch.setattr(Simulation, "build", narrow)
    for _ in simulation.steps():
        if len(alive) >= 2:
            break
    assert alive == [[False, False], [False]]


def test_pages_are_given_back_once_the_model_is_gone(monkeypatch):
    """Those of the bonds are the most of them."""
    simulation, alive = Simulation(plate(), mpi().COMM_SELF), []
    simulation.prepare_solver()
    held = weakref.ref(simulation.model)
    monkeypatch.setattr(assembly, "give_back", lambda: alive.append(held() is not None))
    simulation.let_go()
    assert alive == [False]
