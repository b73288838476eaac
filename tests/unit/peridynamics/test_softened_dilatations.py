"""Bonds that soften at Poisson's ratios other than 1/4: one energy, its derivatives, what it releases, its books."""

import numpy as np
import pytest

from pdfem_mpi.deck.materials import Interface, Material
from pdfem_mpi.deck.programs import Ramp, Steps
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.peridynamics.virial import bond_stresses
from support.bodies import YOUNGS_MODULUS, bond_list
from support.failing import STRETCH, failing, followed, of_bonds
from support.softening import remade, soft_strip, softening_material

STORED = 2e-6  # of an energy: stored numbers have 24 bits
CLOSED, TANGENT_STEPS = 1e-10, 1e-4  # of the work, as in test_events
DIFFERENCES = 1e-6  # central, of forces whose own rounding is 1e-15 of the largest
KINEMATICS = ["linear", "finite"]
RATIOS = [0.1, 0.39]
TINY = {"cells": (4, 2, 1), "crack": None}
EDGE = {"crack": (-1.0, 2.1)}


def softened(nu, kinematics, strain=3.0):
    """A strip after a uniform stretch that softened some of its bonds, and random displacements of it."""
    run = failing(soft_strip(kinematics=kinematics, poissons_ratio=nu, **TINY))
    body = run.body
    u = body.of_positions(lambda x: np.column_stack([strain * STRETCH * x[:, 0], 0 * x[:, 0], 0 * x[:, 0]]))
    zero = np.zeros_like(u)
    body.forces.evaluate_surely(u, zero, np.empty_like(u), run.failure, 0.0)
    run.failure.close(body.model.comm)
    assert run.failure.soft > 100
    return run, u + 1e-3 * np.random.default_rng(2).uniform(-1.0, 1.0, len(u))


def energy_of(body, nu, listed, share, u):
    """``1/2 sum phi k e^2 / r + 1/2 M sum w theta^2`` with ``w theta = sum phi k e / (10 mu)``; Young's modulus 1."""
    x, i, j, stored = listed
    mu = 0.5 / (1.0 + nu)
    lacks = mu * (4.0 * nu - 1.0) / (1.0 - 2.0 * nu)
    body.internal(u)
    at = np.zeros_like(x)
    at[: 8 * body.model.points.n_owned] = body.forces.point_displacements()
    xi = x[j] - x[i]
    eta = at[j] - at[i]
    r = np.sqrt((xi**2).sum(axis=1))
    if body.scene.peridynamics.kinematics == "finite":
        extension, k = np.sqrt(((xi + eta) ** 2).sum(axis=1)) - r, 2.0 * stored * r  # energy stored * e^2
    else:
        extension, k = (eta * xi).sum(axis=1) / r, stored * r**3
    sums = np.zeros(len(x))
    for ends in (i, j):
        np.add.at(sums, ends, share * k * extension / (10.0 * mu))
    w = body.model.points.volume[: len(x)]
    held = w > 0.0
    bonds = 0.5 * (share * k * extension**2 / r).sum()
    return float(bonds + 0.5 * lacks * (sums[held] ** 2 / w[held]).sum())


@pytest.mark.parametrize("kinematics", KINEMATICS)
@pytest.mark.parametrize("nu", RATIOS)
def test_energy_is_one_quadratic_form(nu, kinematics):
    """A bond with a part of its stiffness has that part of its weight in the dilatations."""
    run = failing(soft_strip(kinematics=kinematics, poissons_ratio=nu, **TINY))
    listed = bond_list(run.body)
    run, u = softened(nu, kinematics)
    body, soft = run.body, run.failure.softened
    share = {tuple(pair): float(part) for pair, part in zip(soft.pairs[: soft.n].tolist(), soft.share, strict=True)}
    left = {tuple(pair) for pair in np.column_stack(bond_list(body)[1:3]).tolist()}
    pairs = np.column_stack(listed[1:3]).tolist()
    phi = np.array([1.0 if tuple(pair) in left else share.get(tuple(pair), 0.0) for pair in pairs])
    assert np.count_nonzero((phi > 0.0) & (phi < 1.0)) == soft.n
    expected = energy_of(body, nu, listed, phi, u)
    assert body.forces.stored_energy(u) == pytest.approx(expected, rel=STORED)


