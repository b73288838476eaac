"""Strain, stress and energy density of elements and of bonds, against closed forms, numpy and each other."""

import numpy as np
import pytest

from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.measure.stresses import mechanics_of_bonds, mechanics_of_elements
from pdfem_mpi.measure.tensors import matrices, six_of, trace
from pdfem_mpi.peridynamics.virial import bond_stresses
from support.bodies import bond_list, build, make_scene
from support.failing import STRETCH, failing
from support.softening import soft_strip

#: Of a uniform state in elements: products of a few numbers.
ROUND_OFF = 1e-13
#: Of sums over bonds, whose terms are rounded to 2**-46 of the largest: 500 of them.
SUMS = 1e-11
#: What is left of a softened bond is a number of 24 bits here.
STORED = 1e-6
LAMBDA = MU = 0.4  # in model units, of E = 1 and nu = 1/4
GRADIENT = np.array([[1.0, 0.5, -0.25], [0.125, -0.5, 2.0], [-1.0, 0.75, 0.25]])


def law(strain):
    """Stress of an isotropic material with these strains, shape (..., 6)."""
    stress = 2.0 * MU * strain
    stress[..., :3] += LAMBDA * trace(strain)[..., None]
    return stress


def moved(scene, gradient):
    """A body with displacements ``gradient x``, evaluated."""
    body = build(scene, loaded=False)
    body.u = body.of_positions(lambda x: x @ gradient.T)
    body.internal(body.u)
    return body


def rotation(angle=0.7, axis=(1.0, 2.0, -0.5)):
    """A rotation matrix by Rodrigues' formula."""
    x, y, z = np.array(axis) / np.linalg.norm(axis)
    cross = np.array([[0.0, -z, y], [z, 0.0, -x], [-y, x, 0.0]])
    return np.eye(3) + np.sin(angle) * cross + (1.0 - np.cos(angle)) * cross @ cross


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_elements_in_a_uniform_state(kinematics):
    """Strain, stress and energy density of any gradient, at every Gauss point; overlap included."""
    gradient = 1e-2 * GRADIENT
    found = mechanics_of_elements(*parts(moved(make_scene((4, 2, 2), 2, kinematics=kinematics), gradient)))
    strain = 0.5 * (gradient + gradient.T)
    if kinematics == "finite":
        strain = strain + 0.5 * gradient.T @ gradient
    second = matrices(law(six_of(strain)))
    deformed = np.eye(3) + gradient
    cauchy = deformed @ second @ deformed.T / np.linalg.det(deformed) if kinematics == "finite" else second
    assert found.strain.shape == (8, 8, 6)
    np.testing.assert_allclose(matrices(found.strain), np.broadcast_to(strain, (8, 8, 3, 3)), rtol=0, atol=ROUND_OFF)
    np.testing.assert_allclose(matrices(found.stress), np.broadcast_to(cauchy, (8, 8, 3, 3)), rtol=0, atol=ROUND_OFF)
    np.testing.assert_allclose(found.energy_density, 0.5 * (second * strain).sum(), rtol=1e-12)


def parts(body):
    return body.share, body.forces


@pytest.mark.parametrize("correction", ["none", "virial"])
@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_stress_of_bonds_is_half_the_moment_of_their_forces(kinematics, correction):
    """Every bond in numpy: its force by eq. (2), its moment at both of its points, over twice their volumes."""
    rng = np.random.default_rng(5)
    scene = make_scene((3, 3, 2), 0, kinematics=kinematics, correction=correction)
    body = build(scene, loaded=False)
    body.u = body.of_positions(lambda x: 0.03 * rng.normal(size=x.shape))
    body.internal(body.u)
    found = mechanics_of_bonds(*parts(body))
    x, i, j, stored = bond_list(body)
    u = body.forces.point_displacements()
    xi, eta = x[j] - x[i], u[j] - u[i]
    if kinematics == "linear":
        y, force = xi, (stored * (eta * xi).sum(axis=1))[:, None] * xi
        energy = 0.5 * stored * (eta * xi).sum(axis=1) ** 2
    else:
        y, r = xi + eta, np.linalg.norm(xi, axis=1)
        s = np.linalg.norm(y, axis=1) / r - 1.0
        strength = 2.0 * stored * r  # c exp(-r^2) g w w
        force = (strength * s / np.linalg.norm(y, axis=1))[:, None] * y
        energy = 0.5 * strength * s**2 * r
    moment, stored_energy = np.zeros((len(x), 3, 3)), np.zeros(len(x))
    for end in (i, j):
        np.add.at(moment, end, 0.5 * force[:, :, None] * y[:, None, :])
        np.add.at(stored_energy, end, 0.5 * energy)
    volume = body.model.points.volume[: len(x)]
    expected = moment / volume[:, None, None]
    if kinematics == "finite":
        expected /= np.linalg.det(np.eye(3) + least_squares(x, u, i, j, volume))[:, None, None]
    scale = np.abs(expected).max()
    np.testing.assert_allclose(matrices(found.stress).reshape(-1, 3, 3), expected, rtol=0, atol=1e-6 * scale)
    np.testing.assert_allclose(found.energy_density.reshape(-1), stored_energy / volume, rtol=1e-6)
    whole = (found.energy_density * found.volume).sum()
    assert whole == pytest.approx(body.forces.stored_energy(body.u), rel=SUMS)


