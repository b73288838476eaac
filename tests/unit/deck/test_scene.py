"""The models of a deck: defaults, derived numbers, and checks that need no mesh."""

import dataclasses
from unittest.mock import patch

import pytest
from pydantic import ValidationError

from pdfem_mpi.deck.loads import BodyForce, Support, Traction
from pdfem_mpi.deck.materials import Interface, Material
from pdfem_mpi.deck.meshes import BoxMesh, FileMesh, PlateWithHoleMesh, nearest_fitting_spacing
from pdfem_mpi.deck.outputs import BarProbe, DisplacementProbe, LineProbe
from pdfem_mpi.deck.peridynamics import Coupling, Peridynamics
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.scene import Scene, find_problems
from pdfem_mpi.deck.table import Absent, FieldMissing, Problem, SceneError, Table, did_you_mean, show

BAR = {"lower": (-5.0, -0.2, -0.2), "upper": (5.0, 0.2, 0.2)}
ELEMENTS = Region(name="elements", model="finite_elements")
BONDS = Region(name="bonds", model="peridynamics")


def scene(**tables):
    """A sound scene, with some tables replaced."""
    sound = {
        "mesh": BoxMesh(**BAR, spacing=0.1),
        "material": Material(youngs_modulus=1.0e7),
        "regions": (ELEMENTS,),
    }
    return Scene(**sound | tables)


def problems_of(make):
    """Keys and sentences of the problems that a model finds between its keys."""
    with pytest.raises(ValidationError) as caught:
        make()
    return [problem for item in caught.value.errors() for problem in item["ctx"]["problems"]]


def only_problem(make):
    problems = problems_of(make)
    assert len(problems) == 1, problems
    return problems[0]


def test_defaults_are_those_of_the_paper():
    """Internal length = cell edge, cutoff 2.5 l (sec. 4.1), nu = 1/4, reading B with one layer."""
    bar = scene()
    assert bar.peridynamics.lengths(0.05) == (0.05, 0.125)
    assert bar.material.poissons_ratio == 0.25
    assert (bar.coupling.kind, bar.coupling.overlap) == ("paper", 1)
    assert bar.stepping.load_factors == (1.0,)


def test_given_lengths_win_over_defaults():
    assert Peridynamics(internal_length=0.04).lengths(0.05) == (0.04, 0.1)
    assert Peridynamics(internal_length=0.04, cutoff_radius=0.2).lengths(0.05) == (0.04, 0.2)


def test_bulk_modulus_of_poissons_ratio_one_quarter():
    """k = E / (3 (1 - 2 nu)) = 2 E / 3."""
    assert Material(youngs_modulus=1.0e7).bulk_modulus == pytest.approx(2.0e7 / 3.0, rel=1e-15)


@pytest.mark.parametrize(("spacing", "n_cells"), [(0.05, (200, 8, 8)), (0.1, (100, 4, 4)), (0.2, (50, 2, 2))])
def test_box_counts_cells(spacing, n_cells):
    assert BoxMesh(**BAR, spacing=spacing).n_cells == n_cells


def test_spacing_printed_with_six_digits_fits():
    """A side of 10 with 0.0666667 misses 150 cells by 5e-7 of the side: within SPACING_TOLERANCE."""
    mesh = BoxMesh(lower=(0.0, 0.0, 0.0), upper=(10.0, 10.0, 10.0), spacing=0.0666667)
    assert mesh.n_cells == (150, 150, 150)


def test_misfitting_spacing_names_sides_and_the_nearest_that_fits():
    problem = only_problem(lambda: BoxMesh(**BAR, spacing=0.07))
    assert problem.key == "spacing"
    assert "0.07 does not divide" in problem.text
    assert "0.0666666666667" in problem.text


@pytest.mark.parametrize(
    ("sides", "spacing", "nearest"),
    [
        ((10.0, 0.4, 0.4), 0.05, 0.05),
        ((10.0, 0.4, 0.4), 0.095, 0.1),
        ((1.0, 1.0, 1.0), 0.3, 1 / 3),
        ((1.0, 1.0, 1.0), 5.0, 1.0),
        ((1.0, 2**0.5, 1.0), 0.1, None),
    ],
)
def test_nearest_fitting_spacing(sides, spacing, nearest):
    found = nearest_fitting_spacing(sides, spacing)
    assert found == (None if nearest is None else pytest.approx(nearest, rel=1e-12))


