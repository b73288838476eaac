"""A number that is not finite stops the run at once, and the message names its point or node and where it is."""

import json
import math
from unittest.mock import patch

import numpy as np
import pytest

from pdfem_mpi.deck.programs import Solver
from pdfem_mpi.deck.toml import write_deck
from pdfem_mpi.model.not_finite import NotFinite
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.peridynamics.clusters import cluster_layout, point_rows
from pdfem_mpi.runs.run import run
from pdfem_mpi.stepping import make_solver
from support.bodies import build, make_scene
from support.reporters import Silence

CELLS = (6, 2, 2)
BLOCK = 2  # evaluations: one to fit the bounds of the sums, one that counts
POISONS = (math.nan, math.inf, -math.inf, 1e200)


def scene(solver="adr", kinematics="linear"):
    return make_scene(CELLS, 3, kinematics=kinematics).model_copy(
        update={"solver": Solver(kind=solver, max_evaluations=50)}
    )


def solve(body, watch=lambda progress: None):
    solver = make_solver(body.scene, body.share, body.forces, body.case, Silence().line)
    return solver(body.state, body.case.external, watch)


def at_point(body, i):
    """Index of the y component of local point i among the unknowns, and the sentence's words for it."""
    rows = np.zeros((body.model.unknowns.n_points, 3))
    rows[i, 1] = 1.0
    number = 8 * body.model.points.cell_number[i // 8] + i % 8
    x = point_rows(body.model.points.x)[i]
    return int(np.argmax(cluster_layout(rows))), "point", number, x


def at_node(body, i):
    return 3 * body.model.unknowns.n_points + 3 * i + 1, "node", body.model.nodes.number[i], body.model.nodes.x[i]


def words(body, kind, number, x):
    units = body.share.units
    place = x * units.length + units.origin
    return f"{kind} {number} at ({', '.join(f'{c:.6g}' for c in place)}) is not finite"


@pytest.mark.parametrize("poison", POISONS)
@pytest.mark.parametrize("place", [at_point, at_node])
@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_relaxation_stops_at_a_displacement_that_is_not_finite(place, kinematics, poison):
    body = build(scene(kinematics=kinematics))
    unknown, *named = place(body, 11)

    def spoil(progress):
        if progress.iteration == 3:
            body.state.u[unknown] = poison

    with pytest.raises(NotFinite) as stop:
        solve(body, spoil)
    assert f"displacement of {words(body, *named)}" in str(stop.value)
    assert body.state.iteration == 4  # the one after


@pytest.mark.parametrize("solver", ["adr", "cg"])
@pytest.mark.parametrize("place", [at_point, at_node])
@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_solvers_stop_at_a_displacement_they_start_from(place, kinematics, solver):
    body = build(scene(solver, kinematics))
    unknown, *named = place(body, 5)
    body.state.u[unknown] = math.nan
    with pytest.raises(NotFinite) as stop:
        solve(body)
    assert f"displacement of {words(body, *named)}" in str(stop.value)
    assert body.forces.evaluations <= BLOCK


@pytest.mark.parametrize("solver", ["adr", "cg"])
@pytest.mark.parametrize("poison", [math.nan, math.inf])
@pytest.mark.parametrize("place", [at_point, at_node])
def test_solvers_stop_at_a_load_that_is_not_finite(place, poison, solver):
    body = build(scene(solver))
    unknown, *named = place(body, 7)
    body.case.external[unknown] = poison
    with pytest.raises(NotFinite) as stop:
        solve(body)
    assert f"force of {words(body, *named)}" in str(stop.value)
    assert body.forces.evaluations <= BLOCK


def test_a_run_ends_with_74_and_the_place_in_its_summary(tmp_path):
    """No frame and no row is written of a body that is not finite."""
    from pdfem_mpi.runs import assembly as composition

    def spoilt(scene, share, model):
        case = make_load_case(scene, share, model)
        case.external[at_node(body, 4)[0]] = math.nan
        return case

    make_load_case, body = composition.make_load_case, build(scene())
    with patch("pdfem_mpi.runs.assembly.make_load_case", spoilt):
        code = run(scene(), mpi().COMM_SELF, tmp_path, write_deck(scene()), True, Silence())
    summary = json.loads((tmp_path / "summary.json").read_text())
    assert code == 74 and words(body, *at_node(body, 4)[1:]) in summary["reason"]
    assert len((tmp_path / "history.csv").read_text().splitlines()) == 1
