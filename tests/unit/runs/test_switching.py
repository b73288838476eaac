"""Regions of bonds that a run finds: they follow the crack, and nothing is lost where elements are turned."""

import weakref

import h5py
import numpy as np
import pytest

from pdfem_mpi import Simulation
from pdfem_mpi.deck.loads import Support, Traction
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.programs import Events, Steps
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs import memory_estimate, switching
from pdfem_mpi.runs.region_notes import describe_staying
from pdfem_mpi.solvers.convergence import NotConverged
from pdfem_mpi.solvers.preconditioner.cycle import Cycle
from pdfem_mpi.stepping.arrest import MOST_DRIFT
from support.adaptive import AUTO, DRAWN, FAST, plate, rows_of
from support.bodies import YOUNGS_MODULUS
from support.restarts import StopAt, alone, differing, outcome

FINISHED, STOPPED = 0, 75
#: Loads of equal numbers of broken bonds: of a region of three cells, of which the widening check tells some 0.3 %.
OF_LOADS = 0.01
#: Work that the books lose: sums of some thousand terms, each rounded once.
LEDGER = 1e-10


def test_the_region_follows_the_crack():
    """Loads of the first breaks are those of bonds everywhere, and the ledger closes across switches."""
    self = mpi().COMM_SELF
    found, drawn = Simulation(plate(), self), Simulation(plate(DRAWN), self)
    rows, expected = rows_of(found), rows_of(drawn)
    loads, wanted = (
        [(row["broken_bonds"], row["reaction"]) for row in some if row["event"] == "critical"]
        for some in (rows, expected)
    )
    assert len(wanted) > 2
    for (broken, load), (same, reference) in zip(loads[:3], wanted[:3], strict=True):
        assert broken == same
        assert load == pytest.approx(reference, rel=OF_LOADS)
    switches = [row for row in rows if row["event"] == "switch"]
    assert len(switches) >= 2
    assert all(abs(row["ledger_error"]) < LEDGER for row in rows)
    assert [row["bonds"] for row in rows] == sorted(row["bonds"] for row in rows)
    assert rows[0]["bonds"] < rows[-1]["bonds"] <= drawn.model.bonds.count
    assert 0.0 < found.state.program["foretold"] < 0.8
    assert 0.0 <= found.state.program["staying"] < 1.0
    assert list(describe_staying(found)) == []
    found.state.program["staying"] = 1.25
    assert "1.25 times the critical stretch" in next(describe_staying(found))
    assert rows[-1]["broken_bonds"] == pytest.approx(expected[-1]["broken_bonds"], rel=0.1)


def test_stops_change_nothing(tmp_path):
    """Stopped again and again, before and after switches: rows, frames and checkpoints of the run left alone."""
    straight, stopped = tmp_path / "straight", tmp_path / "stopped"
    assert alone(plate(), straight) == FINISHED
    codes = []
    for n in (4, 9, 2, 1, 1, 1, 1, 1, 3, 60, 60):
        codes.append(alone(plate(), stopped, requests=StopAt(n)))
        if codes[-1] == FINISHED:
            break
    assert codes.count(STOPPED) > 5
    assert codes[-1] == FINISHED
    assert not differing(outcome(stopped), outcome(straight))


def test_a_cycle_that_is_kept_is_as_one_made_anew(monkeypatch):
    """Also where nothing holds some rigid motions, whose directions among the unknowns are others after a switch.

    Whether it is kept depends on which cells ranks have before and after, and so on their number.
    """
    ends = tuple(Support(face=face, layers=1, x=x) for face, x in (("x-", -0.02), ("x+", 0.02)))
    early = Events(kind="events", **FAST | {"end_reaction": 0.9})
    scene = plate(stepping=early).model_copy(update={"supports": ends})
    kept = rows_of(Simulation(scene, mpi().COMM_SELF))
    assert sum(row["event"] == "switch" for row in kept) > 0
    monkeypatch.setattr(Cycle, "holds", lambda self, fixed: False)
    assert rows_of(Simulation(scene, mpi().COMM_SELF)) == kept


def test_a_region_that_stays_ends_with_a_sentence():
    """Without growth the run ends where the region does not hold."""
    with pytest.raises(NotConverged, match=r"adaptive\.growth = 0 keeps it"):
        rows_of(Simulation(plate(adaptive={"growth": 0.0}), mpi().COMM_SELF))


