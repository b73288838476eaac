"""The numbers of the criterion in a body, and the sentences about what a deck leaves to its cells."""

import math

import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.overlap import describe_cracked_overlap
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.peridynamics import Crack, Peridynamics
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import Units
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.runs.failure_notes import criteria, describe_criterion, failure_summary
from support.bodies import bond_list, box_regions, build, make_scene
from support.failing import EDGE, STRETCH, strip
from support.measure import GAPS, release_rate_inside, released
from support.softening import soft_strip, softening_material

MODULUS = 1000.0
SUMS = 1e-9  # relative: terms are rounded to 2^-36 of the largest and less
SINGLE = 1e-6  # finite rows keep two rounded numbers a bond
PLACES = 1e-3  # relative: the finite plate's edges reach its middle through twenty sweeps of the correction


def breaking(scene):
    """The scene with a material whose bonds break."""
    return scene.model_copy(update={"material": Material(youngs_modulus=MODULUS, critical_stretch=STRETCH)})


def endless(faces, correction, cells=(2, 2, 1)):
    """A body repeated without end across mirror planes."""
    mesh = BoxMesh(lower=(0.0, 0.0, 0.0), upper=tuple(map(float, cells)), spacing=1.0, symmetry=faces)
    return breaking(make_scene(cells, mesh=mesh, correction=correction, loads=()))


def numbers_of(scene):
    body = build(scene, loaded=False)
    return body, criteria(scene, body.share, body.model)


def notes(scene):
    body, found = numbers_of(scene)
    failure = make_failure(scene, body.share, body.model)
    return list(describe_criterion(scene, body.share, failure, found))


# --- numbers


def test_own_energy_is_that_of_the_bonds_one_by_one():
    """Sum of energies at critical stretch times ``|xi_d|`` over the volume, cracks left out of account."""
    scene = strip(cells=(6, 4, 2), crack=EDGE)
    open_ends = tuple(region.model_copy(update={"may_fail": None}) for region in scene.regions)
    scene = scene.model_copy(update={"regions": open_ends})
    _, found = numbers_of(scene)
    whole = build(scene.model_copy(update={"cracks": ()}), loaded=False)
    x, i, j, stored = bond_list(whole)
    xi = x[j] - x[i]
    energy = 0.5 * stored * (xi**2).sum(axis=1) ** 2 * STRETCH**2
    expected = (energy[:, None] * np.abs(xi)).sum(axis=0) / 48.0 * MODULUS  # l = 1
    np.testing.assert_allclose(found["default"].fracture_energy_own_bonds, expected, rtol=SUMS)


def test_own_energy_of_a_body_without_ends_is_that_of_the_bulk():
    """Mirrors all around: what cracks between and within cells cut inside of a block; the bulk's is the integral."""
    _, found = numbers_of(endless(("x-", "x+", "y-", "y+", "z-", "z+"), "none"))
    inside = release_rate_inside(1.0) * MODULUS * STRETCH**2
    np.testing.assert_allclose(found["default"].fracture_energy_own_bonds, inside, rtol=SUMS)
    bulk = found["default"].fracture_energy_bulk
    assert bulk == pytest.approx(0.971457 * 27.0 * math.sqrt(math.pi) / 16.0 * MODULUS / 1.5 * STRETCH**2, rel=1e-5)


def test_a_plate_one_cell_thick_has_less():
    """Cracks through the middle of a wide one, between cells and within them; below two thirds of the bulk's."""
    _, found = numbers_of(endless(("x-", "x+", "y-", "y+"), "appendix_a"))
    criterion = found["default"]
    plate = breaking(make_scene((14, 13, 1), loads=()))
    across = sum(gap * released(build(plate, loaded=False), place, (0.5, 0.75)) for place, gap in GAPS.items())
    expected = across * MODULUS * STRETCH**2
    np.testing.assert_allclose(criterion.fracture_energy_own_bonds[:2], expected, rtol=PLACES)
    assert expected < 2.0 / 3.0 * criterion.fracture_energy_bulk


@pytest.mark.parametrize("faces", [("x-",), ("x-", "y-", "z-")], ids="".join)
def test_a_part_between_mirrors_has_what_the_whole_has(faces):
    """Bonds to images and to the own image count as in the whole body."""
    lower = tuple(0.0 if f"{axis}-" in faces else -2.0 for axis in "xyz")
    energies = []
    for low, symmetry in (((-2.0,) * 3, ()), (lower, faces)):
        mesh = BoxMesh(lower=low, upper=(2.0, 2.0, 2.0), spacing=1.0, symmetry=symmetry)
        cells = tuple(round(2.0 - a) for a in low)
        _, found = numbers_of(breaking(make_scene(cells, mesh=mesh, loads=())))
        energies.append(found["default"].fracture_energy_own_bonds)
    np.testing.assert_allclose(*energies, rtol=SUMS)


def test_kinematics_do_not_matter():
    """The same bonds, stored otherwise."""
    energies = [
        numbers_of(strip(kinematics=kinematics))[1]["default"].fracture_energy_own_bonds
        for kinematics in ("linear", "finite")
    ]
    np.testing.assert_allclose(*energies, rtol=SINGLE)


