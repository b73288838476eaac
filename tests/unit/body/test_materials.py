"""Several materials in one scene: what holds for their bonds and elements, and what a deck may not say."""

import numpy as np
import pytest

from pdfem_mpi.body.discretization import discretize
from pdfem_mpi.body.materials import bond_materials, bond_stretches, material_table
from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.materials import Interface, Material
from pdfem_mpi.deck.outputs import BarProbe
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.table import DeckError, SceneError
from pdfem_mpi.deck.toml import parse_deck, write_deck
from pdfem_mpi.finite_elements import elements as elements_module
from pdfem_mpi.kernels.correction_sweeps import INFINITE_RESPONSE
from pdfem_mpi.measure.bar import bar_results, measure_bar
from pdfem_mpi.model.model import build_intact_elements
from pdfem_mpi.peridynamics.bonds import count_by_material
from pdfem_mpi.peridynamics.clusters import cluster_layout, point_rows
from pdfem_mpi.peridynamics.critical_stretches import UNBREAKABLE, critical_stretches
from pdfem_mpi.peridynamics.point_blocks import point_blocks
from pdfem_mpi.solvers.preconditioner import blocks, grid_stiffness
from pdfem_mpi.solvers.preconditioner.coarse_grid import make_grid
from support.bodies import YOUNGS_MODULUS, build, fields_of_positions, geometry_of, local_share, make_scene

FE, PD = "finite_elements", "peridynamics"
CELLS = 6, 2, 2
SINGLE = 1e-6  # relative, of sums of numbers stored in single precision
CORRECTED = 0.07  # remaining after twenty sweeps, in a body two cells thick: 0.068
PINNED = 1e-5  # relative: pins of 1e-8 of the diagonal, and moments rounded to 1e-12


