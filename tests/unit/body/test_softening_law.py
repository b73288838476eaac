"""The law of a bond that softens: its energy, its teeth, the strength of a body, and what has no law."""

import subprocess
import sys

import numpy as np
import pytest
from scipy.integrate import quad

from pdfem_mpi.body.softening import law_of, laws_of_bonds
from pdfem_mpi.body.softening_law import Shape, Teeth, brittle, make_teeth, strength_factor
from pdfem_mpi.body.traction_opening import dilatation_energy
from pdfem_mpi.deck.materials import Interface, Material
from pdfem_mpi.deck.table import SceneError
from support.bodies import make_scene

EXACT = 1e-12
SAMPLED = 0.012  # strains of a body are sampled in steps of a hundredth
E, LENGTH, CUTOFF = 2.6e4, 3.0, 2.5
SHAPES = {"straight": Shape(0.5), "kink": Shape(0.5, (0.26, 0.114)), "line": Shape(1.0)}


def unit_energy(modulus, length):
    """C mu l at the cutoff 2.5 l, with C = 4.843 and mu = E / 2.5 for Poisson's ratio 1/4."""
    return 4.843 * modulus / 2.5 * length


@pytest.mark.parametrize("name", SHAPES)
@pytest.mark.parametrize("ratio", [6.0, 40.0])
@pytest.mark.parametrize("tooth_ratio", [1.1, 1.25, 1.5])
def test_teeth_have_the_energy_of_the_branch(name, ratio, tooth_ratio):
    """sum (phi_k - phi_k+1) s_k^2 is twice the area under the law, whatever the teeth."""
    shape = SHAPES[name]
    branch = shape.branch(ratio)
    area = 0.5 + quad(lambda s: np.interp(s, branch.stretch, branch.force), 1.0, ratio, points=branch.stretch[1:-1])[0]
    teeth = make_teeth(branch, tooth_ratio)
    energy = -(np.diff(teeth.stiffness) * teeth.limit**2).sum()
    assert energy == pytest.approx(2.0 * area, rel=1e-9)
    assert branch.energy == pytest.approx(2.0 * area, rel=1e-9)
    assert (np.diff(teeth.limit) > 0.0).all() and (np.diff(teeth.stiffness) < 0.0).all()
    assert teeth.stiffness[0] == 1.0 and teeth.stiffness[-1] == 0.0


@pytest.mark.parametrize("name", ["straight", "line"])
def test_teeth_straddle_a_straight_branch(name):
    """The force at a limit is above the branch before a bond goes on, and below it after."""
    branch = SHAPES[name].branch(12.0)
    teeth = make_teeth(branch, 1.25)
    first = 1 if name == "straight" else 0  # the drop itself
    for k in range(first, len(teeth.limit)):
        s = teeth.limit[k]
        on = np.interp(s, branch.stretch, branch.force)
        assert teeth.stiffness[k + 1] * s < on < teeth.stiffness[k] * s


def test_a_brittle_bond_is_one_tooth():
    teeth = brittle(0.002)
    assert teeth.limit.tolist() == [0.002] and teeth.stiffness.tolist() == [1.0, 0.0]


@pytest.mark.parametrize("name", ["straight", "kink"])
def test_ratio_gives_the_energy(name):
    """The final stretch for an energy has that energy; the least is where the branch, up to its kink, has no length."""
    shape = SHAPES[name]
    for energy in (shape.least_energy * 1.2, 5.0, 60.0):
        assert shape.branch(shape.ratio(energy)).energy == pytest.approx(energy, rel=EXACT)
    at = 1.0 if shape.kink is None else shape.kink[0]
    assert shape.ratio(shape.least_energy) * at == pytest.approx(1.0, rel=EXACT)


def test_strength_and_energy_are_independent():
    """s_t = f_t / E whatever l, and G_c = C mu l s_t^2 (1 + 1/2 (R - 1)): both are the deck's at any length."""
    for length in (1.0, 3.0, 9.0):
        law = law_of(Material(youngs_modulus=E, tensile_strength=2.6, fracture_energy=0.11), length, CUTOFF, 1.25)
        ratio = law.final / law.first
        assert law.first == pytest.approx(2.6 / E, rel=EXACT)
        energy = unit_energy(E, length) * law.first**2 * (1.0 + 0.5 * (ratio - 1.0))
        assert energy == pytest.approx(0.11, rel=2e-4)  # C is printed with four digits
        spent = -(np.diff(law.teeth.stiffness) * law.teeth.limit**2).sum()
        assert spent * unit_energy(E, length) == pytest.approx(0.11, rel=2e-4)