@pytest.mark.parametrize("kinematics", KINEMATICS)
@pytest.mark.parametrize("nu", RATIOS)
def test_forces_are_the_derivative_of_the_energy(nu, kinematics):
    run, u = softened(nu, kinematics)
    body = run.body
    v = np.random.default_rng(4).uniform(-1.0, 1.0, len(u))
    force, h, energies = body.internal(u).copy(), 1e-6, []
    for sign in (1.0, -1.0):
        body.internal(u + sign * h * v)
        energies.append(body.forces.stored_energy(u + sign * h * v))
    assert (energies[0] - energies[1]) / (2.0 * h) == pytest.approx(-np.dot(force, v), rel=1e-4)
    assert "softened, volumetric" in body.forces.swept


@pytest.mark.parametrize("size", [0.0, 1.0])
@pytest.mark.parametrize("nu", RATIOS)
def test_the_tangent_is_the_derivative_of_the_forces(nu, size):
    run, u = softened(nu, "finite")
    body, u = run.body, size * u
    v = np.random.default_rng(5).uniform(-1.0, 1.0, len(u))
    body.internal(u)
    tangent, change = Forces(body.model, tangent=True), np.empty_like(u)
    tangent.linearise(u, body.forces.bounds.bond if size else 0.0)
    tangent.evaluate_surely(v, np.zeros_like(u), change)
    h = 1e-6
    difference = (body.internal(u + h * v) - body.internal(u - h * v)) / (2.0 * h)
    assert np.abs(difference - change).max() < DIFFERENCES * np.abs(change).max()


@pytest.mark.parametrize("kinematics", KINEMATICS)
@pytest.mark.parametrize("nu", RATIOS)
def test_what_bonds_and_points_release_is_booked(nu, kinematics):
    """D and the excess together are what the stored energy falls by at the same displacements, for any overshoot."""
    for strain in (1.05, 3.0, 20.0):
        scene = soft_strip(kinematics=kinematics, poissons_ratio=nu, **TINY)
        assert released(scene, strain) == pytest.approx(1.0, rel=1e-6)


@pytest.mark.parametrize("kinematics", KINEMATICS)
@pytest.mark.parametrize("softens", [True, False])
@pytest.mark.parametrize("interface", [None, 0.5])
def test_so_it_is_of_several_shear_moduli(interface, softens, kinematics):
    """Each point's dilatation counts by its own modulus, also what it loses: two materials, of two ratios each."""
    first = Material(youngs_modulus=YOUNGS_MODULUS, poissons_ratio=0.1, critical_stretch=STRETCH)
    second = Material(youngs_modulus=7.0 * YOUNGS_MODULUS, poissons_ratio=0.39, critical_stretch=0.5 * STRETCH)
    if softens:
        first, second = softening_material(6.0, poissons_ratio=0.1), softening_material(5.0, poissons_ratio=0.39)
        stiffer = {"youngs_modulus": 3.0 * YOUNGS_MODULUS, "tensile_strength": 2.0 * YOUNGS_MODULUS * STRETCH}
        second = second.model_copy(update=stiffer | {"fracture_energy": 60.0 * second.fracture_energy})
    regions = (
        Region(name="a", model="peridynamics", upper=(2.0, 2.0, 1.0)),
        Region(name="b", model="peridynamics", lower=(2.0, 0.0, 0.0), material="other"),
    )
    scene = soft_strip(kinematics=kinematics, poissons_ratio=0.1, **TINY)
    tables = {"material": first, "materials": {"other": second}, "regions": regions}
    if interface:
        between = Interface(between=("default", "other"), youngs_modulus=interface * YOUNGS_MODULUS)
        tables["interfaces"] = (between,)
    scene = Scene.model_validate({**dict(scene), **tables})
    for strain in (1.3, 4.0):
        assert released(scene, strain) == pytest.approx(1.0, rel=1e-10)


