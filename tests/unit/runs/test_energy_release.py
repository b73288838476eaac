"""The probe of an energy release rate: against the compliances of two bodies, and what it refuses."""

import numpy as np
import pytest

import pdfem_mpi as pdfem
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.runs.crack_fronts import default_extension, doubtful_extensions
from support.bodies import local_share
from support.mesh_files import write_mesh

EQUILIBRIUM = 1e-7  # of a difference of compliances: residuals of 1e-10

STRIP = """
[mesh]
kind = "box"
lower = [0.0, 0.0, 0.0]
upper = [8.0, 6.0, 1.0]
spacing = 1.0
symmetry = ["z-", "z+"]
[material]
youngs_modulus = 1000.0
[[regions]]
name = "bonds"
model = "peridynamics"
[peridynamics]
surface_correction = "virial"
kinematics = "linear"
[[cracks]]
polygon = [[-1.0, 3.0, -1.0], [LENGTH, 3.0, -1.0], [LENGTH, 3.0, 2.0], [-1.0, 3.0, 2.0]]
[[probes]]
kind = "energy_release"
name = "tip"
direction = [2.0, 0.0, 0.0]
[solver]
kind = "cg"
tolerance = 1e-10
[output]
fields = false
figures = false
"""
PULLED = '[[loads]]\nkind = "body_force"\nface = "y-"\ntotal = [0.0, -2.0, 0.0]\n' + (
    '[[loads]]\nkind = "body_force"\nface = "y+"\ntotal = [0.0, 2.0, 0.0]\n'
)
MOVED = '[[supports]]\nface = "y-"\ny = -0.01\n[[supports]]\nface = "y+"\ny = 0.01\nx = 0.0\n'


def row(length, loading):
    simulation = pdfem.Simulation(parse_deck(STRIP.replace("LENGTH", str(length)) + loading, "strip.toml"))
    return simulation.solve(1.0)


def test_rate_under_forces_is_that_of_the_compliance(tmp_path):
    """``G = P dv / 2`` per new area: what the longer crack adds to the work of the same forces."""
    folder = pdfem.run(parse_deck(STRIP.replace("LENGTH", "3.0") + PULLED, "strip.toml"), tmp_path / "run")
    shorter, longer = row(3.0, PULLED), row(4.0, PULLED)
    assert shorter["reaction"] == longer["reaction"] == 2.0
    expected = 0.5 * 2.0 * (longer["displacement"] - shorter["displacement"])
    found = folder.summary["probes"]["tip"]
    assert found["energy_release_rate"] == pytest.approx(expected, rel=EQUILIBRIUM)
    modulus = 1000.0 / (1.0 - 0.25**2)
    assert found["stress_intensity"] == pytest.approx(np.sqrt(expected * modulus), rel=EQUILIBRIUM)


def test_rate_between_moving_supports_is_that_of_the_stiffness(tmp_path):
    """``G = -v dP / 2`` per new area, with ``v`` and ``P`` of both ends: the energy that the body loses."""
    folder = pdfem.run(parse_deck(STRIP.replace("LENGTH", "3.0") + MOVED, "strip.toml"), tmp_path / "run")
    shorter, longer = row(3.0, MOVED), row(4.0, MOVED)
    expected = 0.5 * 0.02 * (shorter["reaction"] - longer["reaction"])
    assert folder.summary["probes"]["tip"]["energy_release_rate"] == pytest.approx(expected, rel=1e-6)


def test_half_a_body_beside_a_crack_on_its_mirror_releases_as_much(tmp_path):
    whole = parse_deck(STRIP.replace("LENGTH", "3.0") + PULLED, "strip.toml")
    text = STRIP.replace("LENGTH", "3.0") + PULLED.partition("[[loads]]")[2].partition("[[loads]]")[2]
    text = text.replace('symmetry = ["z-", "z+"]', 'symmetry = ["z-", "z+", "y-"]').replace(
        "lower = [0.0, 0.0, 0.0]", "lower = [0.0, 3.0, 0.0]"
    )
    half = parse_deck(text.replace('kind = "body_force"', '[[loads]]\nkind = "body_force"', 1), "half.toml")
    rates = [
        pdfem.run(scene, tmp_path / name).summary["probes"]["tip"]["energy_release_rate"]
        for name, scene in (("whole", whole), ("half", half))
    ]
    assert rates[1] == pytest.approx(rates[0], rel=1e-6)