def least_squares(x, u, i, j, volume):
    """Displacement gradients of all points, one family after the other, by numpy's least squares."""
    gradients = np.zeros((len(x), 3, 3))
    for p in range(len(x)):
        family = np.concatenate([j[i == p], i[j == p]])
        root = np.sqrt(volume[family] * np.exp(-((x[family] - x[p]) ** 2).sum(axis=1)))[:, None]
        solution = np.linalg.lstsq(root * (x[family] - x[p]), root * (u[family] - u[p]), rcond=None)[0]
        gradients[p] = solution.T
    return gradients


def test_strain_of_points_is_that_of_least_squares():
    """Any displacements, a crack through the body: one family after the other in numpy."""
    crack = Crack(polygon=((1.5, -1.0, -1.0), (1.5, 1.6, -1.0), (1.5, 1.6, 4.0), (1.5, -1.0, 4.0)))
    body = build(make_scene((3, 3, 2), 0, cracks=(crack,)), loaded=False)
    rng = np.random.default_rng(6)
    body.internal(body.of_positions(lambda x: rng.normal(size=x.shape)))
    x, i, j, _ = bond_list(body)
    expected = least_squares(x, body.forces.point_displacements(), i, j, body.model.points.volume)
    found = matrices(mechanics_of_bonds(*parts(body)).strain).reshape(-1, 3, 3)
    expected = 0.5 * (expected + expected.swapaxes(1, 2))
    np.testing.assert_allclose(found, expected, rtol=0, atol=SUMS * np.abs(expected).max())


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_strain_of_points_is_exact_in_a_uniform_state(kinematics):
    """Whatever is left of a family: also at faces and beside a crack."""
    crack = Crack(polygon=((2.0, -1.0, -1.0), (2.0, 1.6, -1.0), (2.0, 1.6, 4.0), (2.0, -1.0, 4.0)))
    gradient = 1e-2 * GRADIENT
    scene = make_scene((4, 3, 2), 0, kinematics=kinematics, cracks=(crack,))
    found = mechanics_of_bonds(*parts(moved(scene, gradient)))
    strain = 0.5 * (gradient + gradient.T) + (0.5 * gradient.T @ gradient if kinematics == "finite" else 0.0)
    np.testing.assert_allclose(matrices(found.strain), np.broadcast_to(strain, (24, 8, 3, 3)), rtol=0, atol=SUMS)


def test_a_rotation_strains_nothing_and_turns_the_stress():
    """Finite kinematics: no strain in a body that is turned; a stretched one that is turned has its stress turned."""
    scene = make_scene((4, 2, 2), 2, kinematics="finite")
    turn, stretch = rotation(), np.diag([1.01, 0.995, 1.002])
    turned, straight, both = (moved(scene, f - np.eye(3)) for f in (turn, stretch, turn @ stretch))
    for mechanics in (lambda body: mechanics_of_bonds(*parts(body)), lambda body: mechanics_of_elements(*parts(body))):
        assert np.abs(mechanics(turned).strain).max() <= SUMS
        assert np.abs(mechanics(turned).stress).max() <= SUMS
        expected = turn @ matrices(mechanics(straight).stress) @ turn.T
        np.testing.assert_allclose(matrices(mechanics(both).stress), expected, rtol=0, atol=SUMS)


def test_fitted_bonds_have_the_stress_of_the_material_in_the_mean():
    """A uniform strain of a fitted body: its mean stress is the material's, whatever single points have."""
    scene = make_scene((4, 4, 3), 0, correction="fitted", signs="bounded")
    gradient = 1e-6 * 0.5 * (GRADIENT + GRADIENT.T)
    found = mechanics_of_bonds(*parts(moved(scene, gradient)))
    expected = law(six_of(gradient))
    mean = (found.stress * found.volume[..., None]).sum(axis=(0, 1)) / found.volume.sum()
    np.testing.assert_allclose(mean, expected, rtol=0, atol=1e-9 * np.abs(expected).max())