def halves(first=PD, second=PD, cells=CELLS, at=None):
    """Regions along x, of the default material and of the material "other"."""
    x = float(cells[0] // 2 if at is None else at)
    return (
        Region(name="first", model=first, upper=(x, float(cells[1]), float(cells[2]))),
        Region(name="second", model=second, material="other", lower=(x, 0.0, 0.0)),
    )


def scene_of(contrast, first=PD, second=PD, cells=CELLS, at=None, nu=0.25, other=None, **options):
    """A body whose second half has ``contrast`` times the Young's modulus of the first."""
    other = other or Material(youngs_modulus=contrast * YOUNGS_MODULUS, poissons_ratio=nu)
    options = {"loads": (), "regions": halves(first, second, cells, at), "materials": {"other": other}} | options
    return make_scene(cells, **options)


# --- what holds for the bonds between two materials -------------------------------------------------------


def three_materials(*interfaces):
    """Default, softer and stiffer."""
    regions = tuple(
        Region(name=name, model=PD, material=name, lower=(2.0 * k, 0.0, 0.0), upper=(2.0 * k + 2.0, 2.0, 2.0))
        for k, name in enumerate(("default", "soft", "stiff"))
    )
    materials = {"soft": Material(youngs_modulus=250.0), "stiff": Material(youngs_modulus=8000.0)}
    return make_scene(CELLS, loads=(), regions=regions, materials=materials, interfaces=interfaces)


def test_bonds_across_take_the_softer_side():
    """Sec. 2.1: "utilizes the material properties of the region having the smaller bulk modulus"."""
    table = material_table(three_materials())
    assert table.names == ("default", "soft", "stiff")
    np.testing.assert_array_equal(table.youngs_modulus, [1.0, 0.25, 8.0])
    np.testing.assert_array_equal(table.bond_modulus, [[1.0, 0.25, 1.0], [0.25, 0.25, 0.25], [1.0, 0.25, 8.0]])


def test_an_interface_has_values_of_its_own():
    """In either order of its two names; other pairs keep the rule."""
    interface = Interface(between=("stiff", "default"), youngs_modulus=3000.0)
    table = material_table(three_materials(interface))
    np.testing.assert_array_equal(table.bond_modulus, [[1.0, 0.25, 3.0], [0.25, 0.25, 0.25], [3.0, 0.25, 8.0]])


def test_the_softer_copy_holds_where_an_interface_gives_the_modulus():
    """Of sides of one shear modulus and two Poisson's ratios, whatever their order in the deck."""
    moduli = []
    for nus in ((0.0, 0.25), (0.25, 0.0)):
        default, other = (Material(youngs_modulus=1000.0 * (1.0 + nu), poissons_ratio=nu) for nu in nus)
        interface = Interface(between=("default", "other"), youngs_modulus=500.0)
        scene = scene_of(1.0, other=other, interfaces=(interface,)).model_copy(update={"material": default})
        moduli.append({side.modulus_of_bonds for side in bond_materials(scene)[0][1]})
    softer = min(Material(youngs_modulus=500.0, poissons_ratio=nu).modulus_of_bonds for nu in (0.0, 0.25))
    assert moduli == [{softer}, {softer}]


FAILING = {"soft": {"critical_stretch": 0.02}, "tough": {"fracture_energy": 50.0}}


def failing_scene(softer, *interfaces, contrast=4.0, **options):
    """Two materials with different ways to say when they fail; the softer is the default."""
    names = ["soft", "tough"] if softer == "soft" else ["tough", "soft"]
    default, other = (FAILING[name] for name in names)
    scene = scene_of(
        contrast, other=Material(youngs_modulus=contrast * YOUNGS_MODULUS, **other), interfaces=interfaces, **options
    )
    return scene.model_copy(update={"material": Material(youngs_modulus=YOUNGS_MODULUS, **default)})


@pytest.mark.parametrize("softer", FAILING)
def test_failure_across_is_that_of_the_softer_side(softer):
    """Its critical stretch, given or from its fracture energy, on both sides of the table."""
    scene = failing_scene(softer)
    found = bond_stretches(scene, 1.0, 2.5)
    own = scene.material.stretch_at_failure(1.0, 2.5)
    other = scene.materials["other"].stretch_at_failure(1.0, 2.5)
    np.testing.assert_array_equal(found, [[own, own], [own, other]])
    assert own != other


def test_of_two_equal_moduli_the_weaker_decides_across():
    """They have one response; only when it ends differs."""
    for softer in FAILING:
        scene = failing_scene(softer, contrast=1.0)
        found = bond_stretches(scene, 1.0, 2.5)
        assert found[0, 1] == found[1, 0] == min(found[0, 0], found[1, 1])


def test_an_interface_may_fail_earlier():
    """A critical stretch in the place of the softer side's fracture energy, its modulus kept."""
    scene = failing_scene("tough", Interface(between=("default", "other"), critical_stretch=1e-4))
    assert bond_stretches(scene, 1.0, 2.5)[0, 1] == 1e-4
    assert bond_materials(scene)[1][0][0].youngs_modulus == YOUNGS_MODULUS


def test_critical_stretches_by_region():
    """Infinity where a material does not fail, and where a region may not."""
    scene = scene_of(2.0, other=Material(youngs_modulus=2000.0, critical_stretch=0.01))
    body = local_share(scene)
    own = body.units.numbers(0.01)
    np.testing.assert_array_equal(critical_stretches(scene, body), [[UNBREAKABLE, UNBREAKABLE], [UNBREAKABLE, own]])
    stiff = scene_of(0.5, other=Material(youngs_modulus=500.0, critical_stretch=0.01))
    np.testing.assert_array_equal(critical_stretches(stiff, body), [[UNBREAKABLE, own], [own, own]])
    held = tuple(r.model_copy(update={"may_fail": r.name != "second"}) for r in stiff.regions)
    assert (critical_stretches(stiff.model_copy(update={"regions": held}), body) == UNBREAKABLE).all()


# --- bonds and their correction --------------------------------------------------------------------------


def reference_forces(body, u):
    """Linear forces of all pairs of points within the cutoff, summed one by one (eqs 2, 9)."""
    table, model = body.share.materials, body.model
    x, volume = point_rows(model.points.x), model.points.volume
    material = np.repeat(model.points.material, 8)
    force = np.zeros_like(x)
    counts = np.zeros((2, 2), np.int64)
    for i in range(len(x)):
        xi = x[i + 1 :] - x[i]
        r = np.sqrt((xi**2).sum(axis=1))
        near = r <= body.share.cutoff
        c = 6.0 / np.pi * table.bond_modulus[material[i], material[i + 1 :]]  # 9 k / pi with k = 2 E / 3
        stretch = ((u[i + 1 :] - u[i]) * xi).sum(axis=1) / r**2
        size = np.where(near, c * np.exp(-(r**2)) * stretch * volume[i] * volume[i + 1 :] / r, 0.0)
        force[i] += (size[:, None] * xi).sum(axis=0)
        force[i + 1 :] -= size[:, None] * xi
        np.add.at(counts, (material[i], material[i + 1 :][near]), 1)
    return force, counts


@pytest.mark.nojit
@pytest.mark.parametrize("across", [None, 3000.0], ids=["softer side", "own values"])
def test_bonds_of_two_materials_by_hand(across):
    """Every bond has the constant of its pair of materials; every pair of materials its bonds."""
    interfaces = () if across is None else (Interface(between=("default", "other"), youngs_modulus=across),)
    body = build(scene_of(7.0, cells=(3, 1, 1), at=1, correction="none", interfaces=interfaces), loaded=False)
    u = np.random.default_rng(5).standard_normal((24, 3)) * 1e-3
    expected, counts = reference_forces(body, u)
    found = body.internal(cluster_layout(u.reshape(-1, 8, 3)))
    np.testing.assert_allclose(point_rows(found), expected, atol=SINGLE * np.abs(expected).max())
    both = counts[0, 1] + counts[1, 0]
    np.testing.assert_array_equal(
        count_by_material(body.model.comm, body.model.bonds), [[counts[0, 0], both], [both, counts[1, 1]]]
    )


@pytest.mark.parametrize("n_elements", [0, 3, 6], ids=["peridynamics", "coupled", "elements"])
def test_materials_of_one_modulus_are_one_material(n_elements):
    """The same bits with the second half called otherwise."""
    models = (FE if n_elements else PD, FE if n_elements > 3 else PD)
    scenes = make_scene(CELLS, n_elements, loads=()), scene_of(1.0, *models)
    one, two = (build(scene, loaded=False) for scene in scenes)
    u = np.random.default_rng(2).standard_normal(one.model.n_unknowns)
    np.testing.assert_array_equal(one.internal(u), two.internal(u))
    np.testing.assert_array_equal(one.model.mass, two.model.mass)


def responses(body):
    """``G_d`` of all points with the corrected bonds (A2)-(A4), float64, shape (n, 3)."""
    points = body.model.points
    x, total = point_rows(points.x), np.zeros((len(points.volume), 3))
    for rows in body.model.bonds.rows:
        slot = np.flatnonzero(rows.data)
        row = slot // 4
        i = np.searchsorted(rows.start, row, side="right") - 1
        j = rows.offset[row].astype(np.int64) // 9 + slot % 4
        xi = x[j] - x[i]
        r2 = (xi**2).sum(axis=1)[:, None]
        n2 = xi**2 / r2
        terms = rows.data[slot, None].astype(float) * r2**1.5 * np.sqrt(n2) * (1.25 * n2 - 0.25)
        np.add.at(total, i, terms)
        np.add.at(total, j, terms)
    return total / points.volume[:, None]


@pytest.mark.parametrize("contrast", [1e-3, 1e3])
def test_surface_correction_refers_each_point_to_its_own_material(contrast):
    """Appendix A: after twenty sweeps every point responds as inside of a body of its own material."""
    body = build(scene_of(contrast, cells=(4, 2, 2)), loaded=False)
    own = np.repeat(body.share.materials.youngs_modulus[body.model.points.material], 8)
    ratio = responses(body) / (INFINITE_RESPONSE * 2.0 / 3.0 * own[:, None])
    assert np.abs(ratio - 1.0).max() < 1.2 * body.model.correction_remaining + SINGLE
    assert body.model.correction_remaining < CORRECTED


# --- elements and the solver's levels --------------------------------------------------------------------


@pytest.mark.parametrize("most_shapes", [4, 0], ids=["shared", "general"])
def test_elements_of_two_materials(monkeypatch, most_shapes):
    """Energy of a uniform strain: each half by its own Young's modulus and Poisson's ratio; 0.49 is nearly rigid."""
    monkeypatch.setattr(elements_module, "MOST_SHAPES", most_shapes)
    body = build(scene_of(5.0, FE, FE, nu=0.3), loaded=False)
    assert len(body.model.elements.shared) == (2 if most_shapes else 0)
    strain = np.array([[1.0, 0.2, 0.0], [0.2, -0.5, 0.3], [0.0, 0.3, 0.4]]) * 1e-3
    u = body.of_positions(lambda x: x @ strain)
    volume = 12.0  # of each half: the mesh has unit cells
    expected = 0.0
    for modulus, nu in ((1.0, 0.25), (5.0, 0.3)):
        mu = modulus / (2.0 * (1.0 + nu))
        lam = 2.0 * mu * nu / (1.0 - 2.0 * nu)
        expected += volume * (0.5 * lam * np.trace(strain) ** 2 + mu * (strain**2).sum())
    assert -0.5 * u @ body.internal(u) == pytest.approx(expected, rel=1e-12)
    # the masses bound the stiffness of their own element (eq. 22)
    single = {}
    for connectivity, numbers in body.model.elements.per_node(lambda k: np.abs(k).sum(axis=2).reshape(-1, 8, 3)):
        for nodes, rows in zip(connectivity, numbers, strict=True):
            single[tuple(nodes)] = rows.max()
    assert len(single) == 24
    assert max(single.values()) > 3.0 * min(single.values())


def test_bounds_of_elements_hold_for_the_stiffest():
    """A force at the bound's edge stays within the integers, whatever the default material is."""
    soft, stiff = (build(scene_of(c, FE, FE), loaded=False) for c in (1.0, 1e5))
    assert stiff.model.elements.bound == pytest.approx(1e5 * soft.model.elements.bound)


@pytest.mark.parametrize("contrast", [1e-5, 0.1, 1e5])
def test_grid_stiffness_of_two_materials(contrast):
    """Two materials with two of Poisson's ratios: the energy of a stretch of the second half, however soft it is."""
    body = build(scene_of(contrast, FE, FE, cells=(8, 4, 4), nu=0.4, supports=(Support(face="x-", x=0.0),)))
    intact = build_intact_elements(body.share, body.model)
    made = {}

    class Seen(Exception):
        pass

    def watch(cells, ratios, spring):
        made.update(cells=cells, ratios=ratios)
        raise Seen

    fixed = body.case.fixed.reshape(-1, 3)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(grid_stiffness, "whole_stiffness", watch)
        with pytest.raises(Seen):
            make_grid(intact, body.share, fixed, 1.0, body.case.free_motions)
    cells = made["cells"]
    np.testing.assert_array_equal(made["ratios"], [0.25, 0.4])
    volume = cells.moments[:, :2, 0].sum(axis=0)
    np.testing.assert_allclose(volume, [64.0, contrast * 64.0], rtol=1e-9)
    assert cells.moments[:, 2, 0].sum() == pytest.approx(25.0)  # nodes held along x
    _, matrix = grid_stiffness.whole_stiffness(cells, made["ratios"], 0.0)
    x = body.share.nodes.min(axis=0) + cells.h * np.stack(
        np.unravel_index(np.arange(np.prod(cells.counts + 1)), cells.counts + 1), axis=1
    )
    # stretched in the second half only
    u = np.zeros_like(x)
    u[:, 0] = np.maximum(x[:, 0], 0.0)
    mu = contrast / 2.8
    expected = 64.0 * (0.5 * (2.0 * mu * 0.4 / 0.2) + mu)
    assert 0.5 * u.reshape(-1) @ (matrix @ u.reshape(-1)) == pytest.approx(expected, rel=PINNED)


def test_a_soft_material_is_not_held_still():
    """A block is soft by its own material's measure: 1e-5 of a contrast is no missing stiffness."""
    body = build(scene_of(1e-5), loaded=False)
    n = body.model.unknowns.n_points
    values = point_blocks(body.model.points, body.model.bonds).values()
    modulus = np.repeat(body.share.youngs_modulus[body.model.subdomain.free], 8)
    limit = blocks.softest(body.model.comm, values, modulus)
    np.testing.assert_allclose(limit, modulus * limit.max(), rtol=1e-12)
    assert modulus.min() == 1e-5
    assert (blocks.inverted(values[:n], np.zeros((n, 3), bool), limit)[:, :3] > 0.0).all()
    alone = blocks.softest(body.model.comm, values, np.ones(n))
    loose = values.copy()
    loose[0] = 0.0
    assert (blocks.inverted(loose, np.zeros((n, 3), bool), alone)[0] == 0.0).all()


# --- regions and probes ----------------------------------------------------------------------------------


def test_round_regions_take_their_cells_out_of_boxes():
    """Centroids within the ball or cylinder, whatever the order of the regions."""
    ball = Region(name="ball", model=PD, material="other", centre=(3.0, 3.0, 3.0), radius=2.0)
    rest = Region(name="rest", model=PD)
    for regions in ((ball, rest), (rest, ball)):
        body = discretize(scene_of(2.0, cells=(6, 6, 6), regions=regions))
        middle = body.mesh.centroids - 3.0
        np.testing.assert_array_equal(body.material == 1, np.sqrt((middle**2).sum(axis=1)) <= 2.0)
    rod = ball.model_copy(update={"axis": "z"})
    body = discretize(scene_of(2.0, cells=(6, 6, 6), regions=(rod, rest)))
    np.testing.assert_array_equal(body.material == 1, np.hypot(middle[:, 0], middle[:, 1]) <= 2.0)


def refused(scene):
    with pytest.raises(SceneError) as caught:
        discretize(scene)
    return " ".join(caught.value.messages)


def test_round_regions_that_miss_or_swallow():
    away = Region(name="ball", model=PD, material="other", centre=(30.0, 3.0, 3.0), radius=2.0)
    rest = Region(name="rest", model=PD)
    assert "its ball or cylinder misses all centroids" in refused(scene_of(2.0, regions=(away, rest)))
    huge = away.model_copy(update={"radius": 99.0})
    assert "regions.rest contains no cell: regions with a radius take" in refused(scene_of(2.0, regions=(huge, rest)))
    twice = (huge, huge.model_copy(update={"name": "again"}))
    assert "regions.again overlaps regions.ball in 24 cells" in refused(scene_of(2.0, regions=(*twice, rest)))


def test_overlap_needs_one_poissons_ratio():
    """Poisson's ratio 0.3 beside peridynamics is refused with the cells; beyond the overlap it is sound."""
    scene = scene_of(2.0, PD, FE, nu=0.3)
    message = refused(scene)
    assert "regions.second.material has a Poisson's ratio of 0.3, and 4 of its cells are in the overlap" in message
    assert "beside cells with bonds of 0.25" in message
    assert "coupling.overlap = 1 cells deep" in message
    between = Region(name="between", model=FE, lower=(3.0, 0.0, 0.0), upper=(4.0, 2.0, 2.0))
    first, second = scene.regions
    second = second.model_copy(update={"lower": (4.0, 0.0, 0.0)})
    body = build(scene.model_copy(update={"regions": (first, between, second)}), loaded=False)
    assert [len(part.connectivity) for part in body.model.elements.shared] == [8]  # two layers, no stiffness between


@pytest.mark.parametrize("first", [FE, PD])
def test_bar_of_two_materials(first):
    """Exact displacements are those of stress / E in each part; a run of layers ends where the modulus changes."""
    scene = scene_of(4.0, first, PD, cells=(40, 2, 2))
    body = geometry_of(scene)
    strain = 2e-3

    def stretched(x):
        along = np.where(x[:, 0] < 20.0, x[:, 0], 20.0 + 0.25 * (x[:, 0] - 20.0))
        u = strain * np.stack([1.1 * along, -0.25 * x[:, 1], -0.25 * x[:, 2]], axis=1)
        return u + np.array([0.3, 0.0, 0.0])

    probe = BarProbe(kind="bar", axis="x", stress=strain * YOUNGS_MODULUS)
    bar = measure_bar(scene, body, fields_of_positions(body, stretched), probe, 1.0)
    np.testing.assert_allclose(bar.displacement, 1.1 * bar.exact, atol=1e-13)
    assert bar.elongation == pytest.approx(strain * 25.0)
    assert bar.moduli_change.tolist() == [20.0]
    results = bar_results(scene, body, bar, probe, 1.0)
    assert results["modulus_ratio_peridynamics"] == pytest.approx(1 / 1.1)
    assert results["end_error_percent"] == pytest.approx(10.0, rel=0.02)  # of the last layer, half a cell inside
    if first == FE:
        assert results["modulus_ratio_finite_elements"] == pytest.approx(1 / 1.1)
        assert results["interface_jump"] == pytest.approx(0.0, abs=1e-10)
    assert np.count_nonzero(bar.first_run(True)) == 20


def test_bar_of_two_materials_side_by_side():
    """The exact strain is that of the mean modulus of a cross section, without a change along the axis."""
    regions = (
        Region(name="first", model=PD, upper=(40.0, 1.0, 2.0)),
        Region(name="second", model=PD, material="other", lower=(0.0, 1.0, 0.0)),
    )
    scene = scene_of(4.0, cells=(40, 2, 2), regions=regions)
    body = geometry_of(scene)
    probe = BarProbe(kind="bar", axis="x", stress=2.5)
    bar = measure_bar(scene, body, fields_of_positions(body, lambda x: 1e-3 * x), probe, 1.0)
    np.testing.assert_allclose(bar.strain, 1e-3, rtol=1e-12)
    assert len(bar.moduli_change) == 0
    assert bar.first_run(True).all()


# --- decks -----------------------------------------------------------------------------------------------

SOUND = """
[mesh]
lower = [0.0, 0.0, 0.0]
upper = [6.0, 2.0, 2.0]
spacing = 1.0
[material]
youngs_modulus = 1.0e7
[materials.steel]
youngs_modulus = 2.0e8
[materials.rubber]
youngs_modulus = 1.0e4
poissons_ratio = 0.45
[[regions]]
name = "a"
model = "peridynamics"
upper = [2.0, 2.0, 2.0]
[[regions]]
name = "b"
model = "peridynamics"
material = "steel"
lower = [2.0, 0.0, 0.0]
upper = [4.0, 2.0, 2.0]
[[regions]]
name = "c"
model = "finite_elements"
material = "rubber"
lower = [4.0, 0.0, 0.0]
[[interfaces]]
between = ["default", "steel"]
youngs_modulus = 5.0e7
[[supports]]
face = "x-"
x = 0.0
"""


def problems(*changes, text=SOUND, overrides=()):
    for old, new in changes:
        assert old in text
        text = text.replace(old, new)
    with pytest.raises(DeckError) as caught:
        parse_deck(text, "bar.toml", overrides)
    assert all(message.startswith("bar.toml: ") for message in caught.value.messages)
    assert all(message.endswith((".", "?", ".)")) for message in caught.value.messages)
    return [message.removeprefix("bar.toml: ") for message in caught.value.messages]


def test_a_deck_of_three_materials_survives_writing_and_takes_overrides():
    scene = parse_deck(SOUND, "bar.toml", ("materials.rubber.youngs_modulus=2.0e3",))
    assert scene.materials["rubber"].youngs_modulus == 2000.0
    assert list(scene.materials) == ["steel", "rubber"]
    assert parse_deck(write_deck(scene), "copy.toml") == scene


BAD = {
    'regions.1.material has "steal", which is not the name of a material. Did you mean steel?': (
        '= "steel"\n', '= "steal"\n'
    ),
    "materials.rubber is the material of no region. Give a region": ('material = "rubber"\n', ""),
    "material is the material of no region. Let a region": ('name = "a"\n', 'name = "a"\nmaterial = "steel"\n'),
    "materials.default is the name of the table [material]. Choose": ("[materials.rubber]", "[materials.default]"),
    'materials."a b" is not a name. Use letters': ("[materials.rubber]", '[materials."a b"]'),
    'interfaces.0.between has "iron", which is not the name of a material. The materials are': ('"default"', '"iron"'),
    'interfaces.0.between = ["steel", "steel"] must name two different materials.': ('"default", ', '"steel", '),
    'interfaces.0.between = ["steel"] must name two different materials.': ('"default", ', ""),
    "interfaces.0 changes nothing. Give youngs_modulus,": ("youngs_modulus = 5.0e7\n", ""),
    "interfaces.0.between = 3 is not a list of texts in quotes.": ('["default", "steel"]', "3"),
    "interfaces.0.between.0 = 3 is not a text": ('"default", ', "3, "),
    "materials.steel.poissons_ratio = 0.495 is out of range for bonds, which bear 0 to 0.49.": (
        "= 2.0e8\n", "= 2.0e8\npoissons_ratio = 0.495\n"
    ),
    "materials.steel.youngs_modulus = -1.0 is out of range. Use a number above 0": ("2.0e8", "-1.0"),
    "unknown key materials.steel.youngs_modlus = 200000000.0. Did you mean youngs_modulus?": (
        "youngs_modulus = 2.0e8", "youngs_modlus = 2.0e8"
    ),
    "materials.rubber.youngs_modulus = 10.0 is 2e+07 times below materials.steel.youngs_modulus": ("1.0e4", "10.0"),
    "regions.0.centre = [1.0, 1.0, 1.0] needs a radius. Add it.": (
        'name = "a"\n', 'name = "a"\ncentre = [1.0, 1.0, 1.0]\n'
    ),
    'regions.0.axis = "z" is that of a cylinder. Add centre and radius.': ('name = "a"\n', 'name = "a"\naxis = "z"\n'),
}  # fmt: skip


@pytest.mark.parametrize("sentence", BAD)
def test_bad_materials_are_told(sentence):
    messages = problems(BAD[sentence])
    assert sum(message.startswith(sentence) for message in messages) == 1, messages


def test_interfaces_twice_or_without_bonds():
    twice = SOUND + '[[interfaces]]\nbetween = ["steel", "default"]\nyoungs_modulus = 1.0e7\n'
    assert problems(text=twice) == [
        'interfaces.1.between = ["steel", "default"] is there already as interfaces.0. Keep one.'
    ]
    assert problems(('"peridynamics"', '"finite_elements"')) == [
        "interfaces are of bonds, and no region has any. Remove them."
    ]


def test_materials_that_are_no_tables():
    """The sentence says where materials go."""
    assert problems(("[materials.rubber]\nyoungs_modulus = 1.0e4", "[materials]\nrubber = 3"))[0].startswith(
        "materials.rubber = 3 is not a table. Write the keys of each under a line [materials.NAME]."
    )
    body = SOUND.partition("[materials.steel]")[0] + SOUND[SOUND.index("[[regions]]") :]
    messages = problems(text="materials = 3\n" + body)
    assert messages[0].startswith("materials = 3 is not a table. Write the keys of each under a line [materials.NAME].")


def test_failure_of_a_material_without_bonds():
    messages = problems(
        ('"peridynamics"', '"finite_elements"'),
        ('[[interfaces]]\nbetween = ["default", "steel"]\nyoungs_modulus = 5.0e7\n', ""),
        ("= 2.0e8\n", "= 2.0e8\nfracture_energy = 1.0\n"),
    )
    assert messages == [
        "materials.steel.fracture_energy breaks bonds, and no region has any. Remove it, or describe a region by "
        "peridynamics."
    ]


@pytest.mark.parametrize("where", ["materials.steel", "interfaces.0"])
def test_events_need_one_material_or_interface_that_fails(where):
    text = SOUND + '[solver]\nkind = "cg"\n[stepping]\nkind = "events"\n'
    text = text.replace("x = 0.0\n", 'x = 0.0\n[[supports]]\nface = "x+"\nx = 0.1\n')
    assert problems(text=text)[0].startswith('stepping.kind = "events" follows failure, and nothing says when')
    parse_deck(text, "bar.toml", (f"{where}.critical_stretch=0.01",))
