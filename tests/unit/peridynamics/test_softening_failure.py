"""Books of bonds that soften: what they carry on the way, what they spend, and finding them again."""

import numpy as np
import pytest

from pdfem_mpi.deck.opening_probe import OpeningProbe
from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.programs import Events, Ramp, Steps
from pdfem_mpi.measure.fields import gather_damage
from pdfem_mpi.model.model import with_stable_masses
from pdfem_mpi.peridynamics.critical_stretches import UNBREAKABLE
from pdfem_mpi.peridynamics.damage import Remaining
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.peridynamics.softening_failure import GONE
from support.bodies import bond_list
from support.failing import GRIPS, STRETCH, WEIGHT, failing, followed, of_bonds, strip
from support.softening import remade, soft_strip, softening_material, with_mirrors

STORED = 1e-5  # stored numbers have 24 bits, and terms of both signs
CLOSED, TANGENT_STEPS = 1e-10, 1e-4  # of the work, as in test_events
KINEMATICS = ["linear", "finite"]
TINY = {"cells": (4, 2, 1), "crack": None}
EDGE = {"crack": (-1.0, 2.1)}


def stretched(body, strain):
    """Displacements of a uniform strain along x."""
    return body.of_positions(lambda x: np.column_stack([strain * x[:, 0], 0 * x[:, 0], 0 * x[:, 0]]))


def pulled(run, strain, margin=0.0):
    """Stretch a body uniformly and let its bonds move on; how many did."""
    body = run.body
    body.state.u[:] = stretched(body, strain)
    zero = np.zeros_like(body.state.u)
    body.forces.evaluate_surely(body.state.u, zero, np.empty_like(zero), run.failure, margin)
    return run.failure.close(body.model.comm)


def test_brittle_decks_have_nothing_of_it():
    run = failing(strip())
    assert type(run.failure) is Failure and run.body.model.bonds.softened is None


