"""Which changes of a deck let a run go on, and which make it another run."""

import pytest

from pdfem_mpi.body.cutting import share_of
from pdfem_mpi.body.lattice_planes import lattice_energy
from pdfem_mpi.body.meshing import make_mesh
from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.outputs import LineProbe, Output
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.programs import Solver, Steps
from pdfem_mpi.deck.removals import RemovedBox
from pdfem_mpi.deck.temperatures import Temperature
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.runs.identity import (
    ELEMENTS,
    ELEMENTS_BESIDE_BONDS,
    FREE,
    HEAT,
    INSIDE,
    LOAD_FACTORS,
    MAY_CHANGE,
    MESH,
    PLANES,
    TIMES,
    differences,
    identity,
    sha256,
)
from support.bodies import local_share, make_scene
from support.softening import soft_strip


def keys_of(**tables):
    scene = make_scene((5, 2, 2), 2, **tables)
    return identity(scene, local_share(scene))


SUPPORT = Support(face="x-", x=0.0)
CRACK = Crack(polygon=((3.0, 0.0, 0.0), (3.0, 1.0, 0.0), (3.0, 1.0, 2.0)))
KEYS = keys_of(supports=(SUPPORT,), cracks=(CRACK,), stepping=Steps(load_factors=(0.5, 1.0)))
DEFINING = [key for key in KEYS if key not in (LOAD_FACTORS, TIMES) and not key.startswith(FREE + MAY_CHANGE)]


def another(value):
    return 1.5 if value is None else not value if isinstance(value, bool) else value * 2 if value else "other"


def test_the_same_scene_has_the_same_keys():
    again = keys_of(supports=(SUPPORT,), cracks=(CRACK,), stepping=Steps(load_factors=(0.5, 1.0)))
    assert differences(KEYS, again, 1) == ([], [])
    assert sha256(KEYS) == sha256(again)


@pytest.mark.parametrize("key", DEFINING)
def test_each_defining_key_makes_another_run(key):
    """Changed, and absent on either side; the sentence names the key and both values."""
    changed = KEYS | {key: another(KEYS[key])}
    refused, allowed = differences(KEYS, changed, 1)
    assert (len(refused), allowed) == (1, []) and refused[0].startswith(key)
    assert sha256(changed) != sha256(KEYS)
    absent = {name: value for name, value in KEYS.items() if name != key}
    if KEYS[key] is not None:
        assert differences(absent, KEYS, 1)[0] and differences(KEYS, absent, 1)[0]


def test_keys_are_told_with_both_values():
    changed = KEYS | {"material.youngs_modulus": 2000.0}
    assert differences(KEYS, changed, 0)[0] == ["material.youngs_modulus was 1000.0, the deck has 2000.0"]


def test_elements_in_finite_kinematics_are_a_key_of_their_own():
    """Beside bonds they were linear once: such a run may go on, and is allowed. Alone they are another run."""
    finite = keys_of(kinematics="finite")
    before = {key: value for key, value in finite.items() if key != ELEMENTS_BESIDE_BONDS}
    assert differences(before, finite, 1) == ([], [f'{ELEMENTS_BESIDE_BONDS} was nothing, the deck has "finite"'])
    assert differences(finite, keys_of(kinematics=None), 1) == ([], [])  # the default beside bonds
    alone = {
        kinematics: identity(scene, local_share(scene))
        for kinematics in (None, "finite")
        for scene in [make_scene((2, 1, 1), 2, kinematics=kinematics)]
    }
    assert differences(alone[None], alone["finite"], 1) == ([f'{ELEMENTS} was nothing, the deck has "finite"'], [])


def test_bonds_that_soften_by_another_law_are_another_run():
    """Checkpoints before the branch made up for the lattice have the deck's keys, and bonds with other teeth."""
    scene = soft_strip()
    keys = identity(scene, local_share(scene))
    assert keys[PLANES] == lattice_energy(1.0, 2.5, "virial")
    (refused,), allowed = differences({key: value for key, value in keys.items() if key != PLANES}, keys, 1)
    assert refused.startswith(f"{PLANES} was nothing, the deck has 0.95") and "by another law" in refused
    assert "begin anew" in refused and "--force" in refused and not allowed
    assert PLANES not in KEYS and INSIDE not in KEYS  # brittle bonds in a box go on