def test_too_long_a_length_has_no_law():
    """Beyond l_max = G_c / (C mu s_t^2) a bond has taken its energy before it softens; just below, R is near 1."""
    longest = 0.11 / (4.843 * E / 2.5 * (2.6 / E) ** 2)
    material = Material(youngs_modulus=E, tensile_strength=2.6, fracture_energy=0.11)
    law = law_of(material, 0.99 * longest, CUTOFF, 1.25)
    assert law.longest == pytest.approx(longest, rel=2e-4)
    assert law.final / law.first == pytest.approx(1.0 + 2.0 * (1.0 / 0.99 - 1.0), abs=1e-3)
    with pytest.raises(ValueError, match=f"bonds that soften need l <= {law.longest:.6g}"):
        law_of(material, 1.01 * longest, CUTOFF, 1.25)
    kinked = material.model_copy(update={"kink_stretch_ratio": 0.26, "kink_force_ratio": 0.114})
    assert law_of(kinked, 10.0, CUTOFF, 1.25).longest == pytest.approx(
        longest / (1.0 + 0.114 * (1 / 0.26 - 1)), rel=2e-4
    )


@pytest.mark.parametrize("planes", [0.8, 0.956, 1.01])
@pytest.mark.parametrize("nu", [0.25, 0.39])
def test_the_branch_makes_up_for_planes_of_a_lattice(planes, nu):
    """Planes that take a part of the bulk's energy have the deck's with the law; the strength is untouched. Forces are
    raised by as much, up to a drop to 0.53.
    """
    keys = {"kink_stretch_ratio": 0.26, "kink_force_ratio": 0.114, "poissons_ratio": nu}
    material = Material(youngs_modulus=E, tensile_strength=2.6, fracture_energy=0.11, **keys)
    law, without = (law_of(material, LENGTH, CUTOFF, 1.25, part) for part in (planes, 1.0))
    assert law.first == without.first and law.planes == planes
    assert law.shape.drop == pytest.approx(min(0.5 / planes, 0.53), rel=EXACT)
    assert law.shape.kink[0] == 0.26 and law.shape.kink[1] == pytest.approx(0.114 * law.shape.drop / 0.5, rel=EXACT)
    mu, lacks = E / (2.0 * (1.0 + nu)), (4.0 * nu - 1.0) / (1.0 - 2.0 * nu)
    ratio = law.final / law.first
    whole = law.teeth.energy + lacks * law.first**2 * (dilatation_energy(law.shape, ratio, CUTOFF) if lacks else 0.0)
    assert planes * 4.843 * mu * LENGTH * whole == pytest.approx(0.11, rel=2e-4)  # C is printed with four digits


def test_a_line_keeps_its_forces():
    """Without a drop the strength is that of the branch, and the energy lengthens it."""
    material = Material(youngs_modulus=E, tensile_strength=2.6, fracture_energy=0.11, softening="line")
    law = law_of(material, 60.0, CUTOFF, 1.25, 0.956)
    assert law.shape.drop == 1.0
    assert 0.956 * unit_energy(E, 60.0) * law.teeth.energy == pytest.approx(0.11, rel=2e-4)
    assert E * law.teeth.limit[0] * strength_factor(law.teeth) == pytest.approx(2.6, rel=SAMPLED)


@pytest.mark.parametrize("ratio", [2.0, 20.0])
@pytest.mark.parametrize("drop", [0.5, 0.53])
def test_with_a_drop_the_body_is_as_strong_as_its_bonds(ratio, drop):
    """A drop to 1/2 leaves no hardening, whatever follows, and one to 0.53 hardly any."""
    assert strength_factor(make_teeth(Shape(drop).branch(ratio), 1.25)) == pytest.approx(1.0, abs=SAMPLED)


@pytest.mark.parametrize("nu", [0.2, 0.33, 0.39, 0.45])
def test_with_a_drop_the_body_is_as_strong_at_other_poissons_ratios(nu):
    """The stress of a uniaxial strain state, from the quadratic form of all bonds and the dilatation."""
    assert strength_factor(make_teeth(Shape(0.5).branch(20.0), 1.25), nu) == pytest.approx(1.0, abs=SAMPLED)
    law = law_of(
        Material(youngs_modulus=E, poissons_ratio=nu, tensile_strength=2.6, fracture_energy=0.5), 3.0, CUTOFF, 1.25
    )
    assert law.first == pytest.approx(2.6 / E, rel=EXACT)


