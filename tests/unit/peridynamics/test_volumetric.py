"""Bonds with a volumetric part against a dense evaluation; their tangent and masses; and nothing of it at 1/4."""

import numpy as np
import pytest

from pdfem_mpi.deck.materials import Interface, Material
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.peridynamics.bond_forces import BondForces
from pdfem_mpi.peridynamics.volumetric import Moment, describe_moments, refuse_unstable
from pdfem_mpi.peridynamics.volumetric_forces import VolumetricForces
from pdfem_mpi.runs.array_bytes import Count
from support.bodies import YOUNGS_MODULUS, box_regions, build, make_scene
from support.dense_reference import DenseBody

#: Stored numbers of bonds are float32, 2**-24 each, and a point's force is the small difference of large ones.
SINGLE = 1e-7
#: Central differences of forces whose own rounding is 1e-15 of the largest.
DIFFERENCES = 1e-6
#: What round-off leaves of the symmetry of a tangent, of its largest product.
SYMMETRY = 1e-12
#: Power iterations find an eigenvalue from below: no tolerance upwards.
LARGEST_EIGENVALUE = 4.0
RATIOS = (0.0, 0.1, 0.33, 0.45, 0.49)


def body_of(nu, kinematics="linear", cells=(5, 2, 2), n_elements=3, **options):
    options.setdefault("correction", "virial")
    scene = make_scene(cells, n_elements, kinematics=kinematics, poissons_ratio=nu, **options)
    return build(scene, loaded=False)


def displaced(body, size, seed=0):
    u = size * np.random.default_rng(seed).uniform(-1.0, 1.0, body.model.n_unknowns)
    u[body.model.rollers] = 0.0
    return u


def compare(body, u):
    """Largest difference of the internal forces from those of the dense body, and of the energy, both relative."""
    model, dense = body.model, DenseBody(body.scene)
    force = body.internal(u)
    energy = body.forces.stored_energy(u) * model.units.force * model.units.length

    def places(vector):
        fields = body.fields(vector)
        return dense.places_of(fields.u_points, fields.u_nodes) / model.units.length

    expected, _, stored = dense.internal(places(u) * model.units.length)
    if len(model.rollers):
        expected[dense.n_own :][dense._on_planes(np.flatnonzero(dense.d.node_row >= 0))] = 0.0
    difference = places(force) - expected / model.units.force
    return np.abs(difference).max() / np.abs(expected / model.units.force).max(), abs(energy / stored - 1.0)


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
@pytest.mark.parametrize("nu", RATIOS)
def test_forces_and_energy_are_those_of_a_dense_body(nu, kinematics):
    body = body_of(nu, kinematics)
    for size in (1e-2, 1e-5):  # finite kinematics: closed form, then the series
        assert max(compare(body, displaced(body, size))) < SINGLE
    kinds = {"linear, volumetric"} if kinematics == "linear" else {
        "finite, closed form, volumetric", "finite, series, volumetric"}  # fmt: skip
    assert body.forces.swept == kinds


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_bonds_across_mirror_planes(kinematics):
    body = body_of(0.4, kinematics, symmetry=("y-", "z+"))
    assert max(compare(body, displaced(body, 1e-3))) < SINGLE


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_bonds_between_materials(kinematics):
    """The softer is the one of smaller shear modulus; an interface of its own has the softer's ratio."""
    other = {"other": Material(youngs_modulus=1.3 * YOUNGS_MODULUS, poissons_ratio=0.4)}  # softer in shear than 0.0
    regions = [region.model_copy() for region in box_regions((4, 2, 2), 0)]
    first = regions[0].model_copy(update={"lower": (0.0, 0.0, 0.0), "upper": (2.0, 2.0, 2.0)})
    second = regions[0].model_copy(
        update={"name": "second", "lower": (2.0, 0.0, 0.0), "upper": (4.0, 2.0, 2.0), "material": "other"}
    )
    for interfaces in ((), (Interface(between=("default", "other"), youngs_modulus=0.7 * YOUNGS_MODULUS),)):
        body = body_of(
            0.0, kinematics, (4, 2, 2), 0, regions=(first, second), materials=other, interfaces=interfaces,
        )  # fmt: skip
        assert max(compare(body, displaced(body, 1e-3))) < SINGLE


