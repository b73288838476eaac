"""What a simulation shows between its steps: single bonds, forces and cells agree with each other."""

import numpy as np
import pytest

import pdfem_mpi as pdfem
from pdfem_mpi.parallel.comm import mpi

#: Of the largest value: strengths are stored in single precision, sums have some hundred terms.
STORED, ROUND_OFF = 1e-6, 1e-12
STRAIN = np.array([[3e-4, 1e-4, 0.0], [1e-4, -2e-4, 5e-5], [0.0, 5e-5, 1e-4]])
#: A coupled bar in inches and pounds, away from the origin: 4 cells of elements, 4 of bonds.
BAR = {
    "mesh": {"kind": "box", "lower": [2.0, 1.0, 0.0], "upper": [2.8, 1.3, 0.2], "spacing": 0.1},
    "material": {"youngs_modulus": 1.0e7, "critical_stretch": 2e-3},
    "regions": [
        {"name": "left", "model": "finite_elements", "upper": [2.4, 9.0, 9.0]},
        {"name": "right", "model": "peridynamics", "lower": [2.4, 0.0, -1.0]},
    ],
    "supports": [{"face": "x-", "x": 0.0, "y": 0.0, "z": 0.0}, {"face": "x+", "x": 1e-3}],
    "peridynamics": {"kinematics": "linear"},
    "solver": {"kind": "cg"},
}


def bar(**changes):
    return pdfem.Simulation(pdfem.read_deck(BAR | changes), mpi().COMM_SELF)


def alone(kinematics="linear", **changes):
    """The bar of bonds alone."""
    regions = [{"name": "all", "model": "peridynamics"}]
    return bar(regions=regions, peridynamics={"kinematics": kinematics}, **changes)


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_listed_bonds_hold_the_stored_energy(kinematics):
    """Stretched by a uniform strain: ``sum stiffness s^2 / 2``, each bond once."""
    simulation = alone(kinematics)
    simulation.displace(lambda x: x @ STRAIN)
    bonds = simulation.bonds()
    assert len(bonds.points) == simulation.model.bonds.count == len(np.unique(bonds.points, axis=0))
    assert (bonds.points[:, 0] < bonds.points[:, 1]).all()
    x = simulation.points
    np.testing.assert_allclose(bonds.start, x[bonds.points[:, 0]], rtol=ROUND_OFF)
    np.testing.assert_allclose(bonds.vector, np.diff(x[bonds.points], axis=1)[:, 0], rtol=0, atol=ROUND_OFF)
    moved = bonds.vector @ (np.eye(3) + STRAIN)
    exact = np.sqrt((moved**2).sum(axis=1)) / bonds.length - 1.0
    if kinematics == "linear":
        exact = ((bonds.vector @ STRAIN) * bonds.vector).sum(axis=1) / bonds.length**2
    np.testing.assert_allclose(bonds.stretch, exact, rtol=0, atol=ROUND_OFF)
    energy = simulation.forces.stored_energy(simulation.state.u)
    energy *= simulation.share.units.force * simulation.share.units.length
    assert 0.5 * (bonds.stiffness * bonds.stretch**2).sum() == pytest.approx(energy, rel=STORED)


def test_internal_forces_are_those_of_the_listed_bonds():
    """Along each bond ``stiffness s / r``, on its two points with opposite signs; some displacements at random."""
    simulation = alone()
    displacements = np.random.default_rng(5).uniform(-1e-4, 1e-4, simulation.points.shape)
    simulation.displace(lambda x: displacements[_order(x, simulation.points)])
    np.testing.assert_allclose(simulation.fields().u_points, displacements, rtol=0, atol=1e-15)
    bonds, forces = simulation.bonds(), simulation.internal_forces()
    pull = (bonds.stiffness * bonds.stretch / bonds.length**2)[:, None] * bonds.vector
    expected = np.zeros_like(displacements)
    np.add.at(expected, bonds.points[:, 0], -pull)
    np.add.at(expected, bonds.points[:, 1], pull)
    np.testing.assert_allclose(forces.points, expected, rtol=0, atol=STORED * np.abs(expected).max())
    assert forces.nodes is None


def _order(x, places):
    """Row of each position among all places."""
    distance = np.abs(x[:, None] - places[None]).max(axis=2)
    assert distance.min(axis=1).max() < 1e-9
    return distance.argmin(axis=1)


def test_in_equilibrium_the_free_points_carry_nothing_and_supports_the_reaction():
    simulation = bar()
    row = simulation.solve(1.0)
    forces, x = simulation.internal_forces(), simulation.nodes[:, 0]
    # the support on the left pulls against x
    assert forces.nodes[x < 2.05].sum(axis=0)[0] == pytest.approx(-row["reaction"], rel=1e-5)
    assert np.abs(forces.nodes[(x > 2.05)]).max() < 1e-5 * row["reaction"]
    cells = simulation.cells
    assert cells.model.tolist().count("overlap") == 6
    assert set(cells.region[cells.model == "peridynamics"]) == {"right"}
    own = simulation.points.reshape(-1, 8, 3).mean(axis=1)
    np.testing.assert_allclose(own, cells.centroids[cells.has_points], rtol=ROUND_OFF)


