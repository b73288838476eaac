"""Probes of stress at points, along lines and over sets, and what planes through a body carry."""

import csv

import numpy as np
import pytest

import pdfem_mpi as pdfem
from pdfem_mpi.deck.toml import parse_deck
from support.mesh_files import write_mesh
from support.mixed_cells import beside_crack

#: A bar of 8 x 2 x 2 cells, half of them bonds with fitted factors, pulled by 3 at each end.
BAR = """
[mesh]
kind = "box"
lower = [0.0, 0.0, 0.0]
upper = [8.0, 2.0, 2.0]
spacing = 1.0
[material]
youngs_modulus = 1000.0
[[regions]]
name = "fe"
model = "finite_elements"
upper = [4.0, 2.0, 2.0]
[[regions]]
name = "pd"
model = "peridynamics"
lower = [4.0, 0.0, 0.0]
[peridynamics]
kinematics = "linear"
surface_correction = "fitted"
[coupling]
kind = "exact"
[[loads]]
kind = "traction"
face = "x-"
total = [-3.0, 0.0, 0.0]
[[loads]]
kind = "traction"
face = "x+"
total = [3.0, 0.0, 0.0]
[solver]
kind = "cg"
tolerance = 1e-11
[output]
fields = false
figures = false
"""
#: The same without a fit.
ELASTIC = BAR.replace('"fitted"', '"virial"').replace('"exact"', '"paper"')
ELASTIC = ELASTIC.replace('kind = "traction"\nface = "x+"', 'kind = "body_force"\nface = "x+"')
LOAD, STRESS = 3.0, 0.75
#: Residual of 1e-11 of the load, over the body.
EQUILIBRIUM = 1e-9
PLACES = {"elements": 1.3, "overlap": 3.7, "interface": 4.0, "bonds": 5.9, "before the last cell": 7.0}


def cut(name, point, normal=(1.0, 0.0, 0.0)):
    return f'\n[[probes]]\nkind = "cut"\nname = "{name}"\npoint = {list(point)}\nnormal = {list(normal)}\n'


OUTSIDE = """
[[probes]]
kind = "displacement"
name = "a"
point = [8.5, 1.0, 1.0]
[[probes]]
kind = "point"
name = "b"
point = [1.0, 1.0, -3.0]
"""


@pytest.fixture(scope="module")
def bar():
    text = BAR + "".join(cut(name, (x, 0.5, 0.25)) for name, x in PLACES.items())
    text += cut("backwards", (5.9, 1.0, 1.0), (-2.0, 0.0, 0.0)) + cut("oblique", (4.2, 1.0, 1.0), (1.0, 0.4, -0.3))
    text += """
[[probes]]
kind = "point"
name = "inside"
point = [1.1, 0.9, 1.7]
fields = ["displacement", "stress", "von_mises"]
[[probes]]
kind = "set"
name = "bonds_together"
region = "pd"
fields = ["stress", "energy_density"]
[[probes]]
kind = "set"
name = "elements_together"
region = "fe"
"""
    simulation = pdfem.Simulation(parse_deck(text, "bar.toml"))
    simulation.solve(1.0)
    return simulation


@pytest.mark.parametrize("name", PLACES)
def test_a_cut_carries_the_load(bar, name):
    """Through elements, overlap, joint and bonds; the moment about a point beside the axis is the force's."""
    found = bar.probes()[name]
    np.testing.assert_allclose(found["force"], [LOAD, 0.0, 0.0], rtol=0, atol=EQUILIBRIUM * LOAD)
    lever = np.array([0.0, 0.5, 0.75])  # from the point to the axis of the bar
    np.testing.assert_allclose(found["moment"], np.cross(lever, [LOAD, 0.0, 0.0]), rtol=0, atol=EQUILIBRIUM * LOAD)


def test_a_cut_the_other_way_carries_the_opposite(bar):
    np.testing.assert_allclose(bar.probes()["backwards"]["force"], [-LOAD, 0.0, 0.0], rtol=0, atol=EQUILIBRIUM * LOAD)


def test_an_oblique_cut_carries_the_same(bar):
    found = bar.probes()["oblique"]
    np.testing.assert_allclose(found["force"], [LOAD, 0.0, 0.0], rtol=0, atol=EQUILIBRIUM * LOAD)
    np.testing.assert_allclose(found["moment"], np.zeros(3), rtol=0, atol=EQUILIBRIUM * LOAD)


def test_a_point_of_elements_has_the_stress_of_the_bar(bar):
    found = bar.probes()["inside"]
    np.testing.assert_allclose(found["stress"][0], [STRESS, 0, 0, 0, 0, 0], rtol=0, atol=EQUILIBRIUM)
    np.testing.assert_allclose(found["von_mises"], [[STRESS]], rtol=EQUILIBRIUM)


