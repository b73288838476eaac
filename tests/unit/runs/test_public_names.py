"""The door for Python: twelve names, loaded when asked for, that do what the command line does."""

import json
import subprocess
import sys

import numpy as np
import pytest

import pdfem_mpi as pdfem
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.interface import Unfinished
from support.helpers import ROOT, outside_launcher
from support.tiny import TINY

NAMES = {
    "Scene", "SceneError", "DeckError", "read_deck", "write_deck", "run", "resume", "check", "open_run", "RunFolder",
    "Simulation", "__version__",
}  # fmt: skip
IMPORT_SECONDS = 0.1  # of processor time; 0.003 is found
SLOW_EXAMPLES = 110  # seconds on a busy machine; some ten are found


def scene(**overrides):
    """A clamped bar of elements that is pulled in two steps."""
    folder = ROOT / "jobs"
    keys = {"mesh.spacing": 0.2, "stepping.kind": "steps", "stepping.load_factors": [0.5, 1.0], "solver.kind": "cg"}
    return pdfem.read_deck(folder / "bar_fe.toml", keys | {"probes": []} | overrides)


def test_there_are_twelve_names_and_importing_them_costs_nothing():
    code = (
        "import time; t = time.process_time(); import pdfem_mpi, sys; t = time.process_time() - t;"
        "print(t, sorted(pdfem_mpi.__all__), [m for m in ('numpy', 'numba', 'mpi4py', 'h5py') if m in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, env=outside_launcher())
    seconds, rest = done.stdout.split(" ", 1)
    assert rest.strip() == f"{sorted(NAMES)} []"
    assert float(seconds) < IMPORT_SECONDS


def test_every_name_is_there_and_no_other():
    assert set(pdfem.__all__) == set(dir(pdfem)) == NAMES
    assert all(getattr(pdfem, name) is not None for name in NAMES)
    with pytest.raises(AttributeError, match="has no attribute 'discretize'"):
        _ = pdfem.discretize


def test_run_stays_a_function_whatever_was_loaded_before():
    """No module of the package takes the place of a public name."""
    _ = pdfem.Simulation
    assert all(callable(getattr(pdfem, name)) for name in NAMES - {"__version__"})


def test_overrides_are_a_dictionary_and_their_problems_name_the_key():
    assert scene().mesh.spacing == 0.2
    with pytest.raises(pdfem.DeckError, match=r"mesh\.spacing"):
        scene(**{"mesh.spacing": "wide"})


def test_a_run_and_a_simulation_have_the_same_bits(tmp_path):
    """Run folder, rows and fields."""
    folder = pdfem.run(scene(), tmp_path / "run", comm=mpi().COMM_SELF)
    simulation = pdfem.Simulation(scene(), mpi().COMM_SELF)
    rows = list(simulation.steps())
    for name in ("load_factor", "displacement", "reaction", "relative_residual"):
        np.testing.assert_array_equal(folder.history[name], [row[name] for row in rows])
    u = simulation.fields().u_nodes
    np.testing.assert_array_equal(folder.nodes.displacement(), u.astype("f4"))
    np.testing.assert_array_equal(folder.nodes.positions, simulation.nodes)
    assert pdfem.open_run(tmp_path / "run").summary["status"] == "finished"


def test_a_simulation_solves_any_load_factor_from_where_it_is():
    simulation = pdfem.Simulation(scene(), mpi().COMM_SELF)
    assert not simulation.fields().u_nodes.any()
    full, half = simulation.solve(1.0), simulation.solve(0.5)
    assert full["load_factor"] == 1.0 and half["step"] == 2
    assert half["displacement"] == pytest.approx(0.5 * full["displacement"], rel=1e-6)


def test_loads_are_changed_and_wrong_ones_leave_the_old():
    simulation = pdfem.Simulation(scene(), mpi().COMM_SELF)
    before = simulation.solve(1.0)
    doubled = [load.model_copy(update={"total": tuple(2.0 * c for c in load.total)}) for load in simulation.scene.loads]
    simulation.change_loads(loads=doubled)
    assert simulation.solve(1.0)["displacement"] == pytest.approx(2.0 * before["displacement"], rel=1e-6)
    with pytest.raises(pdfem.SceneError, match="not in balance"):
        simulation.change_loads(loads=doubled[:1])
    assert simulation.scene.loads == tuple(doubled)


def test_a_run_that_does_not_converge_raises_and_leaves_its_folder(tmp_path):
    hopeless = scene(**{"solver.max_evaluations": 2, "solver.tolerance": 1e-14})
    with pytest.raises(Unfinished, match="not converged") as caught:
        pdfem.run(hopeless, tmp_path / "run", comm=mpi().COMM_SELF)
    assert caught.value.code == 74
    assert json.loads((tmp_path / "run" / "summary.json").read_text())["exit_code"] == 74


def test_a_finished_run_goes_on_to_a_higher_load(tmp_path):
    said = []
    pdfem.run(scene(), tmp_path / "run", comm=mpi().COMM_SELF)
    longer = {"stepping.load_factors": [0.5, 1.0, 1.5]}
    folder = pdfem.resume(tmp_path / "run", longer, comm=mpi().COMM_SELF, report=said.append)
    np.testing.assert_array_equal(folder.history["load_factor"], [0.5, 1.0, 1.5])
    assert any("going on from" in line for line in said)


def test_check_says_what_would_be_allocated():
    assert pdfem.check(scene(), comm=mpi().COMM_SELF)["elements"].isdigit()


def test_a_deck_is_written_and_read_back(tmp_path):
    (tmp_path / "deck.toml").write_text(TINY)
    tiny = pdfem.read_deck(tmp_path / "deck.toml")
    (tmp_path / "again.toml").write_text(pdfem.write_deck(tiny))
    assert pdfem.read_deck(tmp_path / "again.toml") == tiny


@pytest.mark.parametrize("name", ["bar", "study", "failing_plate"])
def test_examples_run(name, tmp_path):
    """As a person would: from another folder, with what they print and draw."""
    script = ROOT / "jobs" / "examples" / f"{name}.py"
    environment = outside_launcher(MPLBACKEND="Agg")
    done = subprocess.run(
        [sys.executable, str(script)],
        cwd=tmp_path,
        env=environment,
        capture_output=True,
        text=True,
        timeout=SLOW_EXAMPLES,
        check=False,
    )
    assert done.returncode == 0, done.stderr
    if name == "study":
        assert len(done.stdout.splitlines()) == 4
    else:
        assert (tmp_path / f"{name}.png").stat().st_size > 10_000
