"""Thermal strain: free bodies expand without stress, held ones have E alpha dT, in elements and in bonds."""

import numpy as np
import pytest

import pdfem_mpi as pdfem
from pdfem_mpi.deck.toml import parse_deck

E, ALPHA, CHANGE = 1000.0, 2e-5, 50.0
HELD = E * ALPHA * CHANGE
#: Of the stress of a bar that is held: residuals of 1e-12 of the thermal forces.
ROUND_OFF = 1e-9

BODIES = {
    "elements": ("none", "paper", 6.0),
    "bonds, virial": ("virial", "paper", 0.0),
    "bonds, fitted": ("fitted", "exact", 0.0),
    "coupled, paper": ("virial", "paper", 3.0),
    "coupled, both": ("virial", "paper_a", 3.0),
    "coupled, exact": ("fitted", "exact", 3.0),
}


def deck(body, supports="", more="", temperature=f"change = {CHANGE}", solver="cg", symmetry="[]", ratio=0.25):
    correction, coupling, middle = BODIES[body]
    regions = ""
    if middle > 0.0:
        regions += f'[[regions]]\nname = "fe"\nmodel = "finite_elements"\nupper = [{middle}, 2.0, 2.0]\n'
    if middle < 6.0:
        regions += f'[[regions]]\nname = "pd"\nmodel = "peridynamics"\nlower = [{middle}, 0.0, 0.0]\n'
    return f"""
[mesh]
kind = "box"
lower = [0.0, 0.0, 0.0]
upper = [6.0, 2.0, 2.0]
spacing = 1.0
symmetry = {symmetry}
[material]
youngs_modulus = {E}
poissons_ratio = {ratio}
thermal_expansion = {ALPHA}
{regions}
[peridynamics]
kinematics = "linear"
surface_correction = "{correction}"
[coupling]
kind = "{coupling}"
[temperature]
{temperature}
{supports}
[solver]
kind = "{solver}"
tolerance = 1e-11
{more}
"""


def solved(text, factor=1.0):
    simulation = pdfem.Simulation(parse_deck(text, "bar.toml"))
    simulation.solve(factor)
    return simulation, simulation.fields("stress", "strain", "energy_density")


@pytest.mark.parametrize(
    ("body", "ratio"),
    [
        *((body, 0.25) for body in BODIES),
        ("bonds, virial", 0.4),
        ("coupled, paper", 0.1),
        ("bonds, fitted", 0.4),
        ("coupled, exact", 0.1),
    ],
)
def test_a_free_body_expands_without_stress(body, ratio):
    """Whatever the correction, the coupling and Poisson's ratio."""
    simulation, fields = solved(deck(body, ratio=ratio), 0.5)
    strain = np.array([0.5 * ALPHA * CHANGE] * 3 + [0.0] * 3)
    for found in (fields.of_points, fields.of_cells):
        if found:
            assert np.abs(found["stress"]).max() <= ROUND_OFF * HELD
            np.testing.assert_allclose(found["strain"], np.tile(strain, (len(found["strain"]), 1)), rtol=0,
                                       atol=ROUND_OFF * ALPHA * CHANGE)  # fmt: skip
    for u, x in ((fields.u_nodes, simulation.nodes), (fields.u_points, simulation.points)):
        if u is not None:
            middle = np.array([3.0, 1.0, 1.0])
            np.testing.assert_allclose(u, strain[0] * (x - middle), rtol=0, atol=ROUND_OFF * 6.0 * ALPHA * CHANGE)


@pytest.mark.parametrize("body", ["elements", "coupled, exact"])
def test_a_clamped_bar_has_the_stress_of_its_strain(body):
    """Ends of elements that do not move along the bar; between them elements, or bonds with fitted factors."""
    cuts = "".join(
        f'\n[[probes]]\nkind = "cut"\nname = "at {x}"\npoint = [{x}, 1.0, 1.0]\nnormal = [1.0, 0.0, 0.0]\n'
        for x in (0.5, 3.0, 3.5)
    )
    ends = '[[supports]]\nface = "x-"\nx = 0.0\n[[supports]]\nface = "x+"\nx = 0.0\n'
    text = deck(body, ends, cuts)
    if body != "elements":
        first, last = (
            f'[[regions]]\nname = "{name}"\nmodel = "finite_elements"\n'
            f"lower = [{low}, 0.0, 0.0]\nupper = [{high}, 2.0, 2.0]\n"
            for name, low, high in (("first", 0.0, 2.0), ("last", 4.0, 6.0))
        )
        bonds = '[[regions]]\nname = "pd"\nmodel = "peridynamics"\nlower = [2.0, 0.0, 0.0]\nupper = [4.0, 2.0, 2.0]\n'
        text = text[: text.index("[[regions]]")] + first + bonds + last + text[text.index("[peridynamics]") :]
    simulation, fields = solved(text)
    for found in simulation.probes().values():
        np.testing.assert_allclose(found["force"], [-4.0 * HELD, 0.0, 0.0], rtol=0, atol=4.0 * ROUND_OFF * HELD)
    row = simulation.solve(1.0)
    assert row["reaction"] == pytest.approx(4.0 * HELD, rel=ROUND_OFF)
    expected = np.tile([-HELD, 0, 0, 0, 0, 0], (len(fields.of_cells["stress"]), 1))
    np.testing.assert_allclose(fields.of_cells["stress"], expected, rtol=0, atol=ROUND_OFF * HELD)