def test_summary_tells_strength_energies_and_length():
    """In the deck's units, by material; nothing where nothing breaks."""
    scene = strip()
    body, found = numbers_of(scene)
    told = failure_summary(scene, body.share, make_failure(scene, body.share, body.model), found)
    assert (told["internal_length"], told["internal_length_given"], told["cutoff_radius"]) == (1.0, False, 2.5)
    material = told["materials"]["default"]
    assert material["critical_stretch"] == STRETCH and material["strength"] == pytest.approx(MODULUS * STRETCH)
    assert 0.0 < material["fracture_energy_own_bonds"][0] < material["fracture_energy_bulk"]
    assert failure_summary(scene, body.share, None, {}) is None
    assert numbers_of(make_scene((2, 2, 2)))[1] == {}


# --- sentences


def test_a_length_that_follows_the_cells_is_told():
    """One sentence with what changes, the numbers of this body and the remedy; none where the deck gives it."""
    scene = strip().model_copy(update={"units": Units(length="in", force="lbf")})
    (note,) = notes(scene)
    own = ", ".join(f"{g:.4g}" for g in numbers_of(scene)[1]["default"].fracture_energy_own_bonds)
    assert "follows the cells, l = 1 in" in note and "change the G_c" in note and f"{own} lbf/in" in note
    assert note.endswith("give peridynamics.internal_length = 1 to keep the material.")
    by_energy = scene.model_copy(update={"material": Material(youngs_modulus=MODULUS, fracture_energy=1.0)})
    assert "change the strength E s_0" in notes(by_energy)[0]
    assert notes(scene.model_copy(update={"peridynamics": Peridynamics(internal_length=1.0)})) == []


def coupled(may_fail=None, internal_length=2.0, overlap=1):
    """Elements in the first four layers of a bar, bonds behind."""
    elements, bonds = box_regions((9, 3, 3), 4)
    return breaking(
        make_scene(
            (9, 3, 3), internal_length=internal_length, overlap=overlap, loads=(),
            regions=(elements.model_copy(update={"may_fail": may_fail}), bonds),
        )
    )  # fmt: skip


def test_an_overlap_that_may_break_is_told():
    """By the key that lets it, and what it does; not where the key is left out, or says no."""
    assert not any("may_fail" in note for note in notes(coupled(overlap=2)))
    (warning,) = notes(coupled(True, overlap=2))
    assert warning.startswith("warning: regions.0.may_fail = true") and "no crack opens" in warning
    assert notes(coupled(False)) == []


def test_a_shallow_overlap_is_told():
    """Bonds longer than it is deep stretch more; deep enough, or out of their reach, nothing is said."""
    (note,) = notes(coupled())
    assert "1 deep and shallower than the internal length 2" in note and "coupling.overlap = 2" in note
    assert notes(coupled(overlap=2)) == notes(coupled(internal_length=1.0)) == []
    scene = coupled()
    band = Region(name="band", model="peridynamics", lower=(4, 0, 0), upper=(9, 3, 3), may_fail=False)
    far = Region(name="far", model="peridynamics", lower=(9, 0, 0))
    mesh = scene.mesh.model_copy(update={"upper": (11.0, 3.0, 3.0)})
    scene = scene.model_copy(update={"regions": (scene.regions[0], band, far), "mesh": mesh})
    assert notes(scene) == []


def test_a_crack_through_the_overlap_is_told():
    """Its points follow element nodes: with the cells and the remedy; not where it ends at the interface."""
    told = []
    for end in (3.2, 4.0 + 1e-3):
        polygon = ((end, 1.5, -1.0), (6.0, 1.5, -1.0), (6.0, 1.5, 4.0), (end, 1.5, 4.0))
        scene = coupled().model_copy(update={"cracks": (Crack(polygon=polygon),)})
        told.append(describe_cracked_overlap(scene, discretize(scene)))
    ((warning,), none) = told
    assert warning.startswith("warning: cracks.0 passes through 3 cells of the overlap, the first ")
    assert warning.endswith("End it at the interface.") and none == []


# --- bonds that soften


def test_what_misleads_of_softening_bonds_is_told():
    """A process zone of less than three cells; a line beyond R = 5; nothing of lengths that follow the cells."""
    assert any("the process zone is" in note for note in notes(soft_strip(ratio=1.05)))
    told = notes(soft_strip())
    assert not any("process zone is" in note or "follows the cells" in note for note in told)
    assert not any("R alone makes up for it" in note for note in told)
    line = soft_strip(material=softening_material(ratio=14.0, softening="line"))
    assert any("R alone makes up for it, and forces are those of the line" in note for note in notes(line))
    assert any('softening = "line" with R = ' in note for note in notes(line))


def test_bonds_that_soften_beside_elements_are_told():
    """Within a cutoff of them, unless a band that may not fail lies between."""
    scene = soft_strip(elements=2)
    free = tuple(region.model_copy(update={"may_fail": None}) for region in scene.regions)
    near = [any("within a cutoff radius of finite elements" in note for note in notes(each)) for each in (
        scene.model_copy(update={"regions": free}), soft_strip(elements=2, cells=(16, 3, 1), crack=None, band=4.0)
    )]  # fmt: skip
    assert near == [True, False]