def test_bonds_that_left_the_body_are_another_run():
    """In a body that may have hollows, of which checkpoints may have bonds that are cut now."""
    notch = RemovedBox(kind="box", lower=(2.0, 0.0, 0.0), upper=(3.0, 1.0, 2.0))
    mesh = BoxMesh(lower=(0.0, 0.0, 0.0), upper=(5.0, 2.0, 2.0), spacing=1.0, remove=(notch,))
    for elements, kept in ((2, True), (5, False)):
        scene = make_scene((5, 2, 2), elements, mesh=mesh, loads=())
        keys = identity(scene, local_share(scene))
        assert (INSIDE in keys) == kept
        refused, _ = differences({key: value for key, value in keys.items() if key != INSIDE}, keys, 1)
        assert len(refused) == kept
        assert not kept or (refused[0].startswith(f"{INSIDE} was nothing") and "begin anew" in refused[0])


@pytest.mark.parametrize(("elements", "limit"), [(0, True), (2, False), (5, True)])
def test_regions_of_earlier_checkpoints_may_fail(elements, limit):
    """Unset means true, the default once: in peridynamics, without overlap, and where no bond has a limit."""
    scene = make_scene((5, 2, 2), elements)
    material = Material(youngs_modulus=1000.0, critical_stretch=0.01 if limit else None)
    scene = scene.model_copy(update={"material": material})
    keys = identity(scene, local_share(scene))
    flags = {f"regions.{k}.may_fail": True for k in range(len(scene.regions))}
    assert {key: keys[key] for key in flags} == flags
    assert differences(keys | flags, keys, 1) == ([], [])
    assert differences(keys | {"regions.0.may_fail": False}, keys, 1)[0]


@pytest.mark.parametrize(
    "tables",
    [
        {"title": "another"},
        {"output": Output(figures=False, fields=False)},
        {"probes": (LineProbe(kind="line", name="a", start=(0.0, 0.0, 0.0), stop=(1.0, 0.0, 0.0)),)},
    ],
)
def test_output_may_change(tables):
    assert differences(keys_of(), keys_of(**tables), 0) == ([], [])


@pytest.mark.parametrize("key", MAY_CHANGE)
def test_tolerance_and_effort_may_change_and_are_told(key):
    changed = keys_of() | {key: Solver().max_evaluations + 1}
    refused, allowed = differences(keys_of(), changed, 0)
    assert refused == [] and allowed[0].startswith(key)
    assert sha256(changed) == sha256(keys_of())


@pytest.mark.parametrize(
    ("factors", "allowed"),
    [((0.5, 1.0, 2.0), True), ((0.5, 0.7), True), ((0.5,), True), ((0.6, 1.0), False), ((0.25, 0.5, 1.0), False)],
)
def test_load_factors_already_reached_must_stay(factors, allowed):
    """One of two steps is done."""
    refused, changes = differences(KEYS, KEYS | {LOAD_FACTORS: list(factors)}, 1)
    assert (bool(changes), bool(refused)) == (allowed, not allowed)


def test_a_renumbered_mesh_is_another_mesh():
    scene = make_scene((5, 2, 2), 2)
    mesh = make_mesh(scene)
    mesh.cells[[0, 1]] = mesh.cells[[1, 0]]
    refused, _ = differences(keys_of(), identity(scene, share_of(scene, mpi().COMM_SELF, mesh)), 0)
    assert refused == [f"{MESH} differs"]


def test_temperatures_of_another_content_make_another_run(tmp_path):
    """The path alone would let a file that was written anew pass in silence."""
    path = tmp_path / "hot.vtu"
    scene = make_scene((3, 2, 2), 3).model_copy(update={"temperature": Temperature(file=str(path), field="T")})
    share, found = local_share(scene), []
    for content in (b"warm", b"warm", b"hot"):
        path.write_bytes(content)
        found.append(identity(scene, share))
    assert differences(found[0], found[1], 0) == ([], [])
    refused, allowed = differences(found[0], found[2], 0)
    assert refused == [f"{HEAT} differs"] and not allowed
