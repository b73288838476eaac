"""Bodies of one stiffness among the cells with bonds, and the cells that join them."""

import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.fitted_bodies import same_bonds
from pdfem_mpi.body.materials import material_table
from pdfem_mpi.deck.materials import Interface, Material
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import SceneError
from support.bodies import make_scene

SOFT = {"soft": Material(youngs_modulus=100.0)}


def bodies(cells, regions, materials=SOFT, overlap=1, **options):
    """The discretization of a fitted scene: model and material of its regions, by the largest x of each."""
    y, z = float(cells[1]), float(cells[2])
    made, start = [], 0.0
    for k, (model, material, end) in enumerate(regions):
        made.append(
            Region(name=f"r{k}", model=model, material=material, lower=(start, 0.0, 0.0), upper=(float(end), y, z))
        )
        start = float(end)
    scene = make_scene(
        cells, regions=tuple(made), materials=materials, correction="fitted", coupling="exact", overlap=overlap,
        loads=(), **options,
    )  # fmt: skip
    return discretize(scene)


def along_x(values, cells):
    """Values of the layers along x; all cells of a layer have the same."""
    layers = values.reshape(cells[::-1])
    assert (layers == layers[0, 0]).all()
    return layers[0, 0].tolist()


ELEMENTS, BONDS = "finite_elements", "peridynamics"


@pytest.mark.parametrize(
    ("regions", "overlap", "body", "tied", "stiffness"),
    [
        # one body, the overlap on the elements' side
        ([(ELEMENTS, "default", 3), (BONDS, "default", 8)], 1, "--000000", "--+-----", "EE------"),
        ([(ELEMENTS, "default", 3), (BONDS, "default", 8)], 2, "-0000000", "-++-----", "E-------"),
        # elements of another stiffness: the overlap lies in the bonds' cells
        ([(ELEMENTS, "soft", 3), (BONDS, "default", 8)], 1, "---00000", "---+----", "EEE-----"),
        ([(ELEMENTS, "soft", 3), (BONDS, "default", 8)], 2, "---00000", "---+----", "EEE-----"),
        # two bodies, one layer of each at their common face
        ([(BONDS, "default", 4), (BONDS, "soft", 8)], 1, "00001111", "---++---", "--------"),
        ([(ELEMENTS, "default", 2), (BONDS, "default", 5), (BONDS, "soft", 8)], 1, "-0000111", "-+--++--", "E-------"),
        ([(BONDS, "soft", 2), (BONDS, "default", 5), (BONDS, "soft", 8)], 1, "00111222", "-++-++--", "--------"),
    ],
)  # fmt: skip
def test_bodies_and_joints_of_a_bar(regions, overlap, body, tied, stiffness):
    cells = (8, 2, 2)
    found = bodies(cells, regions, SOFT if any(r[1] == "soft" for r in regions) else {}, overlap)
    assert along_x(found.body, cells) == [-1 if c == "-" else int(c) for c in body]
    assert along_x(found.is_overlap, cells) == [c == "+" for c in tied]
    assert along_x(found.has_stiffness, cells) == [c == "E" for c in stiffness]
    assert along_x(found.has_points, cells) == [c != "-" for c in body]
    assert not len(found.thin)


def test_elements_at_which_a_body_would_be_thin_stay_elements():
    """Beside soft bonds, an overlap layer of the hard bonds' material would be a flap of one cell."""
    regions = (
        Region(name="elements", model=ELEMENTS, upper=(3.0, 2.0, 5.0)),
        Region(name="hard", model=BONDS, lower=(3.0, 0.0, 0.0), upper=(6.0, 2.0, 2.0)),
        Region(name="soft", model=BONDS, material="soft", lower=(3.0, 0.0, 2.0)),
    )
    found = discretize(
        make_scene((6, 2, 5), regions=regions, materials=SOFT, correction="fitted", coupling="exact", loads=())
    )
    layer = found.body.reshape(5, 2, 6)[:, 0]
    np.testing.assert_array_equal(layer[:2], 2 * [[-1, -1, 0, 0, 0, 0]])
    np.testing.assert_array_equal(layer[2:], 3 * [[-1, -1, -1, 1, 1, 1]])
    tied = found.is_overlap.reshape(5, 2, 6)[:, 0]
    np.testing.assert_array_equal(tied[2:, 3:], [[True] * 3, [True, False, False], [True, False, False]])
    np.testing.assert_array_equal(tied[1, 2:], [True] * 4)
    np.testing.assert_array_equal(tied[0, 2:], [True, False, False, False])


def test_a_thin_body_leaves_the_scene_as_it_is_without_a_fit():
    found = bodies((6, 2, 2), [(ELEMENTS, "soft", 2), (BONDS, "default", 5), (BONDS, "soft", 6)])
    assert len(found.thin) == 4 and found.n_bodies == 1
    assert along_x(found.is_overlap, (6, 2, 2)) == [False, True, False, False, False, False]