def test_spacing_above_a_side_is_refused():
    assert only_problem(lambda: BoxMesh(**BAR, spacing=1.0)).key == "spacing"


def test_spacing_in_wrong_units_is_refused_before_memory_is_asked_for():
    assert "more than" in only_problem(lambda: BoxMesh(**BAR, spacing=1.0e-6)).text


def test_every_exchanged_corner_is_named():
    problems = problems_of(lambda: BoxMesh(lower=(1.0, 1.0, 0.0), upper=(0.0, 0.0, 1.0), spacing=0.1))
    assert [(problem.key, problem.text.split()[1]) for problem in problems] == [
        ("upper", "x"),
        ("upper", "y"),
    ]


def test_flat_box_is_refused():
    problem = only_problem(lambda: BoxMesh(lower=(0.0, 0.0, 0.0), upper=(1.0, 0.0, 1.0), spacing=0.1))
    assert (problem.key, "y = 0.0" in problem.text) == ("upper", True)


PLATE = {"lower": (-4.5, -1.5, -0.1), "upper": (4.5, 1.5, 0.1)}


@pytest.mark.parametrize(("spacing", "n_cells"), [(0.05, (180, 60, 4)), (0.1, (90, 30, 2)), (0.2, (45, 15, 1))])
def test_plate_of_the_paper_counts_cells_of_its_box(spacing, n_cells):
    assert PlateWithHoleMesh(**PLATE, hole_radius=0.4, spacing=spacing).n_cells == n_cells


@pytest.mark.parametrize(
    ("radius", "part"),
    [
        (0.19, "= 0.19 is below 2 * spacing = 0.2: too few cells for a circle. Use a spacing of at most 0.095"),
        (1.31, "= 1.31 does not fit: it leaves 0.19 between the hole and the plate's edges in y"),
        (7.0, "= 7.0 does not fit"),
    ],
)
def test_hole_that_does_not_fit_is_refused(radius, part):
    problem = only_problem(lambda: PlateWithHoleMesh(**PLATE, hole_radius=radius, spacing=0.1))
    assert problem.key == "hole_radius"
    assert part in problem.text


@pytest.mark.parametrize("radius", [0.2, 1.3])
def test_holes_at_both_limits_are_allowed(radius):
    assert PlateWithHoleMesh(**PLATE, hole_radius=radius, spacing=0.1).hole_radius == radius


def test_narrow_side_is_named():
    tall = {"lower": (0.0, 0.0, 0.0), "upper": (2.0, 9.0, 1.0)}
    assert "edges in x" in only_problem(lambda: PlateWithHoleMesh(**tall, hole_radius=0.9, spacing=0.1)).text


def test_misfitting_spacing_of_a_plate_is_reported_before_its_hole():
    assert only_problem(lambda: PlateWithHoleMesh(**PLATE, hole_radius=9.0, spacing=0.07)).key == "spacing"


def test_line_probe_needs_two_ends_and_a_name_for_files():
    ends = {"start": (0.0, 0.0, 0.0), "stop": (1.0, 0.0, 0.0)}
    assert LineProbe(kind="line", name="bottom-2", **ends).n == 101
    problems = problems_of(lambda: LineProbe(kind="line", name="../x", start=(0.0,) * 3, stop=(0.0,) * 3))
    assert [problem.key for problem in problems] == ["name", "stop"]


@pytest.mark.parametrize("nu", [-0.01, 0.495])
def test_poissons_ratios_that_bonds_do_not_bear_are_refused_with_peridynamics_only(nu):
    material = Material(youngs_modulus=1.0, poissons_ratio=nu)
    assert scene(material=material).material.poissons_ratio == nu
    problem = only_problem(lambda: scene(material=material, regions=(BONDS,)))
    assert problem.key == "material.poissons_ratio"
    assert "is out of range for bonds, which bear 0 to 0.49. Use a number in it" in problem.text


@pytest.mark.parametrize("nu", [0.0, 0.49])
def test_poissons_ratios_of_bonds(nu):
    material = Material(youngs_modulus=1.0, poissons_ratio=nu)
    found = scene(material=material, regions=(BONDS,))
    assert found.has_volumetric_part and not scene(regions=(BONDS,)).has_volumetric_part
    assert not scene(material=material).has_volumetric_part
    factors = Peridynamics(surface_correction="fitted", signs="bounded")
    assert scene(material=material, regions=(BONDS,), peridynamics=factors).has_volumetric_part
    brittle = material.model_copy(update={"critical_stretch": 1e-3})
    problem = only_problem(lambda: scene(material=brittle, regions=(BONDS,), peridynamics=factors))
    assert problem.key == "material.poissons_ratio"
    assert 'does not go with peridynamics.surface_correction = "fitted" where bonds may break' in problem.text