def test_too_many_bonds_end_with_a_sentence():
    scene = plate(adaptive={"max_bonds": 6e4})
    with pytest.raises(NotConverged, match=r"adaptive\.max_bonds = 60000 ends the run"):
        rows_of(Simulation(scene, mpi().COMM_SELF))


def test_a_crack_led_into_elements_ends_with_a_sentence():
    """Cells ahead of the notch stay elements: what breaks beside them would not be the body's."""
    regions = (
        Region(name="body", model="auto", upper=(18.0, 9.0, 1.0)),
        Region(name="upper", model="auto", lower=(0.0, 9.0, 0.0), always_elements=True),
    )
    with pytest.raises(NotConverged, match="cells that must stay elements"):
        rows_of(Simulation(plate(regions), mpi().COMM_SELF))


def test_steps_switch_too():
    """At given loads the region grows before anything breaks beside it, and books of bonds go along."""
    scene = plate(stepping=Steps(load_factors=(0.3, 0.5)))
    simulation = Simulation(scene, mpi().COMM_SELF)
    rows = rows_of(simulation)
    assert [row["load_factor"] for row in rows] == [0.3, 0.5]
    assert rows[1]["broken_bonds"] > 0
    assert simulation.state.program["switches"] >= 1
    drawn = next(Simulation(plate(DRAWN, stepping=scene.stepping), mpi().COMM_SELF).steps())
    assert rows[0]["reaction"] == pytest.approx(drawn["reaction"], rel=OF_LOADS)


def test_the_old_body_is_gone_before_the_new_one_is_made(monkeypatch):
    """A switch never holds the bonds of two bodies."""
    simulation, alive, build = Simulation(plate(), mpi().COMM_SELF), [], Simulation.build
    old = [weakref.ref(simulation.model)]

    def watched(self, share, again=False):
        alive.append(old[0]() is not None)
        build(self, share, again)
        old[0] = weakref.ref(self.model)

    monkeypatch.setattr(Simulation, "build", watched)
    for _ in simulation.steps():
        if simulation.state.program.get("switches") == 1.0:
            break
    assert alive == [False]


def test_a_switch_before_the_first_break_under_forces():
    """Nothing breaks on displacements that were only interpolated: the state is relaxed first, also under loads.

    The first region is that around a crack far from the notch, and does not hold.
    """
    few = Events(kind="events", **FAST | {"end_load_factor": 0.3})
    rows = to_the_first_break(few)
    switches = [row for row in rows if row["event"] == "switch"]
    assert switches and all(row["relative_residual"] < 0.1 for row in switches)
    drawn = next(Simulation(of_forces(plate(DRAWN, stepping=few), beside_a_crack()), mpi().COMM_SELF).steps())
    assert rows[-1]["broken_bonds"] == drawn["broken_bonds"] == 0
    assert rows[-1]["load_factor"] == pytest.approx(drawn["load_factor"], rel=OF_LOADS)


def test_other_supports_get_a_preconditioner_of_their_own():
    """That of the supports before was kept from where the region was found, and its grid holds what they held."""
    simulation = Simulation(plate(), mpi().COMM_SELF)
    assert simulation.kept_cycle is not None
    ends = tuple(Support(face=face, layers=1, x=x) for face, x in (("x-", -0.02), ("x+", 0.02)))
    simulation.change_loads(supports=ends)
    assert simulation.kept_cycle is None
    assert simulation.solve(0.1)["relative_residual"] <= 1e-8


def test_a_load_read_after_a_switch_does_not_hang_on_the_tolerance():
    """A stable state comes to rest on its new region before the load of the next break is read from it."""
    loads = []
    for tolerance in (2e-2, 1e-9):
        rows = to_the_first_break(
            Events(kind="events", **FAST | {"end_load_factor": 0.3, "arrest_tolerance": tolerance})
        )
        assert rows[-2]["event"] == "switch"
        loads.append(rows[-1]["load_factor"])
    assert loads[0] == pytest.approx(loads[1], rel=MOST_DRIFT)


def to_the_first_break(stepping):
    """Rows of a plate of which a run finds the region around the wrong crack first."""
    simulation, rows = Simulation(of_forces(plate(stepping=stepping), beside_a_crack()), mpi().COMM_SELF), []
    for row in simulation.steps():
        rows.append(row)
        if row["event"] == "critical":
            break
    return rows


def beside_a_crack():
    """Loads, and a crack far from the notch."""
    crack = Crack(polygon=((4.0, 11.0, -1.0), (4.0, 13.0, -1.0), (4.0, 13.0, 2.0), (4.0, 11.0, 2.0)))
    held = Support(face="x-", layers=1, x=0.0, y=0.0, z=0.0)
    loads = (Traction(kind="traction", face="x+", traction=(25.0, 0.0, 0.0)),)
    return {"supports": (held,), "loads": loads, "cracks": (crack,)}


