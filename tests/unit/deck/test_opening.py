"""The dilatation beside a plane that opens, and what it gives to the fracture energy."""

import math

import pytest
from scipy.integrate import dblquad, quad

from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.opening import squared_dilatation

#: What nested quadratures leave.
QUADRATURE = 1e-6
#: Digits of the constants as they are written in docs/materials.md.
WRITTEN = 1e-4
CUTOFF = 2.5


def dilatation(z, cutoff):
    """Over a plane whose bonds are stretched by 1, over 3: from the integral over heights and directions itself."""

    def shell(r, cosine):
        # 2 pi r^2 sin dr of (3 / 2 pi) exp(-r^2) r over 3, for bonds that reach the plane
        return r**3 * math.exp(-(r**2)) if r * cosine > z else 0.0

    value, _ = dblquad(shell, z / cutoff if cutoff else 0.0, 1.0, lambda cosine: z / cosine, lambda _: cutoff)
    return value


@pytest.mark.parametrize("cutoff", [1.5, CUTOFF])
def test_squared_dilatation_is_that_of_the_bonds_that_reach_the_plane(cutoff):
    expected, _ = quad(lambda z: dilatation(z, cutoff) ** 2, 0.0, cutoff, epsrel=1e-8, limit=60)
    assert squared_dilatation(cutoff) == pytest.approx(expected, rel=QUADRATURE)


def test_constants_of_the_documents():
    assert squared_dilatation(100.0) == pytest.approx(0.10035, abs=1e-5)
    assert squared_dilatation(CUTOFF) == pytest.approx(0.09660, abs=1e-5)
    for nu, lacks in ((0.0, -1.0), (0.1, -0.75), (0.33, 0.32 / 0.34), (0.4, 3.0)):
        material = Material(youngs_modulus=2.0 * (1.0 + nu), poissons_ratio=nu)  # of shear modulus 1
        energy = material.energy_at_failure(1.0, 1.0, CUTOFF)
        assert energy == pytest.approx(4.843 + 0.8694 * lacks, rel=3.0 * WRITTEN)
        assert material.share_of_dilatation(CUTOFF) == pytest.approx(0.1795 * lacks, rel=3.0 * WRITTEN)


def test_bonds_alone_keep_their_formula():
    """To the last bit: decks of a ratio of 1/4 have the stretches they had."""
    material = Material(youngs_modulus=7.3e9, fracture_energy=61.0)
    share = math.erf(CUTOFF) - 2.0 / math.sqrt(math.pi) * math.exp(-(CUTOFF**2)) * (2.0 / 3.0 * CUTOFF**3 + CUTOFF)
    whole = 27.0 * math.sqrt(math.pi) / 16.0 * material.bulk_modulus * 0.013
    assert material.stretch_at_failure(0.013, CUTOFF) == math.sqrt(61.0 / (whole * share * 1.0**2))
    assert material.modulus_of_bonds == material.youngs_modulus


@pytest.mark.parametrize("nu", [0.1, 0.33, 0.4])
def test_stretch_of_a_fracture_energy_releases_it(nu):
    material = Material(youngs_modulus=1.0e7, poissons_ratio=nu, fracture_energy=6.0)
    stretch = material.stretch_at_failure(0.05, CUTOFF)
    assert material.energy_at_failure(stretch, 0.05, CUTOFF) == pytest.approx(6.0, rel=1e-12)