def test_broken_bonds_are_those_that_are_no_longer_listed():
    """A state beyond the critical stretch breaks; ids agree with the list before."""
    simulation = alone(supports=[{"face": "x-", "x": 0.0, "y": 0.0, "z": 0.0}, {"face": "x+", "x": 2e-3}],
                       stepping={"kind": "events"})  # fmt: skip
    before = {tuple(pair) for pair in simulation.bonds().points.tolist()}
    assert not len(simulation.broken_bonds())
    for row in simulation.steps():
        if row["broken_bonds"]:
            break
    after = {tuple(pair) for pair in simulation.bonds().points.tolist()}
    broken = {tuple(pair) for pair in simulation.broken_bonds().tolist()}
    assert broken and broken == before - after


def test_what_has_no_bonds_lists_none():
    elements = {"regions": [{"name": "all", "model": "finite_elements"}], "material": {"youngs_modulus": 1.0e7}}
    simulation = bar(**elements, peridynamics={})
    assert simulation.bonds() is None and not len(simulation.broken_bonds())
    assert simulation.internal_forces().points is None


#: A plate in the middle of which bonds may break, pulled from break to break.
PLATE = {
    "mesh": {"kind": "box", "lower": [0.0, 0.0, 0.0], "upper": [8.0, 3.0, 1.0], "spacing": 1.0},
    "material": {"youngs_modulus": 1000.0, "critical_stretch": 0.002},
    "regions": [
        {"name": "left", "model": "peridynamics", "upper": [2.0, 9.0, 9.0], "may_fail": False},
        {"name": "middle", "model": "peridynamics", "lower": [2.0, 0.0, 0.0], "upper": [6.0, 9.0, 9.0]},
        {"name": "right", "model": "peridynamics", "lower": [6.0, 0.0, 0.0], "may_fail": False},
    ],
    "peridynamics": {"kinematics": "linear"},
    "supports": [{"face": "x-", "x": -0.01, "y": 0.0, "z": 0.0}, {"face": "x+", "x": 0.01, "y": 0.0}],
    "solver": {"kind": "cg", "tolerance": 1e-9},
    "stepping": {"kind": "events", "end_reaction": 0.5},
}


def broken_by(weights=None):
    """Rows of the plate, and its broken bonds; with weights of its bonds, if ``weights(bonds)`` gives any."""
    simulation = pdfem.Simulation(pdfem.read_deck(PLATE), mpi().COMM_SELF)
    if weights:
        simulation.weigh_stretches(*weights(simulation.bonds()))
    rows = list(simulation.steps())
    return rows, set(map(tuple, simulation.broken_bonds().tolist()))


def test_weights_of_1_break_what_the_program_breaks():
    """The books and the energies too, to round-off of the stretches."""
    rows, broken = broken_by()
    same, same_broken = broken_by(lambda bonds: (np.ones(len(bonds.points)),) * 2)
    assert broken == same_broken and len(rows) == len(same) > 1
    for name in ("reaction", "dissipated_energy", "load_factor"):
        np.testing.assert_allclose([row[name] for row in same], [row[name] for row in rows], rtol=1e-9)


def test_weights_say_what_sets_the_load_and_what_breaks():
    """Twice the weight in both: half of the load. None for the load of all but one: nothing breaks before it does."""
    (first, *_), _ = broken_by()
    (half, *_), _ = broken_by(lambda bonds: (np.full(len(bonds.points), 2.0),) * 2)
    assert half["load_factor"] == pytest.approx(0.5 * first["load_factor"], rel=1e-9)

    def long_alone(bonds):
        return (bonds.length > 2.0).astype(float), np.ones(len(bonds.points))

    (later, *_), _ = broken_by(long_alone)
    assert later["load_factor"] > first["load_factor"]


def test_weights_that_do_not_fit_are_refused():
    simulation = pdfem.Simulation(pdfem.read_deck(PLATE), mpi().COMM_SELF)
    with pytest.raises(ValueError, match="bonds: give as many weights"):
        simulation.weigh_stretches(np.ones(3), np.ones(3))
    with pytest.raises(ValueError, match="weights are for brittle bonds"):
        bar(material={"youngs_modulus": 1.0e7}).weigh_stretches(np.ones(3), np.ones(3))
    ones = np.ones(len(simulation.bonds().points))
    list(simulation.steps())
    with pytest.raises(ValueError, match="and are whole"):
        simulation.weigh_stretches(ones, ones)
    ramp = {"stepping": {"kind": "ramp", "increment": 1e-3}, "solver": {"kind": "adr"}}
    with pytest.raises(ValueError, match="ramps break bonds in their sweep"):
        pdfem.Simulation(pdfem.read_deck(PLATE | ramp), mpi().COMM_SELF).weigh_stretches(ones, ones)