def test_elements_beside_a_body_may_have_another_poissons_ratio():
    """They keep no points; with other corrections the overlap of such a material is refused."""
    other = {"other": Material(youngs_modulus=1000.0, poissons_ratio=0.3)}
    found = bodies((6, 2, 2), [(ELEMENTS, "other", 3), (BONDS, "default", 6)], other)
    assert along_x(found.is_overlap, (6, 2, 2)) == [False, False, False, True, False, False]
    regions = (
        Region(name="elements", model=ELEMENTS, material="other", upper=(3.0, 2.0, 2.0)),
        Region(name="bonds", model=BONDS, lower=(3.0, 0.0, 0.0)),
    )
    with pytest.raises(SceneError, match=r"has a Poisson's ratio of 0\.3, and 4 of its cells are in the overlap"):
        discretize(make_scene((6, 2, 2), regions=regions, materials=other, correction="virial", loads=()))


def test_materials_whose_bonds_are_alike():
    """Equal moduli are not enough where a table gives the bonds between them another one."""
    materials = {
        "weak": Material(youngs_modulus=1000.0, critical_stretch=1e-3),
        "soft": Material(youngs_modulus=100.0),
        "apart": Material(youngs_modulus=1000.0),
        "turned": Material(youngs_modulus=1000.0, poissons_ratio=0.3),
    }
    interfaces = (Interface(between=("apart", "default"), youngs_modulus=10.0),)
    regions = tuple(
        Region(name=name, model=BONDS if name != "turned" else ELEMENTS, material=name, upper=(1.0, 1.0, 1.0))
        for name in ("default", *materials)
    )
    scene = make_scene((2, 2, 2), regions=regions, materials=materials, interfaces=interfaces, loads=())
    table = material_table(scene)
    number = dict(zip(table.names, same_bonds(table).tolist(), strict=True))
    assert number["default"] == number["weak"] and number["weak"] != number["soft"]
    assert number["default"] not in (number["apart"], number["turned"])


def test_materials_set_apart_by_a_table_are_never_of_one_number():
    """Also where both are like a third one: bonds of another modulus would run within a body."""
    materials = {"one": Material(youngs_modulus=1000.0), "two": Material(youngs_modulus=1000.0)}
    interfaces = (Interface(between=("one", "two"), youngs_modulus=10.0),)
    regions = tuple(
        Region(name=name, model=BONDS, material=name, upper=(1.0, 1.0, 1.0)) for name in ("default", *materials)
    )
    scene = make_scene((2, 2, 2), regions=regions, materials=materials, interfaces=interfaces, loads=())
    assert same_bonds(material_table(scene)).tolist() == [0, 0, 1]


def test_one_layer_of_elements_of_another_stiffness_is_enough():
    """They take no part in the overlap, so that elements are left; with other corrections, and alike, none would be."""
    found = bodies((6, 2, 2), [(ELEMENTS, "soft", 1), (BONDS, "default", 6)])
    assert along_x(found.has_stiffness, (6, 2, 2)) == [True] + 5 * [False]
    assert along_x(found.is_overlap, (6, 2, 2)) == [False, True] + 4 * [False]
    for material, table in (("soft", SOFT), ("default", {})):
        with pytest.raises(SceneError, match="leaves no finite element outside the overlap"):
            # a single layer of bonds is too thin for a fit, and the overlap of other corrections holds
            bodies((2, 2, 2), [(ELEMENTS, material, 1), (BONDS, "default", 2)], table)


def upright(x, top):
    """A crack across a bar at x, from below up to a height."""
    return Crack(polygon=((x, -1.0, -1.0), (x, 9.0, -1.0), (x, 9.0, top), (x, -1.0, top)))


@pytest.mark.parametrize(
    ("crack", "n_cells"),
    [(upright(4.0, 9.0), 8), (upright(3.5, 9.0), 4), (upright(4.4, 9.0), 4), (upright(3.5, 1.2), 2)],
    ids=["along the joint", "through its cells", "through those of the other body", "up to half of it"],
)
def test_cracks_through_joints_are_refused(crack, n_cells):
    """No bond runs across, and points of joints follow common nodes: the crack would be closed without a word."""
    expected = rf"cracks\.0 passes through {n_cells} cells .* \"virial\""
    with pytest.raises(SceneError, match=expected):
        bodies((8, 2, 2), [(BONDS, "default", 4), (BONDS, "soft", 8)], cracks=(crack,))
    with pytest.raises(SceneError, match="2 cells by which"):
        side = Crack(polygon=((3.0, 1.0, -1.0), (3.9, 1.0, -1.0), (3.9, 1.0, 0.9), (3.0, 1.0, 0.9)))
        bodies((8, 2, 2), [(BONDS, "default", 4), (BONDS, "soft", 8)], cracks=(side,))


@pytest.mark.parametrize("x", [2.5, 3.0, 5.0, 5.5])
def test_cracks_beside_joints_are_not(x):
    """In one body alone, up to the cells that join it."""
    found = bodies((8, 2, 2), [(BONDS, "default", 4), (BONDS, "soft", 8)], cracks=(upright(x, 9.0),))
    assert found.n_bodies == 2


def test_cracks_in_the_overlap_of_one_body_are_as_with_other_corrections():
    found = bodies((8, 2, 2), [(ELEMENTS, "default", 4), (BONDS, "default", 8)], {}, cracks=(upright(3.5, 9.0),))
    assert found.n_bodies == 1