def test_cutoff_below_internal_length_is_refused():
    problem = only_problem(lambda: Peridynamics(internal_length=0.05, cutoff_radius=0.02))
    assert problem.key == "cutoff_radius"
    assert "0.125" in problem.text


@pytest.mark.parametrize(
    ("lengths", "key"),
    [
        ({"cutoff_radius": 0.09}, "peridynamics.cutoff_radius"),
        ({"internal_length": 0.03}, "peridynamics.internal_length"),
        ({"internal_length": 0.02, "cutoff_radius": 0.09}, "peridynamics.cutoff_radius"),
    ],
)
def test_cutoff_below_spacing_is_refused_with_peridynamics_only(lengths, key):
    table = Peridynamics(**lengths)
    assert scene(peridynamics=table).peridynamics is table
    assert only_problem(lambda: scene(peridynamics=table, regions=(BONDS,))).key == key


def test_cutoff_equal_to_spacing_is_allowed():
    assert scene(peridynamics=Peridynamics(internal_length=0.04), regions=(BONDS,))


@pytest.mark.parametrize(
    ("regions", "peridynamics", "elements", "coupled"),
    [
        ((ELEMENTS,), False, True, False),
        ((BONDS,), True, False, False),
        ((ELEMENTS, BONDS), True, True, True),
    ],
)
def test_scene_says_which_descriptions_it_has(regions, peridynamics, elements, coupled):
    case = scene(regions=regions)
    assert (case.has_peridynamics, case.has_finite_elements, case.is_coupled) == (
        peridynamics,
        elements,
        coupled,
    )


@pytest.mark.parametrize(
    "selection",
    [
        {"region": "bonds"},
        {"face": "x+"},
        {"face": "x+", "layers": 3},
        {"set": "a", "layers": 2},
        {"lower": (0.0, 0.0, 0.0)},
    ],
)
def test_one_selection_is_enough(selection):
    assert BodyForce(kind="body_force", total=(1.0, 0.0, 0.0), **selection)
    assert Support(x=0.0, **selection)


@pytest.mark.parametrize(
    ("selection", "key"),
    [
        ({}, ""),
        ({"region": "bonds", "face": "x+"}, ""),
        ({"set": "a", "face": "x+"}, ""),
        ({"face": "x+", "upper": (0.0, 0.0, 0.0)}, ""),
        ({"region": "bonds", "layers": 2}, "layers"),
        ({"lower": (1.0, 0.0, 0.0), "upper": (0.0, 0.0, 0.0)}, "upper"),
    ],
)
def test_no_or_several_selections_are_refused(selection, key):
    assert only_problem(lambda: BodyForce(kind="body_force", total=(1.0, 0.0, 0.0), **selection)).key == key
    assert only_problem(lambda: Support(x=0.0, **selection)).key == key


@pytest.mark.parametrize("amount", [{}, {"total": (1.0, 0.0, 0.0), "density": (1.0, 0.0, 0.0)}])
def test_body_force_has_density_or_total(amount):
    assert "density or total" in only_problem(lambda: BodyForce(kind="body_force", face="x+", **amount)).text


@pytest.mark.parametrize("amount", [{}, {"total": (1.0, 0.0, 0.0), "traction": (1.0, 0.0, 0.0)}])
def test_traction_has_traction_or_total(amount):
    assert "traction or total" in only_problem(lambda: Traction(kind="traction", face="x+", **amount)).text


@pytest.mark.parametrize("place", [{}, {"face": "x+", "set": "a"}])
def test_traction_has_face_or_set(place):
    found = only_problem(lambda: Traction(kind="traction", total=(1.0, 0.0, 0.0), **place))
    assert "exactly one of face, set or lower/upper" in found.text


def test_region_has_a_set_or_a_box():
    found = only_problem(lambda: Region(name="a", model="peridynamics", set="b", upper=(1.0, 1.0, 1.0)))
    assert found.key == "set" and "Keep one of them" in found.text