def test_a_bar_that_is_held_in_one_direction_has_its_stress_at_every_load():
    """Mirror planes across x: the strain along x is none, the stress E alpha dT; at half the load half of it."""
    for factor in (1.0, -0.5):
        _, fields = solved(deck("elements", symmetry='["x-", "x+"]'), factor)
        expected = np.tile([-factor * HELD, 0, 0, 0, 0, 0], (24, 1))
        np.testing.assert_allclose(fields.of_cells["stress"], expected, rtol=0, atol=ROUND_OFF * HELD)
        energy = 0.5 * (factor * HELD) ** 2 / E
        np.testing.assert_allclose(fields.of_cells["energy_density"], energy, rtol=ROUND_OFF)


def test_relaxation_finds_the_same():
    _, found = solved(deck("coupled, paper", solver="adr").replace("1e-11", "1e-8"))
    _, expected = solved(deck("coupled, paper"))
    np.testing.assert_allclose(found.u_nodes, expected.u_nodes, rtol=0, atol=1e-6 * np.abs(expected.u_nodes).max())
    assert np.abs(found.of_points["stress"]).max() <= 1e-5 * HELD


def write_vtu(path, points, values, name="T"):
    """Points and a field as text, without cells."""
    numbers = " ".join(repr(float(c)) for c in points.reshape(-1))
    path.write_text(
        f'<VTKFile type="UnstructuredGrid" version="0.1"><UnstructuredGrid><Piece NumberOfPoints="{len(points)}" '
        f'NumberOfCells="0"><PointData><DataArray type="Float64" Name="{name}" format="ascii">'
        f'{" ".join(repr(float(v)) for v in values)}</DataArray></PointData><Points><DataArray type="Float64" '
        f'NumberOfComponents="3" format="ascii">{numbers}</DataArray></Points></Piece></UnstructuredGrid></VTKFile>'
    )


def from_file(path, field="T"):
    return f'file = "{path}"\nfield = "{field}"\nreference = 20.0'


def test_a_file_of_equal_temperatures_is_a_constant_change(tmp_path):
    """Nodes of the file in another order; a field that varies bends the bar."""
    simulation, expected = solved(deck("coupled, paper"))
    nodes = simulation.share.mesh.nodes
    order = np.random.default_rng(0).permutation(len(nodes))
    write_vtu(tmp_path / "same.vtu", nodes[order], np.full(len(nodes), CHANGE + 20.0))
    _, found = solved(deck("coupled, paper", temperature=from_file(tmp_path / "same.vtu")))
    np.testing.assert_allclose(found.u_nodes, expected.u_nodes, rtol=0, atol=1e-13)
    write_vtu(tmp_path / "bent.vtu", nodes[order], 20.0 + CHANGE * (nodes[order, 2] - 1.0))
    _, bent = solved(deck("elements", temperature=from_file(tmp_path / "bent.vtu")))
    x, u = simulation.share.mesh.nodes, bent.u_nodes
    # a bar under a linear temperature bends freely: u_z = -alpha dT' x^2 / 2 along its axis
    axis = (x[:, 1] == 1.0) & (x[:, 2] == 1.0)
    curvature = np.polyfit(x[axis, 0], u[axis, 2], 2)[0]
    assert curvature == pytest.approx(-0.5 * ALPHA * CHANGE, rel=0.1)  # elements in bending are stiff