def of_forces(scene, tables):
    """The scene with other supports, loads and cracks."""
    return Scene.model_validate({**dict(scene), **tables})


def test_a_frame_that_waits_is_that_of_the_body_before_a_switch(tmp_path):
    """Every second row is written; the run ends without equilibrium beyond a switch, and says so."""
    stepping = Steps(load_factors=(0.1, 0.2, 0.9))
    scene = of_forces(plate(stepping=stepping), {"output": Output(figures=False, damage=True, every=2)})
    assert alone(scene, tmp_path / "run") == 74
    assert (tmp_path / "run" / "summary.json").is_file()
    with h5py.File(tmp_path / "run" / "body.vtkhdf") as file:
        group = file["VTKHDF"]
        assert group["FieldData/load_factor"][()].tolist() == [0.1, 0.2]
        first, last = group["PointData/displacement"][()].reshape(2, -1, 3).astype(float)
        models = group["CellData/model"][()].reshape(2, -1)
    np.testing.assert_array_equal(models[1], models[0])
    np.testing.assert_allclose(last, 2.0 * first, rtol=0, atol=1e-6 * np.abs(last).max())  # frames are float32


@pytest.mark.slow
def test_softened_bonds_go_through_switches(tmp_path):
    """With their teeth: the loads are those of bonds everywhere, the ledger closes, and stops change nothing."""
    soft = Material(youngs_modulus=YOUNGS_MODULUS, tensile_strength=0.002 * YOUNGS_MODULUS, fracture_energy=0.012)
    scene, drawn = (plate(regions).model_copy(update={"material": soft}) for regions in (AUTO, DRAWN))
    found, everywhere = Simulation(scene, mpi().COMM_SELF), Simulation(drawn, mpi().COMM_SELF)
    rows, expected = rows_of(found), rows_of(everywhere)
    assert sum(row["event"] == "switch" for row in rows) >= 2
    assert all(abs(row["ledger_error"]) < LEDGER for row in rows)
    assert rows[-1]["softened_bonds"] > 0
    for loads in (rows, expected):
        loads[:] = [row for row in loads if row["event"] == "critical"]
    peak, wanted = (max(row["reaction"] for row in some) for some in (rows, expected))
    assert peak == pytest.approx(wanted, rel=OF_LOADS)
    assert rows[0]["reaction"] == pytest.approx(expected[0]["reaction"], rel=OF_LOADS)
    assert found.failure.dissipated == pytest.approx(everywhere.failure.dissipated, rel=0.1)
    straight, stopped = tmp_path / "straight", tmp_path / "stopped"
    assert alone(scene, straight) == FINISHED
    codes = [alone(scene, stopped, requests=StopAt(n)) for n in (5, 2, 1, 1, 1)]
    assert codes.count(STOPPED) > 3
    assert alone(scene, stopped) == FINISHED
    assert not differing(outcome(stopped), outcome(straight))


def test_bonds_across_mirror_planes_have_two_names():
    """Of point p with the image of q, and of q with the image of p; their teeth go along."""
    cells = 5
    inside, across = [8 * 1 + 3, 8 * 2 + 4, 1], [8 * 1 + 3, 8 * (4 + cells * 2) + 7, 6]
    own = [8 * 1 + 1, 8 * (1 + cells) + 1, 0]
    found = switching.with_other_names(np.array([inside, across, own]), cells)
    other = [8 * 4 + 7, 8 * (1 + cells * 2) + 3, 6]
    assert sorted(found.tolist()) == sorted([inside, across, own, other])


def test_a_switch_that_does_not_fit_ends_before_it_is_made(monkeypatch):
    """The limit is that of a process which has room for the first region, and no more."""
    simulation = Simulation(plate(), mpi().COMM_SELF)
    monkeypatch.setattr(switching, "fits_easily", lambda share, most: False)
    few = memory_estimate.Limit(1.0, "a job of this size")
    monkeypatch.setattr(memory_estimate, "own_limit", lambda: few)
    build, made = Simulation.build, []
    monkeypatch.setattr(Simulation, "build", lambda self, share, again: (made.append(share), build(self, share, again)))
    with pytest.raises(NotConverged, match=r"cannot grow: .* does not fit into memory"):
        rows_of(simulation)
    assert not made