def flat_cells(folder, shape):
    """The strip with a crack of length 3 from a mesh file, in cells of some shape."""
    counts = [round(side / edge) for side, edge in zip((8.0, 6.0, 1.0), shape, strict=True)]
    x, y, z = np.meshgrid(*(np.arange(n + 1.0) for n in counts), indexing="ij")
    number = np.arange(x.size).reshape(x.shape)
    corner = number[:-1, :-1, :-1].reshape(-1, 1)
    steps = number[[0, 1, 1, 0, 0, 1, 1, 0], [0, 0, 1, 1, 0, 0, 1, 1], [0, 0, 0, 0, 1, 1, 1, 1]]
    nodes = np.stack([x, y, z], axis=-1).reshape(-1, 3) * shape
    write_mesh(folder / "flat.vtu", HexMesh(nodes, corner + steps))
    tail = STRIP.partition("spacing = 1.0")[2].replace("LENGTH", "3.0")
    text = f'[mesh]\nkind = "file"\npath = "{folder / "flat.vtu"}"' + tail
    return parse_deck(text + MOVED, "flat.toml")


@pytest.mark.parametrize(
    ("shape", "expected"), [((1.0, 1.0, 0.25), 1.0), ((0.5, 1.0, 1.0), 0.5), ((2.0, 1.0, 0.5), 2.0)]
)
def test_crack_grows_by_the_cell_along_its_direction(tmp_path, shape, expected):
    """Half-way between the shortest and the longest edge, as it was, is no whole number of these cells."""
    scene = flat_cells(tmp_path, shape)
    assert default_extension(scene, local_share(scene), scene.probes[0]) == pytest.approx(expected, rel=1e-12)


def test_rate_in_flat_cells_is_that_of_a_whole_cell(tmp_path):
    scene = flat_cells(tmp_path, (1.0, 1.0, 0.5))
    given = scene.probes[0].model_copy(update={"extension": 1.0})
    rates = [
        pdfem.run(one, tmp_path / name).summary["probes"]["tip"]["energy_release_rate"]
        for name, one in (("left out", scene), ("given", scene.model_copy(update={"probes": (given,)})))
    ]
    assert rates[0] == pytest.approx(rates[1], rel=EQUILIBRIUM)


@pytest.mark.parametrize(
    ("extension", "words"),
    [
        (0.1, "extension = 0.1 is less than a cell at the front is long in that direction, 1:"),
        (1.5, "extension = 1.5 is 1.5 cells at the front, which are 1 long in that direction:"),
        (1.0, None), (3.0, None), (None, None),
    ],
)  # fmt: skip
def test_steps_of_no_whole_number_of_cells_are_told(extension, words):
    given = "" if extension is None else f"extension = {extension}\n"
    text = STRIP.replace("LENGTH", "3.0").replace("[solver]", f"{given}[solver]") + PULLED
    scene = parse_deck(text, "strip.toml")
    found = list(doubtful_extensions(scene, local_share(scene)))
    assert [words in sentence for sentence in found] == ([] if words is None else [True])


def test_cubes_grow_by_their_edge_whatever_the_direction():
    """A front along the diagonal of the cells, in a plane through it, and the edge in its bits."""
    polygon = "[[-3.0, 3.0, -1.0], [3.0, -3.0, -1.0], [5.0, -1.0, -1.0], [-1.0, 5.0, -1.0]]"
    before, _, after = STRIP.partition("polygon")
    text = before + f"polygon = {polygon}\n" + after.partition("\n")[2]
    scene = parse_deck(
        text.replace("[2.0, 0.0, 0.0]", "[1.0, 1.0, 0.0]").replace("-1.0]", "0.5]") + PULLED, "strip.toml"
    )
    share = local_share(scene)
    assert default_extension(scene, share, scene.probes[0]) == share.mesh.mean_edge
    assert not list(doubtful_extensions(scene, share))


@pytest.mark.parametrize(
    ("before", "after", "sentence"),
    [
        ("direction = [2.0", "crack = 1\ndirection = [2.0", "probes.0.crack = 1 is not the number of a crack"),
        ("[2.0, 0.0, 0.0]", "[0.0, 0.0, 0.0]", "probes.0.direction = [0.0, 0.0, 0.0] has no direction"),
        ("[2.0, 0.0, 0.0]", "[2.0, 0.0, 1.0]", "ends at one corner of the crack. Give the normal of its straight"),
        ("youngs_modulus", "critical_stretch = 0.1\nyoungs_modulus", "compares two bodies that keep their bonds"),
    ],
)
def test_what_has_no_rate_is_told(before, after, sentence):
    with pytest.raises(pdfem.DeckError) as error:
        parse_deck(STRIP.replace("LENGTH", "3.0").replace(before, after) + PULLED, "strip.toml")
    assert sentence in str(error.value)