def released(scene, strain):
    """What is booked when a stretch breaks or softens bonds, over what the stored energy falls by."""
    run = failing(scene)
    body = run.body
    u = body.of_positions(lambda x: np.column_stack([strain * STRETCH * x[:, 0], 0 * x[:, 0], 0 * x[:, 0]]))
    body.internal(u)
    before = body.forces.stored_energy(u)
    body.forces.evaluate_surely(u, np.zeros_like(u), np.empty_like(u), run.failure, 0.0)
    assert run.failure.close(body.model.comm) > 0
    body.internal(u)
    return (run.failure.dissipated + run.failure.take_excess()) / (before - body.forces.stored_energy(u))


@pytest.mark.parametrize("control", ["load", "energy"])
@pytest.mark.parametrize("nu, kinematics", [(0.2, "linear"), (0.39, "linear"), (0.39, "finite")])
def test_ledger_closes(nu, kinematics, control):
    run = followed(soft_strip(kinematics=kinematics, control=control, poissons_ratio=nu, **EDGE), 5)
    assert max(abs(row.ledger_error) for row in run.rows) <= (CLOSED if kinematics == "linear" else TANGENT_STEPS)
    assert run.rows[-1].softened > 0


def test_restored_bonds_give_the_same_state():
    """Forces, energy and books, in every bit."""
    scene = soft_strip(2.0, control="energy", poissons_ratio=0.39, **EDGE)
    run, again = followed(scene, 8), failing(scene)
    assert run.failure.soft > 10 and run.failure.count > 0
    broken = run.failure.broken_pairs()
    again.failure.restore(*of_bonds(again.body.model), broken, run.failure.dissipated_digits)
    for name in ("count", "soft", "left", "dissipated", "area"):
        assert getattr(again.failure, name) == getattr(run.failure, name), name
    for each in (run, again):  # the quanta of the sums rest on them
        each.body.state.bounds.bond, each.body.state.bounds.element = 2.0**-8, 2.0**-3
    assert (again.body.internal(run.body.state.u) == run.body.internal(run.body.state.u)).all()
    assert again.body.forces.stored_energy(run.body.state.u) == run.body.forces.stored_energy(run.body.state.u)


@pytest.mark.parametrize("kinematics", KINEMATICS)
def test_energy_densities_are_those_of_what_is_left(kinematics):
    """Over all points they come to the stored energy."""
    run, u = softened(0.39, kinematics)
    body = run.body
    body.internal(u)
    points = body.model.points
    _, density = bond_stresses(body.model.comm, body.forces.of_bonds)
    volume = points.volume[: 8 * points.n_owned].reshape(-1, 8)
    assert (density * volume).sum() == pytest.approx(body.forces.stored_energy(u), rel=STORED)


def test_steps_and_ramps_soften():
    """Teeth in the sweeps of a ramp, and at held displacements until no bond goes on."""
    ramp = Ramp(kind="ramp", increment=2e-3, report_every=50, end_load_factor=0.6)
    run = followed(soft_strip(stepping=ramp, solver="adr", tolerance=1e-6, poissons_ratio=0.39, **EDGE))
    assert run.failure.soft > 0 and run.rows[-1].dissipated > 0.0
    run = followed(soft_strip(stepping=Steps(load_factors=(0.4, 0.6)), poissons_ratio=0.39, **EDGE))
    assert run.failure.soft > 0 and run.ratio() < 1.0


def test_at_one_quarter_nothing_is_there():
    run = failing(soft_strip(**TINY))
    assert run.body.model.bonds.volumetric is None and run.failure.released_at_points is None
    assert remade(soft_strip(poissons_ratio=0.3, **TINY)).has_volumetric_part