@pytest.mark.parametrize("size", [0.0, 1e-3, 5e-2])
@pytest.mark.parametrize("nu", [0.1, 0.33, 0.45])
def test_the_tangent_is_the_derivative_of_the_forces(nu, size):
    body = body_of(nu, "finite")
    u, v, w = (displaced(body, s, seed) for seed, s in enumerate((size, 1.0, 1.0)))
    nothing, change, other = np.zeros_like(u), np.empty_like(u), np.empty_like(u)
    body.internal(u)
    tangent = Forces(body.model, tangent=True)
    tangent.linearise(u, body.forces.bounds.bond if size else 0.0)
    tangent.evaluate_surely(v, nothing, change)
    tangent.evaluate_surely(w, nothing, other)
    assert abs(np.dot(w, change) - np.dot(v, other)) < SYMMETRY * np.linalg.norm(v) * np.linalg.norm(change)
    h = 1e-6
    difference = (body.internal(u + h * v) - body.internal(u - h * v)) / (2.0 * h)
    assert np.abs(difference - change).max() < DIFFERENCES * np.abs(change).max()


@pytest.mark.parametrize("nu", [0.0, 0.33, 0.45])
@pytest.mark.parametrize("cells", [(4, 1, 1), (3, 3, 3)])
def test_masses_bound_the_stiffness(nu, cells):
    body = body_of(nu, cells=cells, n_elements=0, solver="adr")
    mass, v = body.model.mass, displaced(body, 1.0)
    for _ in range(60):
        v = -body.internal(v) / mass
        growth = np.abs(v).max()
        v /= growth
    assert growth < LARGEST_EIGENVALUE


def test_fitted_weights_in_the_tangent():
    """The derivative of forces that weigh their bonds, in finite kinematics, and of the energy."""
    body = body_of(0.4, "finite", (4, 2, 2), 0, correction="fitted")
    assert body.model.bonds.volumetric.is_weighted
    for size in (1e-3, 5e-2):
        u, v = displaced(body, size), displaced(body, 1.0, 1)
        change, h = np.empty_like(u), 1e-6
        body.internal(u)
        tangent = Forces(body.model, tangent=True)
        tangent.linearise(u, body.forces.bounds.bond)
        tangent.evaluate_surely(v, np.zeros_like(u), change)
        difference = (body.internal(u + h * v) - body.internal(u - h * v)) / (2.0 * h)
        assert np.abs(difference - change).max() < DIFFERENCES * np.abs(change).max()
        energies = []
        for step in (h, -h):
            body.internal(u + step * v)
            energies.append(body.forces.stored_energy(u + step * v))
        work = body.internal(u) @ v
        assert abs((energies[0] - energies[1]) / (2.0 * h) + work) < DIFFERENCES * abs(work)


def test_a_ratio_of_a_quarter_has_nothing_of_it():
    plain, other = body_of(0.25), body_of(0.26)
    assert plain.model.bonds.volumetric is None and plain.model.moments == ()
    assert type(plain.forces.of_bonds) is BondForces
    assert type(other.forces.of_bonds) is VolumetricForces
    points = other.model.points.n_clusters * 4
    more = Count().bytes_of(other.model, other.forces) - Count().bytes_of(plain.model, plain.forces)
    assert 0 < more <= 16 * points


def test_what_lies_outside_of_the_stable_range_is_refused():
    stable, not_stable = Moment("default", 0.1, 1.3, 2.2222), Moment("weak", 0.0, 1.8, 1.6667)
    refuse_unstable((stable,))
    with pytest.raises(SceneError) as found:
        refuse_unstable((stable, not_stable))
    (message,) = found.value.messages
    assert message.startswith("materials.weak.poissons_ratio = 0 is too low for these bonds")
    assert "1.8" in message and "1.67" in message
    assert describe_moments((stable, Moment("b", 0.3, 1.1, np.inf))) == [
        "material.poissons_ratio = 0.1: bonds and a volumetric part; largest moment of a point 1.3, stable below 2.22",
        "materials.b.poissons_ratio = 0.3: bonds and a volumetric part; largest moment of a point 1.1, stable whatever "
        "it is",
    ]
    warning = describe_moments((Moment("default", 0.49, 1.1, np.inf),))[1]
    assert warning.startswith("warning: material.poissons_ratio = 0.49 is above 0.45: solves take several times as")


def test_the_bulk_has_a_moment_of_one():
    body = body_of(0.1, cells=(7, 7, 7), n_elements=0, correction="none")
    (moment,) = body.model.moments
    assert moment.largest == pytest.approx(0.986, abs=0.01)  # what a cutoff of 2.5 leaves, on the Gauss lattice
    assert moment.limit == pytest.approx(20.0 / 9.0)