def test_a_mirrored_half_has_the_stress_of_the_whole():
    """Points beside a mirror plane have their images' bonds: strain, stress and energy of the whole body's points."""
    gradient = np.diag([1e-3, -2e-3, 5e-4])
    mesh = BoxMesh(lower=(0.0, 0.0, 0.0), upper=(2.0, 2.0, 2.0), spacing=1.0, symmetry=("x-", "z+"))
    whole = BoxMesh(lower=(-2.0, 0.0, 0.0), upper=(2.0, 2.0, 4.0), spacing=1.0)
    half, all_of_it = (build(make_scene((2, 2, 2), 0, mesh=m), loaded=False) for m in (mesh, whole))

    def fields(body):
        middle = np.array([0.0, 1.0, 2.0]) - body.share.units.origin
        bend = np.array([0.0, 1e-3, 0.0])
        u = body.of_positions(lambda x: (x - middle) @ gradient + bend * ((x - middle)[:, :1] ** 2))
        body.internal(u)
        found = mechanics_of_bonds(*parts(body))
        middles = body.share.mesh.centroids[found.cells]
        chosen = (middles[:, 0] > 0.0) & (middles[:, 2] < 2.0)
        order = np.lexsort(middles[chosen].T)
        return [values[chosen][order] for values in (found.strain, found.stress, found.energy_density)]

    for part, full in zip(fields(half), fields(all_of_it), strict=True):
        np.testing.assert_allclose(part, full, rtol=0, atol=1e-10 * np.abs(full).max())


def test_a_point_without_bonds_has_no_stress_and_no_strain_is_told():
    body = moved(make_scene((3, 2, 2), 0, kinematics="finite"), 1e-3 * GRADIENT)
    for rows in body.model.bonds.rows:
        rows.data[:] = 0.0
    found = mechanics_of_bonds(*parts(body))
    assert (found.stress == 0.0).all()
    assert np.isnan(found.strain).all()


@pytest.mark.parametrize("ratio", [0.1, 0.25, 0.4])
@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_mean_stress_and_energy_are_those_of_the_forces(kinematics, ratio):
    """``sum w sigma = -sum f (x) y`` with the forces of an evaluation, whatever the law; energies add up."""
    body = build(make_scene((4, 3, 3), 0, kinematics=kinematics, poissons_ratio=ratio), loaded=False)
    rng = np.random.default_rng(8)
    u = body.of_positions(lambda x: x @ (0.02 * GRADIENT.T) + 0.003 * rng.normal(size=x.shape))
    force = body.model.unknowns.rows(body.internal(u))
    x = body.model.unknowns.rows(body.model.points.x[: len(u)])
    y = x + body.model.unknowns.rows(u) if kinematics == "finite" else x
    stress, energy = bond_stresses(body.model.comm, body.forces.of_bonds)
    volume = body.model.points.volume[: len(x)].reshape(-1, 8)
    found = (volume[..., None] * stress).sum(axis=(0, 1))
    expected = six_of(-np.einsum("ni,nj->ij", force, y))
    np.testing.assert_allclose(found, expected, rtol=0, atol=SUMS * np.abs(volume[..., None] * stress).sum())
    assert (volume * energy).sum() == pytest.approx(body.forces.stored_energy(u), rel=SUMS)


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_softened_bonds_have_the_part_of_their_stress_that_is_left(kinematics):
    """As of all bonds: the moment of the forces, and the stored energy; half of the bonds of a strip have softened."""
    run = failing(soft_strip(kinematics=kinematics, cells=(4, 2, 1), crack=None))
    body, unknowns = run.body, run.body.model.unknowns
    u = body.of_positions(lambda x: 4.1 * STRETCH * x * [1.0, 0.0, 0.0])
    zero = np.zeros_like(u)
    body.forces.evaluate_surely(u, zero, np.empty_like(zero), run.failure, 0.0)
    run.failure.close(body.model.comm)
    assert run.failure.soft > 50
    force = unknowns.rows(body.internal(u))
    y = unknowns.rows(body.model.points.x[: len(u)]) + (unknowns.rows(u) if kinematics == "finite" else 0.0)
    stress, energy = bond_stresses(body.model.comm, body.forces.of_bonds)
    volume = body.model.points.volume[: len(y)].reshape(-1, 8)
    expected = six_of(-np.einsum("ni,nj->ij", force, y))
    found = (volume[..., None] * stress).sum(axis=(0, 1))
    np.testing.assert_allclose(found, expected, rtol=0, atol=STORED * np.abs(expected).max())
    assert (volume * energy).sum() == pytest.approx(body.forces.stored_energy(u), rel=STORED)