def test_sets_have_their_means(bar):
    found = bar.probes()
    uniform = [STRESS, 0, 0, 0, 0, 0]
    for word in ("mean", "smallest", "largest"):
        np.testing.assert_allclose(found["elements_together"]["stress"][word], uniform, rtol=0, atol=EQUILIBRIUM)
    mean = found["bonds_together"]["energy_density"]["mean"][0]
    assert mean == pytest.approx(0.5 * STRESS**2 / 1000.0, rel=0.1)  # one end of the bonds' body is within the overlap
    assert found["bonds_together"]["stress"]["smallest"][0] < STRESS < found["bonds_together"]["stress"]["largest"][0]


@pytest.mark.parametrize("symmetry", [("x-",), ("y-",), ("x-", "y-", "z+")])
def test_between_mirror_planes_a_cut_tells_what_a_side_knows(symmetry):
    """The force along x is that of the part; what a plane that both sides reach takes is not known."""
    text = BAR.replace("spacing = 1.0", f"spacing = 1.0\nsymmetry = {list(symmetry)}")
    text = text.replace('"fitted"', '"virial"').replace('"exact"', '"paper"')
    text = text.replace('kind = "traction"\nface = "x+"', 'kind = "body_force"\nface = "x+"')
    if "x-" in symmetry:
        text = text.replace('[[loads]]\nkind = "traction"\nface = "x-"\ntotal = [-3.0, 0.0, 0.0]\n', "")
    simulation = pdfem.Simulation(parse_deck(text + cut("a", (5.5, 0.0, 0.0)) + cut("b", (1.5, 0.0, 0.0)), "bar.toml"))
    simulation.solve(1.0)
    for name in ("a", "b"):
        force, moment = (simulation.probes()[name][word] for word in ("force", "moment"))
        assert force[0] == pytest.approx(LOAD, rel=EQUILIBRIUM)
        assert [value is None for value in force[1:]] == ["y-" in symmetry, "z+" in symmetry]
        assert [value is None for value in moment] == [
            "y-" in symmetry or "z+" in symmetry, "z+" in symmetry, "y-" in symmetry
        ]  # fmt: skip


def test_files_have_what_probes_read(tmp_path):
    text = (
        BAR
        + cut("middle", (5.9, 1.0, 1.0))
        + """
[[probes]]
kind = "line"
name = "axis"
start = [-1.0, 1.0, 1.0]
stop = [3.0, 1.0, 1.0]
n = 5
fields = ["displacement", "stress", "von_mises"]
[[probes]]
kind = "point"
name = "inside"
point = [1.1, 0.9, 1.7]
[stepping]
load_factors = [0.5, 1.0]
"""
    )
    folder = pdfem.run(parse_deck(text, "bar.toml"), tmp_path / "run")
    np.testing.assert_allclose(folder.history["middle.force_x"], [0.5 * LOAD, LOAD], rtol=EQUILIBRIUM)
    assert folder.summary["probes"]["middle"]["force"][0] == folder.history["middle.force_x"][-1]
    assert folder.summary["probes"]["inside"]["stress"][0] == pytest.approx(STRESS, rel=EQUILIBRIUM)
    line = folder.line("axis")
    np.testing.assert_allclose(line["stress_xx"][1:], STRESS, rtol=EQUILIBRIUM)
    assert np.isnan(line["stress_xx"][0]) and np.isnan(line["von_mises_value"][0])
    with open(folder.path / "lines" / "axis.csv", newline="", encoding="utf-8") as file:
        assert next(csv.reader(file))[8:] == [
            *(f"stress_{word}" for word in ("xx", "yy", "zz", "xy", "yz", "zx")), "von_mises_value"
        ]  # fmt: skip


def test_a_line_that_misses_the_body_is_left_empty(tmp_path):
    """No sample has a cell: stress is not known, and not 0."""
    probe = """
[[probes]]
kind = "line"
name = "beside"
start = [-3.0, 1.0, 1.0]
stop = [-1.0, 1.0, 1.0]
n = 3
fields = ["displacement", "stress"]
"""
    line = pdfem.run(parse_deck(ELASTIC + probe, "bar.toml"), tmp_path / "run").line("beside")
    for column in ("u_x", "stress_xx", "stress_zx"):
        assert len(line[column]) == 3 and np.isnan(line[column]).all()


