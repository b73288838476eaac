"""From break to break: first breaks, closed ledgers, symmetry, arrests, ends, energy control, finite kinematics."""

import numpy as np
import pytest

from pdfem_mpi.deck.loads import BodyForce, Support
from pdfem_mpi.deck.programs import Events, Steps
from pdfem_mpi.solvers.convergence import Breakdown, NotConverged
from pdfem_mpi.stepping import avalanche, equilibria
from pdfem_mpi.stepping.arrest import LEFT, MOST_DRIFT
from pdfem_mpi.stepping.avalanche import Avalanche
from pdfem_mpi.stepping.ledger import Ledger
from support.failing import CHIP, DEAD, EDGE, GUIDED, STRETCH, chipped, failing, followed, numbers, of_bonds, strip

CLOSED = 1e-10  # of the work: round-off of thousands of sums; 1e-14 is found
TANGENT_STEPS = 1e-4  # of the work, finite kinematics: X is that of the tangent, strains are some 1e-3; 1e-5 is found
FIRST_BREAK = 1e-6
BRACKETED = 2e-6  # as documented, and what the solve leaves
EXACT = 1e-9  # round-off of displacements in what is scaled
SCENES = {
    "supports": {},
    "elements": {"elements": 2},
    "dead loads": {"loads": DEAD, "supports": ()},
    "both": {"loads": DEAD[1:], "supports": (Support(face="x-", x=0.0), Support(face="y-", y=-0.003))},
    "edge crack": {"crack": EDGE},
}
FEW = 12
OVER = 1.9  # of the first break's load, with the chip torn off and nothing else broken
TINY = {"cells": (4, 2, 1), "crack": None}


@pytest.mark.parametrize("control", ["load", "energy"])
@pytest.mark.parametrize("name", SCENES)
def test_ledger_closes(name, control):
    """W = U + D + X at every row, with U by a sweep of its own: whatever is prescribed, whatever is left unrelaxed."""
    run = followed(strip(**SCENES[name], control=control, report_every=1), FEW)
    assert max(abs(row.ledger_error) for row in run.rows) <= CLOSED
    last = run.rows[-1]
    assert last.broken > 0
    assert min(last.stored, last.dissipated, last.work) > 0.0
    assert last.released > 1e-6 * last.work  # not closed for want of terms


@pytest.mark.parametrize("control", ["load", "energy"])
@pytest.mark.parametrize("nu", [0.1, 0.33, 0.4])
def test_ledger_closes_with_a_volumetric_part(nu, control):
    """D then has what the points lose beside what bonds had, which is neither small nor of one sign."""
    run = followed(strip(poissons_ratio=nu, control=control, report_every=1), FEW)
    assert max(abs(row.ledger_error) for row in run.rows) <= CLOSED
    assert run.rows[-1].broken > 0


def test_ledger_closes_to_the_end():
    """Also over an avalanche that takes most of the energy out."""
    run = followed(strip())
    last = run.rows[-1]
    assert max(abs(row.ledger_error) for row in run.rows) <= CLOSED
    assert (last.event, last.dissipated > 0.1 * last.work, last.stored < 0.1 * last.work) == ("end", True, True)


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
@pytest.mark.parametrize("nu", [0.1, 0.25, 0.4])
def test_broken_bonds_dissipate_what_they_had(nu, kinematics):
    """D of the first batch is what the strain energy falls by at the same displacements."""
    run = followed(strip(poissons_ratio=nu, kinematics=kinematics), 1)
    before = run.body.forces.stored_energy(run.body.state.u)
    model, state = run.body.model, run.body.state
    force = np.empty_like(state.u)
    run.body.forces.evaluate_surely(state.u, np.zeros_like(force), force, run.failure, 1e-3)
    broken = run.failure.close(model.comm)
    after = run.body.forces.stored_energy(state.u)
    assert broken > 0
    assert run.failure.dissipated == pytest.approx(before - after, rel=1e-6)