def test_sets_need_a_mesh_file():
    """Other meshes have no names; all three tables are looked at."""
    tables = {
        "regions": (Region(name="a", model="finite_elements", set="b"),),
        "loads": (Traction(kind="traction", set="c", total=(1.0, 0.0, 0.0)),),
        "supports": (Support(set="d", x=0.0),),
    }
    found = problems_of(lambda: scene(**tables))
    assert [problem.key for problem in found] == ["regions.0.set", "loads.0.set", "supports.0.set"]
    assert "by lower and upper instead" in found[0].text and "or by face instead" in found[1].text
    assert scene(mesh=FileMesh(path="a.msh"), **tables).mesh.spacing is None


def test_cutoff_of_a_mesh_file_is_checked_when_its_spacing_is_given():
    """Left out, the check waits for the cells (test_reader)."""
    tables = {"regions": (BONDS,), "peridynamics": Peridynamics(internal_length=0.1)}
    found = only_problem(lambda: scene(mesh=FileMesh(path="a.msh", spacing=0.3), **tables))
    assert found.key == "peridynamics.internal_length" and "below mesh.spacing = 0.3" in found.text
    assert scene(mesh=FileMesh(path="a.msh"), **tables)


def test_support_prescribes_something():
    assert "prescribes nothing" in only_problem(lambda: Support(face="x-")).text


def test_support_of_zero_is_something():
    assert Support(face="x-", y=0.0).y == 0.0


@pytest.mark.parametrize("factors", [(1.0,), (0.5, 1.0), (-1.0, -2.0)])
def test_monotone_load_factors_are_allowed(factors):
    assert Steps(load_factors=factors).load_factors == factors


@pytest.mark.parametrize("factors", [(0.0,), (1.0, 1.0), (1.0, 0.5), (-1.0, -0.5), (0.5, -1.0)])
def test_load_factors_that_turn_back_are_refused(factors):
    assert only_problem(lambda: Steps(load_factors=factors)).key == "load_factors"


def test_references_to_unknown_regions_are_refused():
    load = BodyForce(kind="body_force", region="bond", total=(1.0, 0.0, 0.0))
    support = Support(region="steel", x=0.0)
    problems = problems_of(lambda: scene(regions=(BONDS,), loads=(load,), supports=(support,)))
    assert [problem.key for problem in problems] == ["loads.0.region", "supports.0.region"]
    assert "Did you mean bonds?" in problems[0].text
    assert "The regions are bonds." in problems[1].text


def test_repeated_names_are_refused():
    probe = DisplacementProbe(kind="displacement", name="end", point=(0.0, 0.0, 0.0))
    problems = problems_of(lambda: scene(regions=(BONDS, BONDS), probes=(probe, probe)))
    assert [problem.key for problem in problems] == ["regions.1.name", "probes.1.name"]


def test_second_bar_probe_is_refused():
    probe = BarProbe(kind="bar", stress=1.0)
    assert only_problem(lambda: scene(probes=(probe, probe))).key == "probes.1.kind"


def test_bar_probe_without_stress_is_refused():
    assert only_problem(lambda: BarProbe(kind="bar", stress=0.0)).key == "stress"


def all_tables():
    pending, found = list(Table.__subclasses__()), []
    while pending:
        table = pending.pop()
        found.append(table)
        pending += table.__subclasses__()
    return sorted(found, key=lambda table: table.__name__)


@pytest.mark.parametrize("table", all_tables(), ids=lambda table: table.__name__)
def test_tables_are_frozen_strict_and_closed(table):
    config = table.model_config
    assert (config["frozen"], config["strict"], config["extra"]) == (True, True, "forbid")
    assert config["allow_inf_nan"] is False


def test_scene_cannot_be_changed():
    with pytest.raises(ValidationError):
        scene().title = "other"


def test_scene_error_keeps_its_messages():
    error = SceneError(message for message in ("one.", "two."))
    assert error.messages == ["one.", "two."]
    assert str(error) == "one.\ntwo."


@dataclasses.dataclass
class Shown:
    value: object
    text: str


@pytest.mark.parametrize(
    "case",
    [
        Shown(True, "true"),
        Shown(0.07, "0.07"),
        Shown("a", '"a"'),
        Shown((1.0, "b"), '[1.0, "b"]'),
        Shown({"a": 1}, "a table"),
        Shown(tuple(range(9)), "[0, 1, 2, 3, 4, 5, 6, 7, ...]"),
    ],
    ids=lambda case: case.text,
)
def test_values_are_shown_as_in_a_deck(case):
    assert show(case.value) == case.text