def test_probes_read_the_cells_that_hold_their_places(tmp_path):
    """Above a crack of doubled nodes, in cells ten times as high as those below it."""
    write_mesh(tmp_path / "crack.vtu", beside_crack())
    deck = {
        "mesh": {"kind": "file", "path": str(tmp_path / "crack.vtu"), "doubled_nodes": "crack"},
        "material": {"youngs_modulus": 1000.0},
        "regions": [{"name": "all", "model": "finite_elements"}],
        "supports": [{"name": "held", "face": "y-", "x": 0.0, "y": 0.0, "z": 0.0}],
        "loads": [{"kind": "traction", "face": "y+", "traction": [0.0, 1.0, 0.0]}],
        "probes": [
            {"kind": "displacement", "name": "below", "point": [0.5, -0.1, 1.0]},
            {"kind": "displacement", "name": "above", "point": [0.5, 0.2, 1.0]},
            {"kind": "opening", "name": "mouth", "one": [0.5, -0.1, 1.0], "two": [0.5, 0.2, 1.0]},
            {"kind": "point", "name": "point", "point": [0.5, 0.2, 1.0]},
            {"kind": "line", "name": "line", "start": [0.5, 0.2, 1.0], "stop": [0.5, 1.2, 1.0], "n": 6,
             "fields": ["displacement", "stress"]},
        ],
        "output": {"fields": False, "figures": False},
    }  # fmt: skip
    folder = pdfem.run(pdfem.read_deck(deck), tmp_path / "run")
    u, line = folder.history["above.u_y"][-1], folder.line("line")
    assert u > 0.02 > 100.0 * abs(folder.history["below.u_y"][-1])
    assert folder.history["mouth.opening"][-1] == pytest.approx(u - folder.history["below.u_y"][-1], rel=1e-12)
    assert folder.summary["probes"]["point"]["displacement"][1] == pytest.approx(u, rel=1e-12)
    # a cell's displacement is a straight line along its height, and so is the stress through its Gauss points
    np.testing.assert_allclose(line["u_y"], u + np.linspace(0.0, line["u_y"][-1] - u, 6), rtol=1e-12)
    assert folder.summary["probes"]["point"]["stress"][1] == pytest.approx(line["stress_yy"][0], rel=1e-12)
    assert line["stress_yy"][0] != 0.0
    np.testing.assert_allclose(np.diff(line["stress_yy"], n=2), 0.0, atol=1e-12)


def test_displacements_just_outside_are_those_of_the_nearest_place(tmp_path):
    """A chord of a curved surface lies below it; farther out than that it is refused, and stresses are at once."""
    two = "".join(
        f'\n[[probes]]\nkind = "displacement"\nname = "{name}"\npoint = [{x}, 1.3, 0.7]\n'
        for name, x in (("a", 8.0), ("b", 8.2))
    )
    history = pdfem.run(parse_deck(ELASTIC + two, "bar.toml"), tmp_path / "run").history
    assert history["b.u_x"][-1] == pytest.approx(history["a.u_x"][-1], rel=1e-12) != 0.0
    for kind in ("displacement", "point"):
        far = 8.3 if kind == "displacement" else 8.01
        probe = f'\n[[probes]]\nkind = "{kind}"\nname = "a"\npoint = [{far}, 1.0, 1.0]\n'
        with pytest.raises(pdfem.SceneError, match="lies outside of the body, 0"):
            pdfem.Simulation(parse_deck(ELASTIC + probe, "bar.toml"))


@pytest.mark.parametrize(
    ("probe", "sentence"),
    [
        (cut("a", (9.0, 0.0, 0.0)), "probes.0 cuts nothing: all of the body, from (0, 0, 0) to (8, 2, 2)"),
        (cut("a", (1.0, 0.0, 0.0), (0.0, 0.0, 0.0)), "probes.0.normal = [0.0, 0.0, 0.0] has no direction"),
        ('\n[[probes]]\nkind = "point"\nname = "a"\npoint = [1.0, 1.0, 1.0]\nfields = ["strain", "mises"]\n',
         'probes.0.fields has "mises", which is not a field. Did you mean von_mises?'),
        ('\n[[probes]]\nkind = "set"\nname = "a"\nregion = "pe"\n', 'probes.0.region = "pe" is not the name of'),
        ('\n[[probes]]\nkind = "set"\nname = "a"\nregion = "pd"\nfields = []\n', "probes.0.fields = [] is not a list"),
        ('\n[[probes]]\nkind = "set"\nname = "a"\nlower = [9.0, 0.0, 0.0]\nupper = [10.0, 1.0, 1.0]\n',
         "probes.0 selects no cell of the mesh"),
        (OUTSIDE, "probes.0.point = [8.5, 1.0, 1.0] lies outside of the body, 0.5 away from it. Give a point inside of "
                  "it or on its surface.\nprobes.1.point = [1.0, 1.0, -3.0] lies outside of the body, 3 away from it."),
    ],
)  # fmt: skip
def test_probes_that_meet_nothing_are_told(probe, sentence):
    with pytest.raises(pdfem.SceneError) as error:
        pdfem.Simulation(parse_deck(ELASTIC + probe, "bar.toml"))
    assert sentence in str(error.value)
