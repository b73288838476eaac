"""Section 2.1: response (2), stretch (3), what a break costs (4), and local damage (5)."""

import math

import numpy as np
import pytest
from scipy.integrate import quad

from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.measure.fields import gather_damage
from pdfem_mpi.peridynamics.bonds import BULK_MODULUS, RESPONSE_CONSTANT
from pdfem_mpi.peridynamics.damage import local_damage
from support.bodies import bond_list, build, make_scene
from support.measure import cracked_block, damage_by_layer, lattice_constants, release_rate_inside, released

QUADRATURE = 1e-9  # relative, of the integrals below
SINGLE_PRECISION = 1e-7  # relative: stored numbers are rounded once, by up to 2**-24 = 6e-8

CUTOFF = 2.5  # r_c / l of the paper
KEPT_STIFFNESS = 0.98600  # of an infinite cutoff, derived; printed to five digits
KEPT_FRACTURE_ENERGY = 0.971457  # likewise, to six digits
# G_c over k s_0^2 l without cutoff
FRACTURE_CONSTANT = 27.0 * math.sqrt(math.pi) / 16.0

# Constants of the infinite Gauss lattice with l = Delta: E / E_0 without relaxation of its points against each other,
# measured here as 1.0225 and .9613; a relaxed lattice has 1.0209 and .9600 (measured with an independent program),
# and relaxation can only soften
RELAXED_MODULUS = {"none": 1.0209, "appendix_a": 0.9600}
SOFTENING = 0.002
LATTICE_POISSONS_RATIO, PRINTED = 0.2400, 5e-4  # four digits, and the relaxation

# Release rate of the Gauss lattice over the formula's, mean over the places of the plane: measured 3.0 % below with
# l = Delta and 1.1 % with l = 1.5 Delta, the error of the Gauss rule, second order in Delta / l
LATTICE_RATE = {1.0: 0.970, 1.5: 0.989}
THREE_DIGITS = 5e-4
# A plate's own bonds over 2.9056 k s_0^2 l, for a crack between cells, by thickness in cells: measured with an
# independent program, printed to three digits
OWN_BONDS = {("none", 1): 0.440, ("none", 8): 0.923} | {
    ("appendix_a", n): value for n, value in {1: 0.629, 2: 0.824, 4: 0.886, 8: 0.914}.items()
}
# One digit; with appendix A the sides of a plate of 9 cells still change bonds at its middle by .001
OWN_BONDS_TOLERANCE = {"none": 1e-3, "appendix_a": 1.5e-3}

DAMAGE = {0: 0.3915, 1: 0.1346}  # by layer of points beside a complete flat crack on cell faces; derived
HALF_A_DIGIT = 5e-5
FRONT = 3.9  # of a crack, along z; beside the lattice planes, where bonds would end at the front


def test_constant_of_the_response_gives_the_bulk_modulus():
    """Eq. 2: c = 9 k / (pi l^4) stores 9 k e^2 / 2 per volume under a uniform extension e, in an infinite body."""
    moment, _ = quad(lambda r: r**3 * math.exp(-(r**2)), 0.0, math.inf)
    energy = 0.5 * 0.5 * RESPONSE_CONSTANT * 4.0 * math.pi * moment  # half of each bond's c s^2 r / 2
    assert energy == pytest.approx(4.5 * BULK_MODULUS, rel=QUADRATURE)


def test_stiffness_that_the_cutoff_keeps():
    """Sec. 3.2: of the stiffness, r_c = 2.5 l keeps 1 - (1 + a^2) exp(-a^2) = .986."""
    kept, whole = (quad(lambda r: r**3 * math.exp(-(r**2)), 0.0, end)[0] for end in (CUTOFF, math.inf))
    assert kept / whole == pytest.approx(1.0 - (1.0 + CUTOFF**2) * math.exp(-(CUTOFF**2)), rel=QUADRATURE)
    assert kept / whole == pytest.approx(KEPT_STIFFNESS, abs=5e-6)


