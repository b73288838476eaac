"""First break, peak, counts and crack of bodies that fail, as summary.json, the end table and `info` tell them."""

import json
from types import SimpleNamespace

import numpy as np
import pytest

from pdfem_mpi.body.lattice_planes import lattice_energy
from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.results.inspect import describe
from pdfem_mpi.runs.failure_outcome import crack_in_a_mirror, failure_rows, first_break, peak
from pdfem_mpi.runs.history_rows import FAILURE_HISTORY
from support.failing import strip
from support.reporters import Listener
from support.restarts import alone
from support.softening import RATIO, soft_strip

TINY = {"cells": (5, 3, 1), "crack": (-1.0, 1.1)}


class Ones:
    force = length = 1.0


def columns(**given):
    return {name: np.array(values) for name, values in given.items()}


def test_rows_of_steps_tell_the_first_break_and_the_peak():
    """The first row with broken or softened bonds; the largest reaction in equilibrium; nothing where nothing broke."""
    history = columns(
        step=[1, 2, 3, 4],
        event=["step", "step", "batch", "step"],
        reaction=[1.0, 3.0, 9.0, 2.0],
        displacement=[0.1, 0.2, 0.3, 0.4],
        broken_bonds=[0, 0, 2, 2],
        softened_bonds=[0, 1, 1, 1],
    )
    assert first_break(history, {}, Ones) == {"load": 3.0, "displacement": 0.2, "row": 2}
    assert peak(history, {}, Ones) == {"load": 3.0, "displacement": 0.2, "row": 2}
    del history["softened_bonds"]
    assert first_break(history, {}, Ones)["row"] == 3
    history["broken_bonds"] = np.zeros(4)
    assert first_break(history, {}, Ones) is None


@pytest.mark.parametrize("control", ["load", "energy"])
@pytest.mark.parametrize("soft", [True, False])
def test_summary_of_a_run(tmp_path, control, soft):
    """By the rows of the history where these hold all critical states; energy control keeps its peak by itself."""
    scene = (
        soft_strip(3.0, control=control, report_every=3, **TINY)
        if soft
        else strip(control=control, report_every=3, **TINY)
    )
    scene = scene.model_copy(update={"output": Output(figures=False, fields=False)})
    scene = scene.model_copy(update={"stepping": scene.stepping.model_copy(update={"end_reaction": 0.6})})
    listener = Listener()
    assert alone(scene, tmp_path / "run", reporter=listener) == 0
    found = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))["failure"]
    lines = (tmp_path / "run" / "history.csv").read_text(encoding="utf-8").splitlines()
    names, rows = lines[0].split(","), [line.split(",") for line in lines[1:]]
    assert ("softened_bonds" in names) == soft and set(FAILURE_HISTORY) <= set(names)
    column = {name: [row[k] for row in rows] for k, name in enumerate(names)}
    critical = [k for k, event in enumerate(column["event"]) if event == "critical"]
    reaction = np.array(column["reaction"], float)
    assert found["first_break"]["load"] == pytest.approx(reaction[critical[0]], rel=1e-9)
    assert found["first_break"]["row"] == 1
    if control == "load":
        best = critical[int(np.argmax(reaction[critical]))]
        assert found["peak"]["load"] == pytest.approx(reaction[best], rel=1e-9)
        assert found["peak"]["displacement"] == pytest.approx(float(column["displacement"][best]), rel=1e-9)
        assert found["peak"]["row"] == best + 1
    else:
        assert found["peak"]["load"] >= reaction[critical].max() * (1.0 - 1e-9)
    assert found["broken_bonds"] == int(column["broken_bonds"][-1])
    assert (found["softened_bonds"] > 0) == soft
    assert found["crack"]["area"] > 0.0
    low, high = (float(column[f"crack_y_{end}"][-1]) for end in ("min", "max"))
    assert (found["crack"]["lower"][1], found["crack"]["upper"][1]) == pytest.approx((low, high))
    material = found["materials"]["default"]
    assert found["fracture_energy"]["bulk"] == material["fracture_energy_bulk"]
    assert (material["softening"] is not None) == soft
    table = dict(failure_rows(found, scene))
    assert set(table) >= {"first break", "peak", "crack area, energy over G_c"}
    _, told, _ = describe(tmp_path / "run")
    assert any(name == "peak" and text.startswith(f"{found['peak']['load']:.6g} at ") for name, text in told)


def test_laws_and_noise_are_told_in_a_run(tmp_path):
    """One sentence with the law of the body, its energies in it, and one about the noise; steps that skip teeth."""
    listener = Listener()
    scene = soft_strip(noise=0.005, stepping=Steps(load_factors=(1.0,)), **TINY)
    scene = scene.model_copy(update={"output": Output(figures=False, fields=False)})
    assert alone(scene, tmp_path / "run", reporter=listener) == 0
    law = json.loads((tmp_path / "run" / "summary.json").read_text(encoding="utf-8"))["failure"]["materials"]["default"]
    softening = law["softening"]
    planes = softening["energy_of_planes"]
    assert planes == pytest.approx(lattice_energy(1.0, 2.5, "virial"), rel=1e-9)
    assert softening["drop"] == pytest.approx(0.5 / planes, rel=1e-9)
    final = 1.0 + ((1.0 + 0.5 * (RATIO - 1.0)) / planes - 1.0) / softening["drop"]
    assert softening["final_stretch"] == pytest.approx(final * softening["first_stretch"], rel=1e-4)
    first = f"bonds soften: from s_t = {softening['first_stretch']:.4g} to s_c = "
    assert listener.said(first, f"in {softening['teeth']} teeth", "planes across x, y, z cut")
    assert listener.said("stiffness_noise = 0.005")
    assert listener.said("passed several teeth of their softening at once")
    assert law["strength"] == scene.material.tensile_strength
    assert law["fracture_energy_bulk"] == scene.material.fracture_energy


@pytest.mark.parametrize(
    "planes, told", [(((0.0,), (), ()), True), (((0.0, 9.0), (), ()), False), (((-4.0,), (), ()), False)]
)
def test_a_crack_in_a_mirror_plane_is_warned_of(planes, told):
    """A flat box of gone bonds at a plane; not beside it, and not where two planes repeat the body."""
    scene = soft_strip(cells=(6, 6, 1), crack=None)
    mesh = scene.mesh.model_copy(update={"symmetry": ("x-", "x+")[: len(planes[0])]})
    failure = SimpleNamespace(count=9, extent=np.array([[0.1, 0.0, 0.0], [1.2, 5.0, 1.0]]))
    share = SimpleNamespace(mirrors=SimpleNamespace(planes=planes), cutoff=2.5)
    found = list(crack_in_a_mirror(scene.model_copy(update={"mesh": mesh}), share, failure))
    assert [text.startswith("warning: the crack runs in the mirror plane x-") for text in found] == [True] * told
    assert list(crack_in_a_mirror(scene, share, None)) == []