@pytest.mark.parametrize("options", [{}, {"elements": 2}], ids=["bonds", "elements"])
def test_first_break_from_one_solve_is_that_of_fine_steps(options):
    """Nothing breaks a millionth below the load that one equilibrium gives, and something a millionth above it."""
    first = followed(strip(**options), 1).rows[0]
    assert (first.event, first.broken) == ("critical", 0)
    factors = [first.load_factor * (1.0 + k * FIRST_BREAK) for k in (-2, -1, 1)]
    steps = Steps(load_factors=tuple(factors))
    rows = followed(strip(**options, stepping=steps, tolerance=1e-10)).rows
    assert [row.broken > 0 for row in rows] == [False, False, True]
    assert rows[1].reaction == pytest.approx(first.reaction, rel=2.0 * FIRST_BREAK)


@pytest.mark.parametrize(
    "options", [{}, {"elements": 2}, {"kinematics": "finite"}], ids=["bonds", "elements", "finite"]
)
def test_symmetric_body_breaks_symmetrically(options):
    """A strip with a crack at its middle: as many bonds break on either side of each of its planes of symmetry."""
    run = followed(strip(**options), 30)
    middles = run.middles()
    assert len(middles) == run.failure.count > 100
    for d in range(3):
        assert np.count_nonzero(middles[:, d] > EXACT) == np.count_nonzero(middles[:, d] < -EXACT)
    extent = run.rows[-1].extent
    np.testing.assert_allclose(extent[0], -extent[1], rtol=EXACT)


def test_noise_breaks_the_symmetry():
    """The imperfect twin breaks at one side first, near the load of the perfect one; another seed differs."""
    perfect, one, other = (followed(strip(noise=n, seed=s), 10).rows for n, s in ((0.0, 0), (0.02, 1), (0.02, 2)))
    assert [row.broken for row in one] != [row.broken for row in perfect]
    assert one[0].load_factor != other[0].load_factor
    assert one[0].load_factor == pytest.approx(perfect[0].load_factor, rel=0.02)


def test_batches_hold_what_is_within_eta():
    """At a critical state the largest ratio is 1; a wider eta breaks more bonds at once, of less energy each."""
    taken = []
    for eta in (1e-6, 0.2):
        run = failing(strip(eta=eta, report_every=1))
        program = run.follow()
        next(program)
        assert run.ratio() == pytest.approx(1.0, rel=EXACT)
        row = next(program)
        taken.append((row.new_broken, row.dissipated / row.new_broken))
    assert taken[1][0] > taken[0][0]
    assert taken[1][1] < taken[0][1]


def test_arrests_are_stable():
    """An arrest is in equilibrium within its tolerance, and no bond is within eta of critical."""
    run = failing(strip(crack=EDGE, arrest_tolerance=1e-4))
    arrests = 0
    for row in run.follow(20):
        if row.event != "batch":  # what peaks and the end are judged by
            assert run.body.state.program["reaction"] == pytest.approx(row.reaction, rel=EXACT)
        if row.event == "arrest":
            arrests += 1
            assert row.convergence.residual <= 1e-4
            assert run.ratio() <= 1.0 - 1e-3
    assert arrests >= 3


@pytest.mark.parametrize("control", ["load", "energy"])
def test_a_tighter_tolerance_takes_the_same_way(control):
    """The same events and numbers of broken bonds, at loads that agree to what arrests leave."""
    ways = []
    for tolerance in (1e-3, 1e-4):
        rows = followed(strip(crack=EDGE, control=control, report_every=1, arrest_tolerance=tolerance), 30).rows
        ways.append([(row.event, row.broken, row.load_factor) for row in rows])
    assert [way[:2] for way in ways[0]] == [way[:2] for way in ways[1]]
    assert [way[2] for way in ways[0]] == pytest.approx([way[2] for way in ways[1]], rel=LEFT * MOST_DRIFT)


@pytest.mark.slow
def test_peak_hardly_depends_on_inner_iterations():
    """Stable states are the same whether relaxed a little or fully between batches, to .1 % of the peak."""
    peaks = [
        max(row.reaction for row in followed(strip(inner_iterations=m)).rows if row.event == "critical")
        for m in (8, 200)
    ]
    assert peaks[0] == pytest.approx(peaks[1], rel=1e-3)