def printed_force(x, volume, u):
    """Eqs 2, 3 and 14 as they are printed (eta with the other sign), times the volumes, without any correction."""
    xi = x[None, :] - x[:, None]
    y = xi + u[None, :] - u[:, None]
    r, length = np.linalg.norm(xi, axis=2), np.linalg.norm(y, axis=2)
    np.fill_diagonal(r, np.inf)
    stretch = length / r - 1.0
    constant = 9.0 * BULK_MODULUS / math.pi
    size = np.where(r <= CUTOFF * (1 + 1e-9), constant * np.exp(-(r**2)) * stretch, 0.0)
    np.fill_diagonal(length, 1.0)
    return np.einsum("i,j,ij,ijd->id", volume, volume, size / length, y)


@pytest.mark.parametrize("size", [1e-6, 1e-3, 0.05])
def test_forces_of_a_small_body_are_those_printed(size):
    """Eqs 2, 3, 14: forces at displacements from a millionth to a twentieth of the cell."""
    body = build(make_scene((3, 2, 2), correction="none", kinematics="finite"))
    x = bond_list(body)[0]
    u = size * np.random.default_rng(5).uniform(-1.0, 1.0, x.shape)
    expected = printed_force(x, body.model.points.volume, u)
    found = body.internal(body.of_positions(lambda places: u)).reshape(-1, 3, 4).swapaxes(1, 2).reshape(-1, 3)
    # differences of lengths lose digits in the printed form: round-off over the stretch
    tolerance = (SINGLE_PRECISION + 1e-15 / size) * np.abs(expected).max()
    np.testing.assert_allclose(found, expected, rtol=0, atol=tolerance)


@pytest.mark.parametrize("correction", RELAXED_MODULUS)
def test_elastic_constants_of_the_gauss_lattice(correction):
    """Sec. 4.1, "cannot capture Poisson's ratio exactly": interior cells have E / E_0 = 1.02 (.96 corrected), nu .24.

    A sum over the bonds of the central cells, which appendix A alone cannot make right: it matches another moment.
    """
    body = build(make_scene((12, 12, 12), correction=correction), loaded=False)
    modulus, poissons_ratio = lattice_constants(body)
    assert 0.0 <= modulus - RELAXED_MODULUS[correction] <= SOFTENING
    assert poissons_ratio == pytest.approx(LATTICE_POISSONS_RATIO, abs=PRINTED)


def released_by(cutoff):
    """Energy of the bonds across a unit of plane at unit stretch, lengths in l: over heights, lengths, directions."""

    def cap(height):
        def directions(r):
            return 2.0 * math.pi * (1.0 - height / r)

        return quad(lambda r: 0.5 * RESPONSE_CONSTANT * math.exp(-(r**2)) * r**3 * directions(r), height, cutoff)[0]

    return quad(cap, 0.0, cutoff)[0]


def test_fracture_energy_formula():
    """Sec. 2.1, s_0 "can be related to the energy release rate": G_c = 27 sqrt(pi)/16 k l s_0^2 for response (2).

    Oracle: the bonds across a plane (Silling & Askari 2005, their eq. 20), each with c exp(-r^2) r s_0^2 / 2; a
    triple integral over the height of one end, the length, and the cap of directions that pass the plane.
    """

    assert released_by(12.0) == pytest.approx(FRACTURE_CONSTANT * BULK_MODULUS, rel=QUADRATURE)
    assert released_by(CUTOFF) / released_by(12.0) == pytest.approx(KEPT_FRACTURE_ENERGY, abs=5e-7)


@pytest.mark.parametrize("cutoff", [1.0, 2.0, CUTOFF, 4.0])
def test_critical_stretch_of_a_fracture_energy(cutoff):
    """`material.fracture_energy` gives the stretch at which the bonds across a plane release it, for any r_c / l."""
    length, energy = 0.05, 6.0
    material = Material(youngs_modulus=1.0e7, fracture_energy=energy)
    found = material.stretch_at_failure(length, cutoff)
    released = released_by(cutoff) / BULK_MODULUS * material.bulk_modulus * length * found**2
    assert released == pytest.approx(energy, rel=QUADRATURE)