def test_a_formula_is_the_field_of_its_values(tmp_path):
    """A temperature that is linear in z, by a formula and by nodes."""
    nodes = pdfem.Simulation(parse_deck(deck("coupled, paper"), "bar.toml")).share.mesh.nodes
    write_vtu(tmp_path / "t.vtu", nodes, 20.0 + CHANGE * (nodes[:, 2] - 1.0))
    _, expected = solved(deck("coupled, paper", temperature=from_file(tmp_path / "t.vtu")))
    _, found = solved(deck("coupled, paper", temperature=f'formula = "{CHANGE} * (z - 1)"'))
    np.testing.assert_allclose(found.u_nodes, expected.u_nodes, rtol=0, atol=1e-9 * np.abs(expected.u_nodes).max())
    with pytest.raises(pdfem.SceneError, match="is not finite at"):
        pdfem.Simulation(parse_deck(deck("elements", temperature='formula = "log(x - 3)"'), "bar.toml"))


@pytest.mark.parametrize(
    ("temperature", "sentence"),
    [
        ("", "temperature must have exactly one of change, formula and file, and has none"),
        ('formula = "20 * q"', "temperature.formula"),
        ('formula = "20 * f"', "has f, and the change grows with the load factor by itself"),
        ('file = "a.txt"', "is not a .vtu file"),
        ("change = 1.0\nreference = 3.0", "temperature.reference = 3.0 is subtracted from a file's temperatures"),
    ],
)
def test_wrong_tables_are_told(temperature, sentence):
    with pytest.raises(pdfem.DeckError) as error:
        parse_deck(deck("elements", temperature=temperature), "bar.toml")
    assert sentence in str(error.value)


def test_temperatures_that_strain_nothing_or_what_cannot_be_strained_are_told():
    for text, sentence in (
        (deck("elements").replace(f"thermal_expansion = {ALPHA}\n", ""), "no material has a coefficient of expansion"),
        (deck("bonds, virial").replace('kinematics = "linear"', 'kinematics = "finite"'), "linear kinematics alone"),
        (deck("bonds, virial").replace("thermal_exp", "critical_stretch = 0.01\nthermal_exp"), "breaks bonds by their"),
    ):
        with pytest.raises(pdfem.DeckError) as error:
            parse_deck(text, "bar.toml")
        assert sentence in str(error.value)


def test_files_of_another_mesh_are_told(tmp_path):
    nodes = pdfem.Simulation(parse_deck(deck("elements"), "bar.toml")).share.mesh.nodes
    write_vtu(tmp_path / "t.vtu", nodes * 1.01, np.zeros(len(nodes)))
    for temperature, sentence in (
        (from_file(tmp_path / "t.vtu"), "is on another mesh: 62 of 63 nodes have no point of the file"),
        (from_file(tmp_path / "t.vtu", "TT"), 'has no point data "TT"; it has T.'),
        (from_file(tmp_path / "none.vtu"), "cannot be read: No such file"),
    ):
        with pytest.raises(pdfem.SceneError) as error:
            pdfem.Simulation(parse_deck(deck("elements", temperature=temperature), "bar.toml"))
        assert sentence in str(error.value)


def test_the_displacement_of_loads_is_theirs_alone():
    """Ends that are pulled apart and expand: their mean distance, to which strains of the middle give nothing."""
    pull = "".join(
        f'\n[[loads]]\nkind = "body_force"\nface = "{face}"\ntotal = [{sign}4.0, 0.0, 0.0]\n'
        for face, sign in (("x-", "-"), ("x+", ""))
    )
    simulation = pdfem.Simulation(parse_deck(deck("bonds, virial", pull), "bar.toml"))
    row, fields, x = simulation.solve(0.5), simulation.fields(), simulation.points[:, 0]
    longer = fields.u_points[x > 5.0, 0].mean() - fields.u_points[x < 1.0, 0].mean()
    assert row["displacement"] == pytest.approx(longer, rel=ROUND_OFF)


def test_interfaces_that_break_are_told():
    text = (
        deck("bonds, virial")
        .replace(
            "[peridynamics]",
            '[[interfaces]]\nbetween = ["default", "steel"]\nfracture_energy = 1.0\n[materials.steel]\n'
            'youngs_modulus = 2000.0\n[[regions]]\nname = "end"\nmodel = "peridynamics"\nmaterial = "steel"\n'
            "lower = [4.0, 0.0, 0.0]\nupper = [6.0, 2.0, 2.0]\n[peridynamics]",
        )
        .replace("lower = [0.0, 0.0, 0.0]\n[[int", "lower = [0.0, 0.0, 0.0]\nupper = [4.0, 2.0, 2.0]\n[[int")
    )
    with pytest.raises(pdfem.DeckError) as error:
        parse_deck(text, "bar.toml")
    assert "interfaces.0.fracture_energy breaks bonds by their whole stretch" in str(error.value)