@pytest.mark.parametrize("kinematics", KINEMATICS)
@pytest.mark.parametrize("softening", ["drop", "line"])
def test_energies_of_a_body_follow_the_teeth(softening, kinematics):
    """Bond by bond: each has the stiffness of the last tooth that its stretch ever passed, and spent what is before."""
    run = failing(soft_strip(material=softening_material(softening=softening), kinematics=kinematics, **TINY))
    body, failure, laws = run.body, run.failure, run.failure.softened.laws
    x, i, j, k = bond_list(body)
    xi = x[j] - x[i]
    r2 = (xi**2).sum(axis=1)
    unit = k * r2 if kinematics == "finite" else 0.5 * k * r2**2
    may = failure.stretch[failure.class_of[i // 4], failure.class_of[j // 4]] < UNBREAKABLE
    most = np.zeros(len(i))
    for strain in (0.5, 1.03, 1.7, 4.1, 3.0, 9.3):  # no bond at a limit
        pulled(run, strain * STRETCH)
        along = strain * STRETCH * xi[:, 0] * xi[:, 0]
        square = (2.0 * along + (strain * STRETCH * xi[:, 0]) ** 2) / r2
        s = np.sqrt(1.0 + square) - 1.0 if kinematics == "finite" else along / r2
        most = np.maximum(most, s)
        tooth = np.where(may, np.searchsorted(laws.limit[0], most), 0)
        expected = (unit * s**2 * laws.stiffness[0, tooth]).sum()
        assert body.forces.stored_energy(body.state.u) == pytest.approx(expected, rel=STORED)
        assert failure.dissipated == pytest.approx((unit * laws.spent[0, tooth]).sum(), rel=STORED)
        gone = tooth == laws.teeth[0]
        assert (failure.count, failure.soft) == (np.count_nonzero(gone), np.count_nonzero((tooth > 0) & ~gone))
        assert failure.left == len(failure.broken_pairs()) == np.count_nonzero(tooth)
        area = (unit * laws.spent[0, -1])[gone].sum() / laws.fracture_energy[0]
        assert failure.area == pytest.approx(area, rel=STORED)
    assert failure.count > 50 and failure.soft > 50


@pytest.mark.parametrize("kinematics", KINEMATICS)
def test_what_is_released_beyond_a_limit_is_told_apart(kinematics):
    """D and the excess together are what the stored energy falls by at the same displacements, for any overshoot."""
    for strain in (1.05, 2.0, 20.0):
        run = failing(soft_strip(kinematics=kinematics, **TINY))
        body = run.body
        body.internal(stretched(body, strain * STRETCH))
        before = body.forces.stored_energy(body.state.u)
        moved = pulled(run, strain * STRETCH)
        after = body.forces.stored_energy(body.state.u)
        excess = run.failure.take_excess()
        assert moved > 0 and excess > 0.0
        assert run.failure.dissipated + excess == pytest.approx(before - after, rel=1e-6)
        assert run.failure.take_excess() == 0.0


@pytest.mark.parametrize("kinematics", KINEMATICS)
def test_margin_lets_bonds_go_early(kinematics):
    """Within the margin of a limit they go on, are booked at the limit all the same, and the excess is below 0."""
    run = failing(soft_strip(kinematics=kinematics, **TINY))
    assert pulled(run, 0.995 * STRETCH) == 0
    assert pulled(run, 0.995 * STRETCH, margin=0.01) > 0
    assert run.failure.take_excess() < 0.0


@pytest.mark.parametrize("kinematics", KINEMATICS)
def test_restored_bonds_give_the_same_state(kinematics):
    """Teeth, list, books, preconditioner and forces, in every bit; in any order; what is no bond of it is a mistake."""
    scene = soft_strip(2.0, kinematics=kinematics, control="energy", **EDGE)
    run = followed(scene, 8)
    again = failing(scene)
    broken = run.failure.broken_pairs()
    laws = run.failure.softened.laws
    assert run.failure.soft > 10 and (broken[:, 2] == laws.teeth[0]).sum() == run.failure.count > 0
    order = np.random.default_rng(1).permutation(len(broken))
    again.failure.restore(*of_bonds(again.body.model), broken[order], run.failure.dissipated_digits)
    again.solve.update_after_breaks(again.failure.take())
    for name in ("count", "soft", "left", "dissipated", "area"):
        assert getattr(again.failure, name) == getattr(run.failure, name), name
    assert (again.failure.extent == run.failure.extent).all()
    for each in (run, again):  # the quanta of the sums rest on them
        each.body.state.bounds.bond, each.body.state.bounds.element = 2.0**-8, 2.0**-3
    assert (again.body.internal(run.body.state.u) == run.body.internal(run.body.state.u)).all()
    assert again.body.forces.stored_energy(run.body.state.u) == run.body.forces.stored_energy(run.body.state.u)
    blocks = [each.solve.preconditioner.of_points.sums for each in (run, again)]
    assert (blocks[0] == blocks[1]).all()
    assert run.ratio() == again.body.forces.largest_ratio(again.failure)
    with pytest.raises(ValueError, match="are bonds of this scene"):
        fresh = failing(scene)
        fresh.failure.restore(*of_bonds(fresh.body.model), np.array([[0, 10**6, 1]]), run.failure.dissipated_digits)


def test_bonds_of_a_brittle_run_are_gone():
    """A checkpoint of pairs alone, of before bonds softened: their tooth is beyond all."""
    run = failing(soft_strip(**TINY))
    _, i, j, _ = bond_list(run.body)
    pairs = np.column_stack([i, j])
    ids = np.sort(8 * run.body.model.points.cell_number[pairs // 8] + pairs % 8, axis=1)
    broken = np.column_stack([ids[:20], np.full(20, GONE)])
    run.failure.restore(*of_bonds(run.body.model), broken, run.failure.dissipated_digits)
    assert (run.failure.count, run.failure.soft) == (20, 0)


def test_masses_and_parts_know_of_softened_bonds():
    """The stiffness that masses bound is that of the intact bonds; points that hang by softened bonds hang together."""
    run = failing(soft_strip(**TINY))
    body = run.body
    before = with_stable_masses(body.model).mass
    stored = [rows.data.copy() for rows in body.model.bonds.rows]
    pulled(run, 2.0 * STRETCH)
    left = [rows.data.copy() for rows in body.model.bonds.rows]
    assert run.failure.soft > 100 and any((a != b).any() for a, b in zip(stored, left, strict=True))
    assert (with_stable_masses(body.model).mass == before).all()
    assert all((rows.data == data).all() for rows, data in zip(body.model.bonds.rows, left, strict=True))
    n = 4 * body.model.points.n_clusters
    parent, bonded = np.arange(n), np.zeros(n, np.int64)
    for rows in body.model.bonds.rows:
        rows.data[:] = 0.0
    body.model.bonds.join(parent, bonded)
    pairs = run.failure.softened.pairs[: run.failure.softened.n]
    assert set(np.flatnonzero(bonded)) == set(pairs.reshape(-1).tolist())


def test_softened_bonds_cross_mirror_planes_as_before():
    """What holds a part to its image holds it while its bonds are soft."""
    run = failing(with_mirrors(soft_strip(**TINY), ("z-", "y-")))
    bonds, points = run.body.model.bonds, run.body.model.points
    before = bonds.planes_crossed(points)
    pulled(run, 4.0 * STRETCH)
    images = run.failure.softened.pairs[: run.failure.softened.n, 1] // 8 >= points.n_owned
    assert images.any() and run.failure.count == 0
    assert (bonds.planes_crossed(points) == before).all()


def test_local_damage_counts_what_is_left_of_the_stiffness():
    """Eq. (5) with the share of the stiffness in the place of 0 and 1; from row to row as at once; its two parts."""
    scene = soft_strip(2.0, control="energy", **EDGE).model_copy(update={"output": Output(damage=True)})
    run = failing(scene)
    body, remaining = run.body, Remaining()
    for _ in run.follow(8):
        damage = gather_damage(body.share, body.model, remaining, run.failure, parts=True)
    assert (damage[:, 0] == gather_damage(body.share, body.model)).all()
    model, softened = body.model, run.failure.softened
    x, i, j, _ = bond_list(body)
    volume = model.points.volume
    left, soft = np.zeros(len(volume)), np.zeros(len(volume))
    for ends, share in (((i, j), np.ones(len(i))), (softened.pairs[: softened.n].T, softened.share)):
        a, b = ends
        weight = np.exp(-((x[a] - x[b]) ** 2).sum(axis=1))
        for one, other in ((a, b), (b, a)):
            np.add.at(left, one, share * weight * volume[other])
            if len(share) == softened.n:
                np.add.at(soft, one, weight * volume[other])
    unit = 2.0 ** (np.frexp(volume.max())[1] - 40)
    intact = model.intact_weights.reshape(-1) * unit
    damage = damage.reshape(-1, 8, 3)[body.share.own_point_rows].reshape(-1, 3)
    np.testing.assert_allclose(damage[:, 0], 1.0 - left / intact, atol=1e-6)
    np.testing.assert_allclose(damage[:, 1], soft / intact, atol=1e-6)
    assert (damage[:, 0] <= damage[:, 1:].sum(axis=1) + 1e-12).all() and damage[:, 1].max() > 0.01


# --- load programs


@pytest.mark.parametrize("kinematics", KINEMATICS)
@pytest.mark.parametrize("control", ["load", "energy"])
def test_ledger_closes(kinematics, control):
    """W = U + D + X at every row, D at the limits; finite kinematics to what the steps along tangents leave."""
    run = followed(soft_strip(kinematics=kinematics, control=control, **EDGE), 6)
    assert max(abs(row.ledger_error) for row in run.rows) <= (CLOSED if kinematics == "linear" else TANGENT_STEPS)
    assert run.rows[-1].softened > 0


def test_the_first_limit_is_met_exactly():
    """The first critical state is that of a brittle strip with the same stretch."""
    brittle = soft_strip(material=strip().material)
    first, expected = followed(soft_strip(), 1).rows[0], followed(brittle, 1).rows[0]
    assert first.load_factor == pytest.approx(expected.load_factor, rel=1e-12)
    assert first.reaction == pytest.approx(expected.reaction, rel=1e-12)


def test_short_avalanches_have_no_row_of_their_arrest():
    """Such a run meets the critical states of one that tells all, with fewer sweeps."""
    all_told, few = (followed(soft_strip(report_every=every, end_reaction=0.85, **EDGE)) for every in (1, 10**6))
    states = [[row.reaction for row in run.rows if row.event == "critical"] for run in (all_told, few)]
    np.testing.assert_allclose(*states, rtol=1e-9)
    assert "arrest" in {row.event for row in all_told.rows} - {row.event for row in few.rows}
    assert few.body.state.program["sweeps"] < 0.8 * all_told.body.state.program["sweeps"]


def test_a_step_ends_where_no_bond_goes_on():
    """At a held displacement bonds go on until each is below its limit."""
    run = followed(soft_strip(stepping=Steps(load_factors=(0.4, 0.6)), **EDGE))
    assert run.failure.soft > 0 and run.ratio() < 1.0
    assert [row.event for row in run.rows] == ["step", "step"]


def test_a_ramp_softens_in_its_sweeps():
    ramp = Ramp(kind="ramp", increment=2e-3, report_every=50, end_load_factor=0.6)
    run = followed(soft_strip(stepping=ramp, solver="adr", tolerance=1e-6, **EDGE))
    assert run.failure.soft > 0
    assert run.rows[-1].dissipated > 0.0


def test_unloading_goes_along_the_secant():
    """Half the displacements, half the forces, and nothing goes on."""
    run = followed(soft_strip(**EDGE), 8)
    body = run.body
    force = body.internal(body.state.u)
    assert run.failure.soft > 0
    np.testing.assert_allclose(body.internal(0.5 * body.state.u), 0.5 * force, rtol=0, atol=1e-12 * np.abs(force).max())


def test_brittle_bonds_beside_them_go_at_once():
    """Two materials: bonds of the brittle one have a law of one tooth, and are booked with the energy of its limit."""
    scene = soft_strip(**TINY)
    glass = strip().material
    regions = tuple(region.model_copy(update={"material": "glass"}) for region in scene.regions)
    scene = scene.model_copy(update={"materials": {"glass": glass}, "regions": regions})
    run = failing(scene)
    assert pulled(run, 1.5 * STRETCH) == run.failure.count > 0
    assert run.failure.soft == 0


@pytest.mark.parametrize("nu", [0.25, 0.39])
@pytest.mark.parametrize("control", ["load", "energy"])
def test_a_constant_load_beside_one_that_grows(control, nu):
    """The load of each next limit is found beside the constant one, and the ledger counts its work."""
    still = followed(soft_strip(supports=GRIPS, control=control, poissons_ratio=nu, **EDGE), 1).rows[0]
    run = followed(soft_strip(loads=(WEIGHT,), supports=GRIPS, control=control, poissons_ratio=nu, **EDGE), 6)
    assert run.rows[0].load_factor != pytest.approx(still.load_factor, rel=1e-3)
    assert run.rows[-1].softened > 0
    assert max(abs(row.ledger_error) for row in run.rows) <= CLOSED


def test_opening_control_follows_softening_bonds():
    """The mouth of an edge crack opens from state to state; the ledger closes."""
    mouth = OpeningProbe(kind="opening", name="mouth", one=(3.5, 0.0, 0.5), two=(4.5, 0.0, 0.5))
    events = Events(kind="events", control="opening", opening="mouth", eta=1e-2, inner_iterations=4, report_every=20)
    run = followed(remade(soft_strip(2.0, **EDGE), probes=(mouth,), stepping=events), 4)
    assert run.rows[-1].softened > 0 and run.body.state.program["opening"] > 0.0
    assert max(abs(row.ledger_error) for row in run.rows) <= CLOSED


@pytest.mark.parametrize("ratio", [1.3, 3.0])
def test_without_a_drop_bonds_go_on_at_their_first_tooth(ratio):
    """And not where the branch begins, which is below: they would then be booked with more than they release."""
    run = followed(soft_strip(material=softening_material(ratio, softening="line"), **EDGE, report_every=1), 12)
    laws, stretches = run.failure.softened.laws, run.failure.stretch
    assert set(stretches[stretches < UNBREAKABLE]) == {laws.limit[0, 0]}
    assert run.rows[-1].softened + run.rows[-1].broken > 0
    assert max(abs(row.ledger_error) for row in run.rows) <= CLOSED
    released = [row.released for row in run.rows]
    assert released == sorted(released) and released[0] >= 0.0