def test_fracture_energy_of_the_papers_plate():
    """Sec. 4.2: s_0 = .0025 and l = .05 in mean G_c = 6.231 lb/in, 6.053 with the cutoff."""
    for energy, cutoff in ((6.231, 12.0), (6.053, CUTOFF)):
        material = Material(youngs_modulus=1.0e7, fracture_energy=energy)
        # four printed digits of G_c, half of which the square root leaves
        assert material.stretch_at_failure(0.05, cutoff) == pytest.approx(0.0025, rel=1e-4)


@pytest.mark.parametrize("internal_length", LATTICE_RATE)
def test_release_rate_of_a_cut_plane_approaches_the_formula(internal_length):
    """G_c of the bonds that a crack cuts inside a body, mean over the places of its plane, against the formula.

    From below: 3 % with l = Delta, 1.1 % with l = 1.5 Delta.
    """
    mean = release_rate_inside(internal_length) / (FRACTURE_CONSTANT * KEPT_FRACTURE_ENERGY * BULK_MODULUS)
    assert mean == pytest.approx(LATTICE_RATE[internal_length], abs=THREE_DIGITS)


@pytest.mark.parametrize(("correction", "thickness"), OWN_BONDS, ids=str)
def test_fracture_energy_of_a_plate_is_that_of_its_own_bonds(correction, thickness):
    """Sec. 2.1: thin plates cost less to cut than the bulk: .63 of it with one cell, .91 with eight (appendix A)."""
    body = build(make_scene((12, 9, thickness), correction=correction), loaded=False)
    found = released(body, 0.0, (0.5, 0.5 * thickness + 1.0))
    found /= thickness * FRACTURE_CONSTANT * KEPT_FRACTURE_ENERGY * BULK_MODULUS
    assert found == pytest.approx(OWN_BONDS[correction, thickness], abs=OWN_BONDS_TOLERANCE[correction])


@pytest.mark.parametrize("kinematics", ["linear", "finite"])
def test_damage_beside_a_full_crack(kinematics):
    """Eq. 5, Fig. 16: .3915 in the first layer of points beside a complete crack, .1346 in the second.

    So the figure's .38, "not necessarily material separation", is separation, and .5 is never reached.
    """
    body = cracked_block(kinematics)
    found = damage_by_layer(body)
    for layer, expected in DAMAGE.items():
        np.testing.assert_allclose(found[layer], expected, rtol=0, atol=HALF_A_DIGIT)
    assert not np.concatenate(found[6:]).any()  # 2.8 cells away


def test_damage_of_every_point_is_the_ratio_of_eq_5():
    """Eq. 5 against a sum over all pairs of points, near the front of a crack through half the section."""
    body = cracked_block(front=FRONT)
    found = gather_damage(body.share, body.model)
    x = body.geometry.point_positions
    xi = x[None, :] - x[:, None]
    r = np.linalg.norm(xi, axis=2)
    with np.errstate(divide="ignore", invalid="ignore"):
        where = x[:, None, 2] + xi[:, :, 2] * (4.0 - x[:, None, 0]) / xi[:, :, 0]
        across = ((x[:, None, 0] < 4.0) != (x[None, :, 0] < 4.0)) & (where < FRONT)
    weight = np.where((r > 0.0) & (r <= CUTOFF * (1 + 1e-9)), np.exp(-(r**2)), 0.0)  # equal volumes cancel
    expected = (weight * across).sum(axis=1) / weight.sum(axis=1)
    assert 0.0 < expected.max() < 0.5
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-10)  # terms are rounded to 2**-40 of the largest


@pytest.mark.nojit
def test_damage_without_and_with_all_bonds():
    """Eq. 5: 0 while every bond holds, exactly 1 when none is left."""
    body = build(make_scene((3, 2, 2), output=Output(damage=True)), loaded=False)
    model = body.model

    def damage():
        return local_damage(model.comm, model.points, model.bonds, model.intact_weights)

    assert not damage().any()
    for rows in model.bonds.rows:
        rows.data[:] = 0.0
    assert (damage() == 1.0).all()
    never_any = np.zeros_like(model.intact_weights)
    assert not local_damage(model.comm, model.points, model.bonds, never_any).any()