def test_low_ratios_and_long_branches_harden_and_have_their_strength():
    """At a Poisson's ratio of 0 and R near 100 bonds begin earlier, so that the body has the deck's strength."""
    material = Material(youngs_modulus=E, poissons_ratio=0.0, tensile_strength=2.6, fracture_energy=0.6)
    law = law_of(material, 3.0, CUTOFF, 1.25)
    assert law.final / law.first > 80.0 and law.first < 0.95 * 2.6 / E
    assert E * law.first * strength_factor(
        Teeth(law.teeth.limit / law.first, law.teeth.stiffness), 0.0
    ) == pytest.approx(2.6, rel=SAMPLED)


@pytest.mark.parametrize("name", ["straight", "kink"])
@pytest.mark.parametrize("nu", [0.2, 0.39])
def test_energy_has_that_of_the_dilatation_in_it(nu, name):
    """G_c = C mu l s_t^2 (energy of the branch + (lambda - mu) / mu times that of the dilatation)."""
    shape, material = (
        SHAPES[name],
        Material(youngs_modulus=E, poissons_ratio=nu, tensile_strength=2.6, fracture_energy=0.11),
    )
    if name == "kink":
        material = material.model_copy(update={"kink_stretch_ratio": 0.26, "kink_force_ratio": 0.114})
    law = law_of(material, LENGTH, CUTOFF, 1.25)
    mu, lacks = E / (2.0 * (1.0 + nu)), (4.0 * nu - 1.0) / (1.0 - 2.0 * nu)
    ratio = law.final / law.first
    unit = 4.843 * mu * LENGTH * law.first**2
    expected = shape.branch(ratio).energy + lacks * dilatation_energy(shape, ratio, CUTOFF)
    assert unit * expected == pytest.approx(0.11, rel=2e-4)
    assert law.energy_of_bonds == pytest.approx(unit * shape.branch(ratio).energy, rel=2e-4)
    near = law_of(material, 0.999 * law.longest, CUTOFF, 1.25)
    assert near.final / near.first < 1.02 / (shape.kink or (1.0,))[0]
    with pytest.raises(ValueError, match="is too long"):
        law_of(material, 1.001 * law.longest, CUTOFF, 1.25)


def test_without_a_drop_the_body_hardens():
    """Fine teeth come to the strengths of the line, 1.32, 1.55 at R = 5, 20; the deck's strength is the body's."""
    for ratio, expected in ((5.0, 1.32), (20.0, 1.55)):
        teeth = make_teeth(Shape(1.0).branch(ratio), 1.02)
        assert strength_factor(teeth) * teeth.limit[0] == pytest.approx(expected, abs=2.0 * SAMPLED)
    material = Material(youngs_modulus=E, tensile_strength=2.6, fracture_energy=0.11, softening="line")
    law = law_of(material, 60.0, CUTOFF, 1.25)
    assert E * law.teeth.limit[0] * strength_factor(law.teeth) == pytest.approx(2.6, rel=SAMPLED)
    assert law.first < 2.6 / E


def test_laws_across_an_interface():
    """What an interface says of failure replaces all of its material's; of two equal sides the weaker holds."""
    scene = make_scene((4, 2, 2))
    tough = Material(youngs_modulus=E, tensile_strength=2.6, fracture_energy=0.5)
    weak = Material(youngs_modulus=E, tensile_strength=1.3, fracture_energy=0.5)
    scene = scene.model_copy(update={"material": tough, "materials": {"weak": weak}})
    laws, which = laws_of_bonds(scene, LENGTH, CUTOFF, 1.0)
    assert laws[which[0, 1]].first == laws[which[1, 1]].first == pytest.approx(1.3 / E)
    glue = Interface(between=("default", "weak"), critical_stretch=1e-5)
    laws, which = laws_of_bonds(scene.model_copy(update={"interfaces": (glue,)}), LENGTH, CUTOFF, 1.0)
    assert laws[which[0, 1]].teeth.limit.tolist() == [1e-5]
    assert laws[which[0, 0]].first == pytest.approx(2.6 / E)


def test_all_materials_without_a_law_are_told_at_once():
    bad = {"tensile_strength": 2.6, "fracture_energy": 1e-6}
    scene = make_scene((4, 2, 2)).model_copy(
        update={"material": Material(youngs_modulus=E, **bad), "materials": {"b": Material(youngs_modulus=E, **bad)}}
    )
    with pytest.raises(SceneError) as refused:
        laws_of_bonds(scene, LENGTH, CUTOFF, 1.0)
    assert len(refused.value.messages) == 2
    assert all(message.startswith("peridynamics.internal_length = 3 is too long") for message in refused.value.messages)


def test_decks_without_softening_do_without_the_optimiser():
    """Its library is 10 MiB: it is loaded where a ratio or a kink is sought."""
    code = "import sys, pdfem_mpi.runs.run; sys.exit('scipy.optimize' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code]).returncode == 0