def test_end_load_factor_is_met_exactly():
    """The run ends at it, in the elastic range or between breaks, whatever the load rounds to."""
    first = followed(strip(), 1).rows[0].load_factor
    for limit in (0.1, 0.9 * first, first * 1.02):
        rows = followed(strip(end_load_factor=limit)).rows
        assert (rows[-1].event, rows[-1].load_factor) == ("end", limit)
        assert all(row.load_factor < limit for row in rows[:-1])
    finite = followed(strip(end_load_factor=0.5 * first, kinematics="finite")).rows
    assert [(row.event, row.load_factor) for row in finite] == [("end", 0.5 * first)]


@pytest.mark.parametrize("over", [0.5, OVER])
def test_the_last_state_counts_as_a_peak(over):
    """A run that ends at a load factor ends in equilibrium there, which may carry more than all before."""
    first = followed(chipped(), 1).rows[0]
    run = followed(chipped(end_load_factor=over * first.load_factor))
    last, program = run.rows[-1], run.body.state.program
    assert last.event == "end" and last.reaction == max(row.reaction for row in run.rows if row.event != "batch")
    assert program["peak"] == pytest.approx(last.reaction, rel=EXACT)
    assert program["peak_row"] == last.step
    assert program["peak_displacement"] == last.displacement
    assert program["first_row"] == (1.0 if over > 1.0 else 0.0)


@pytest.mark.parametrize("control", ["load", "energy"])
def test_end_reaction(control):
    """The run ends as soon as the reaction is below the fraction of the peak."""
    rows = followed(strip(end_reaction=0.8, control=control, report_every=1)).rows
    peak = max(row.reaction for row in rows if row.event == "critical")
    assert rows[-1].event == "end"
    assert rows[-1].reaction < 0.8 * peak
    assert all(row.reaction >= 0.8 * peak for row in rows[:-1] if row.event != "batch")  # which is told after relaxing


def test_dead_loads_tear_the_body_apart():
    """Under held forces the pieces run away: the run ends, without a number that is not finite."""
    run = followed(strip(loads=DEAD, supports=()))
    last = run.rows[-1]
    assert last.event == "end"
    assert np.isfinite(run.body.state.u).all()
    assert all(np.isfinite(value) for value in (last.work, last.stored, last.dissipated, last.released))


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_an_arrest_tolerance_below_the_solvers_breaks_nothing_at_first(kinematics):
    """The first state is then relaxed further under forces: it does not run away, and breaks at its own load."""
    loads = (DEAD[1],)
    supports = (Support(face="x-", x=0.0, y=0.0, z=0.0),)
    scenes = (strip(loads=loads, supports=supports, arrest_tolerance=t, kinematics=kinematics) for t in (1e-4, 1e-10))
    usual, tight = (followed(scene, 1).rows[0] for scene in scenes)
    assert (tight.event, tight.broken) == (usual.event, usual.broken) == ("critical", 0)
    assert tight.load_factor == pytest.approx(usual.load_factor, rel=BRACKETED)


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_what_comes_loose_loses_its_load(capsys, kinematics):
    """A chip torn off by its own load is told and carries none from then on; the rest breaks as if it had never been.

    The neck's bonds are then broken in a strip whose chip has no load: both find the same load of the next break.
    """
    scene = {"arrest_tolerance": 1e-7, "kinematics": kinematics, "report_every": 1}
    run = failing(chipped(**scene))
    bare = failing(chipped(loads=(), **scene))
    told, at = "", 0.0
    for row in run.follow():
        told += capsys.readouterr().out
        if row.event == "critical" and row.load_factor > 2.0 * at > 0.0:  # the load of the chip was what broke its neck
            break
        at = max(at, row.load_factor)
    bare.failure.restore(*of_bonds(bare.body.model), run.failure.broken_pairs(), run.failure.dissipated_digits)
    bare.solve.update_after_breaks(bare.failure.take())
    (alone,) = bare.follow(1)
    assert row.load_factor == pytest.approx(alone.load_factor, rel=1e-6)
    assert row.reaction == pytest.approx(alone.reaction, rel=1e-6)
    assert "loads are off what came loose: " in told
    if kinematics == "linear":
        assert abs(row.ledger_error) <= 100.0 * CLOSED  # of the work up to the neck's break, a hundred times smaller