def test_long_values_are_shortened():
    assert len(show("x" * 1000)) == 60
    assert len(show(10**400)) <= 60


@pytest.mark.parametrize(
    ("word", "answer"),
    [("spacng", " Did you mean spacing?"), ("SPACING", " Did you mean spacing?"), ("colour", "")],
)
def test_did_you_mean(word, answer):
    assert did_you_mean(word, ["lower", "upper", "spacing"]) == answer


FITTED = Peridynamics(surface_correction="fitted")


def test_fitted_factors_go_with_the_exact_coupling_and_it_with_them():
    both = (Region(name="elements", model="finite_elements", upper=(0.0, 0.2, 0.2)), BONDS)
    scene(regions=both, peridynamics=FITTED, coupling=Coupling(kind="exact"))
    found = only_problem(lambda: scene(regions=both, peridynamics=FITTED))
    assert found.key == "coupling.kind"
    assert 'Use "exact"' in found.text
    found = only_problem(lambda: scene(regions=both, coupling=Coupling(kind="exact")))
    assert found.key == "coupling.kind"
    assert 'surface_correction = "appendix_a"' in found.text
    assert 'Use "fitted"' in found.text
    scene(regions=(BONDS,), peridynamics=FITTED)  # nothing to couple
    scene(coupling=Coupling(kind="exact"))


def test_free_signs_are_refused_where_bonds_may_break():
    breaking = {"material": Material(youngs_modulus=1.0e7, critical_stretch=0.01), "regions": (BONDS,)}
    found = only_problem(lambda: scene(peridynamics=FITTED, **breaking))
    assert found.key == "peridynamics.signs"
    assert 'Use "bounded"' in found.text
    scene(peridynamics=FITTED.model_copy(update={"signs": "bounded"}), **breaking)
    across = {
        "materials": {"steel": Material(youngs_modulus=2.0e7)},
        "interfaces": (Interface(between=("default", "steel"), critical_stretch=0.01),),
        "regions": (BONDS, Region(name="end", model="peridynamics", material="steel", lower=(9.0, 0.0, 0.0))),
    }
    assert only_problem(lambda: scene(peridynamics=FITTED, **across)).key == "peridynamics.signs"


@pytest.mark.parametrize("correction", ["none", "virial", "fitted"])
def test_tractions_pull_at_bonds_of_any_correction(correction):
    """By the areas of boundary of their points."""
    ends = (("x+", 1.0), ("x-", -1.0))
    loads = tuple(Traction(kind="traction", face=face, total=(force, 0.0, 0.0)) for face, force in ends)
    peridynamics = FITTED.model_copy(update={"surface_correction": correction})
    assert not scene(regions=(BONDS,), peridynamics=peridynamics, loads=loads).problems()


def test_fitted_factors_need_the_whole_body():
    mesh = BoxMesh(**BAR, spacing=0.1, symmetry=("y-",))
    found = only_problem(lambda: scene(mesh=mesh, regions=(BONDS,), peridynamics=FITTED))
    assert found.key == "mesh.symmetry"
    assert "whole body" in found.text


def test_a_misspelt_name_in_a_check_shows():
    """A check that reads what no table has is a mistake of the program; it was switched off without a word before."""

    def misspelt(mesh):
        return [Problem("mesh", "")] if mesh.spacign else []

    tables = {"mesh": BoxMesh(kind="box", lower=(0.0, 0.0, 0.0), upper=(1.0, 1.0, 1.0), spacing=0.5)}
    with patch("pdfem_mpi.deck.scene.CHECKS", ((("mesh",), misspelt),)), pytest.raises(AttributeError, match="spacign"):
        find_problems(tables)


def test_a_check_is_skipped_where_a_field_it_reads_is_missing():
    """Of a table that was made without a key, and of an item that is no table."""

    def reads(mesh, loads):
        return [Problem("mesh.spacing", f"{mesh.spacing} {loads[0].face}")]

    mesh = BoxMesh.model_construct(kind="box")
    with patch("pdfem_mpi.deck.scene.CHECKS", ((("mesh", "loads"), reads),)):
        assert find_problems({"mesh": mesh, "loads": (Absent(),)}) == []
    with pytest.raises(FieldMissing):
        _ = mesh.spacing