def test_a_program_taken_up_again_keeps_its_counts(capsys):
    """Which loads are off is found anew, nothing else: neither what is adrift nor what was told."""
    run = failing(chipped(report_every=1))
    for _ in run.follow():
        if "loads are off" in capsys.readouterr().out:
            break
    state = run.body.state
    state.program["adrift"] = 2.0
    books = ledger_of(run)
    assert books.case.load < run.body.case.load
    assert state.program["adrift"] == 2.0
    assert capsys.readouterr().out == ""


def test_load_that_stretches_nothing_is_named():
    """Compression along x with the sides held: no bond that may break is stretched."""
    squeezed = (
        Support(face="x-", x=0.01), Support(face="x+", x=-0.01),
        Support(lower=(0.0, 0.0, 0.0), upper=(9.0, 9.0, 9.0), y=0.0, z=0.0),
    )  # fmt: skip
    with pytest.raises(NotConverged, match="the load stretches no bond that may break"):
        followed(strip(supports=squeezed, crack=None))


def test_stagnation_is_named(monkeypatch):
    """A relaxation that gets nowhere after a break: the run stops and says where bonds broke last."""

    def nothing(forces, residual, fixed, goal, sweeps, preconditioner, step):
        step[:] = 0.0
        return 0.0, 0.0

    monkeypatch.setattr(avalanche.cg, "improve", nothing)
    run = failing(strip())
    with pytest.raises(NotConverged, match=r"after \d+ broken bonds .* stagnates at .* The last bonds"):
        list(run.follow())
    assert [row.event for row in run.rows] == ["critical"]


# --- energy control


def test_energy_control_keeps_a_bond_critical():
    """Every row is in equilibrium with its largest ratio at 1; loads go down as well as up; D grows as bonds break."""
    run = failing(strip(control="energy", report_every=1, arrest_tolerance=1e-5))
    loads = []
    for row in run.follow(40):
        assert row.event == "critical"
        assert row.convergence.residual <= 1e-5
        assert run.ratio() == pytest.approx(1.0, rel=EXACT)
        loads.append(row.load_factor)
    changes = np.diff(loads)
    assert changes.min() < 0.0 < changes.max()


def test_energy_control_relaxes_until_it_is_enough(monkeypatch):
    """Loads are scaled in equilibrium only, also where one relaxation does not get there."""
    monkeypatch.setattr(avalanche, "MOST_SWEEPS", 6)
    rows = followed(strip(control="energy", report_every=1, arrest_tolerance=1e-5), 10).rows
    assert max(row.convergence.residual for row in rows) <= 1e-5


# --- finite kinematics


@pytest.mark.parametrize("control", ["load", "energy"])
@pytest.mark.parametrize(
    "options", [{}, {"loads": DEAD, "supports": ()}, {"elements": 2}], ids=["pulled", "dead", "elements"]
)
def test_finite_kinematics_brackets_the_load(options, control):
    """The first break is that of linear kinematics but for the strain, its stretch critical within the bracket."""
    linear = followed(strip(**options), 1).rows[0]
    run = failing(strip(**options, kinematics="finite", control=control, report_every=1))
    seen = 0
    for row in run.follow(8):
        if row.event == "critical":
            seen += 1
            assert abs(run.ratio() - 1.0) <= BRACKETED
            assert row.convergence.residual <= 1e-6
        if row.event in ("critical", "arrest"):
            assert run.body.state.program["reaction"] == pytest.approx(row.reaction, rel=EXACT)
    assert seen >= 1
    assert run.rows[0].load_factor == pytest.approx(linear.load_factor, rel=2.0 * STRETCH)
    assert run.rows[0].load_factor != linear.load_factor
    assert max(abs(row.ledger_error) for row in run.rows) <= TANGENT_STEPS


def test_bracket_does_not_trust_a_loose_state():
    """The load is found also where the state to begin with, out of equilibrium, shows a stretch beyond critical."""
    run = followed(strip(kinematics="finite"), 1)
    state = run.body.state
    found = state.load_factor
    state.load_factor *= 0.9
    state.u[:] *= 0.9
    books = ledger_of(run)
    books.evaluate()
    equilibria.bracket(books, 1.001, np.inf)
    assert state.load_factor == pytest.approx(found, rel=BRACKETED)


def ledger_of(run):
    return Ledger(run.body.scene.stepping, run.solve, run.failure, run.body.state, run.body.case, lambda *told: None)


def test_a_part_that_stays_out_of_equilibrium_is_told_with_its_place(monkeypatch):
    """The sentence names what moved at last."""
    run = followed(strip(kinematics="finite"), 1)
    books, state = Avalanche(ledger_of(run)), run.body.state
    state.program["relative"] = 211.0
    books.step[:] = state.u
    monkeypatch.setattr(avalanche, "find_rest", lambda ledger: False)
    with pytest.raises(NotConverged, match=r"stagnates at 211, .* Still moving: \d+ points from \(.*\) to \(.*\) move"):
        avalanche._refuse_stagnation(books.ledger, books.step, 211.0)


@pytest.mark.parametrize("breaks_down", [False, True], ids=["newton", "relaxation"])
@pytest.mark.parametrize("options", [{}, {"loads": DEAD, "supports": ()}], ids=["pulled", "dead"])
def test_what_stagnates_comes_to_rest_with_closed_books(options, breaks_down, monkeypatch):
    """Displacements out of equilibrium, as of a part that swings: what loads work and nothing stores is released."""
    run = followed(strip(kinematics="finite", **options), 1)
    books, state = ledger_of(run), run.body.state
    if breaks_down:

        def broken_down(*arguments):
            raise Breakdown("for a test.")

        monkeypatch.setattr(equilibria.cg, "solve", broken_down)
    moved = 1e-3 * np.random.default_rng(3).uniform(-1.0, 1.0, len(state.u))
    state.u[:] += np.where(run.body.case.fixed, 0.0, moved)
    books.evaluate()

    def difference():
        return state.program["work"] - books.stored() - state.program["released"]

    before, program = difference(), dict(state.program)
    assert program["relative"] > 10.0 * run.body.scene.stepping.arrest_tolerance
    avalanche._refuse_stagnation(books, np.zeros_like(state.u), program["relative"])
    assert state.program["relative"] <= run.body.scene.stepping.arrest_tolerance
    assert state.program["released"] > program["released"]
    assert difference() == pytest.approx(before, abs=1e-12 * abs(books.stored()) + 1e-12 * abs(before))


@pytest.mark.slow
def test_what_a_load_tears_off_swings_until_it_rests():
    """A load on the middle, one end held: relaxation along tangents stagnated with 2,760 bonds broken, at row 111."""
    loads = (BodyForce(kind="body_force", region="middle", density=(0.18905338, -1.56824532, -0.41306354)),)
    run = followed(strip(kinematics="finite", loads=loads, supports=GUIDED[:1]), 130)
    assert len(run.rows) == 130
    assert all(np.isfinite(row.stored) for row in run.rows)


# --- going on


@pytest.mark.parametrize(
    "options",
    [{}, {"loads": DEAD, "supports": ()}, {"control": "energy"}, {"loads": CHIP}, {"poissons_ratio": 0.4}],
    ids=["pulled", "dead", "energy", "chip", "another ratio"],
)
def test_a_program_goes_on_from_its_state(options):
    """A program taken up again from its state gives the rows of one that went through."""
    make = chipped if options.get("loads") is CHIP else strip
    scene = make(**options, report_every=1)
    through = followed(scene, 9)
    parts = failing(scene)
    for n in (3, 1, 5):
        list(parts.follow(n))
    assert [numbers(row) for row in parts.rows] == [numbers(row) for row in through.rows]


@pytest.mark.nojit
def test_tiny_strip():
    """A few bonds of a strip of eight cells."""
    run = followed(strip(**TINY, report_every=1), 2)
    assert [row.event for row in run.rows] == ["critical", "batch"]
    assert run.rows[1].broken > 0
    assert max(abs(row.ledger_error) for row in run.rows) <= CLOSED


def test_defaults_are_those_of_the_theory():
    """eta 1e-3, eight sweeps between batches, arrests at 1e-3, the end at 5 % of the peak."""
    assert Events(kind="events").model_dump() == {
        "kind": "events", "eta": 1e-3, "inner_iterations": 8, "arrest_tolerance": 1e-3, "end_load_factor": None,
        "end_reaction": 0.05, "control": "load", "report_every": 10, "tooth_ratio": None, "times": None,
        "load_factors": None, "opening": None, "end_opening": None,
    }  # fmt: skip
