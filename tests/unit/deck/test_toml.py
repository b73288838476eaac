"""Reading and writing decks: every kind of bad input gives its sentence, all of them at once."""

import copy
import math
import re
import tomllib
from pathlib import Path

import numpy as np
import pytest

from pdfem_mpi.deck.meshes import BoxMesh, PlateWithHoleMesh
from pdfem_mpi.deck.overrides import parse_overrides
from pdfem_mpi.deck.table import DeckError
from pdfem_mpi.deck.toml import dimension_of, parse_deck, read_deck, write_deck

JOBS = Path(__file__).resolve().parents[3] / "jobs"
DECKS = sorted(JOBS.glob("*.toml"))

SOUND = """
title = "coupled bar"
[mesh]
lower = [-1.0, -0.2, -0.2]
upper = [1.0, 0.2, 0.2]
spacing = 0.1
[material]
youngs_modulus = 1.0e7
[[regions]]
name = "elements"
model = "finite_elements"
upper = [0.0, 0.2, 0.2]
[[regions]]
name = "bonds"
model = "peridynamics"
lower = [0.0, -0.2, -0.2]
[[loads]]
kind = "body_force"
face = "x+"
total = [1600.0, 0.0, 0.0]
[[loads]]
kind = "traction"
face = "x-"
total = [-1600.0, 0.0, 0.0]
[[probes]]
kind = "displacement"
name = "end"
point = [1.0, 0.0, 0.0]
"""

# words of the validation library's own messages, which must never reach a user
FOREIGN = re.compile(r"pydantic|validation error|Input should|Field required|Extra inputs|type=|\bNone\b")


def problems(text=SOUND, *overrides):
    """The sentences of a bad deck; each begins with the file or the override and has a remedy at its end."""
    with pytest.raises(DeckError) as caught:
        parse_deck(text, "bar.toml", overrides)
    messages = caught.value.messages
    for message in messages:
        assert message.startswith(("bar.toml: ", "--set ")), message
        assert message.endswith((".", "?", ".)")), message
        assert "\n" not in message
        assert not FOREIGN.search(message), message
    return messages


def only(*overrides, text=SOUND):
    messages = problems(text, *overrides)
    assert len(messages) == 1, messages
    return messages[0]


def without(line):
    assert line in SOUND
    return SOUND.replace(line, "", 1)


# --- sound decks ------------------------------------------------------------------------------------------


@pytest.mark.parametrize("path", DECKS, ids=lambda path: path.stem)
def test_every_deck_of_jobs_is_sound_and_survives_writing(path):
    scene = read_deck(path)
    assert parse_deck(write_deck(scene), "copy.toml") == scene


@pytest.mark.parametrize("path", [path for path in DECKS if "gmsh" not in path.stem], ids=lambda path: path.stem)
def test_every_deck_of_jobs_can_be_made_coarser(path):
    """By the overrides that its comment names; lengths of peridynamics follow, unless the deck fixes them."""
    advice = path.read_text().split("Coarser:")[1].split("\n\n")[0]
    fine, coarse = read_deck(path), read_deck(path, re.findall(r"--set (\S+)", advice))
    assert math.prod(coarse.mesh.n_cells) <= math.prod(fine.mesh.n_cells) / 4
    ratio = coarse.mesh.spacing / fine.mesh.spacing
    lengths = [scene.peridynamics.lengths(scene.mesh.spacing)[0] for scene in (fine, coarse)]
    assert lengths[1] in (lengths[0], pytest.approx(ratio * lengths[0]))


@pytest.mark.parametrize("path", DECKS, ids=lambda path: path.stem)
def test_every_deck_of_jobs_opens_with_a_comment(path):
    """What it shows, the section of the paper, the closed form, what is ambiguous; or what else it is held to."""
    opening = path.read_text().split("\n\n")[0]
    assert all(line.startswith("#") for line in opening.splitlines())
    if "Linear elastic fracture mechanics:" in opening or "Held to:" in opening:
        assert re.search("Units: (in, lbf, psi|mm, N, MPa)\\.", opening)
        return
    assert "Units: in, lbf, psi." in opening
    assert re.search("Paper: (section|appendix)", opening) and "Closed form" in opening and "ambiguous" in opening


def test_body_force_of_the_paper():
    """Sec. 4.1: 2e5 lb/in^3 over 0.05 x 0.4 x 0.4 in is 1600 lb."""
    load = read_deck(JOBS / "bar_pd.toml").loads[0]
    assert load.total[0] == pytest.approx(2.0e5 * 0.05 * 0.4 * 0.4, rel=1e-15)
    assert load.layers == 1


def test_whole_numbers_are_accepted_for_floats():
    assert parse_deck(SOUND, "x", ["material.youngs_modulus=70"]).material.youngs_modulus == 70.0


def test_written_deck_has_overrides_and_defaults():
    text = write_deck(parse_deck(SOUND, "x", ["mesh.spacing=0.2"]))
    assert "spacing = 0.2" in text
    assert 'surface_correction = "appendix_a"' in text


@pytest.mark.parametrize("title", ['a "quoted" one', "back\\slash", "Grüße, 破壊 🙂", "tab\tand\nline", "\x7f\x00"])
def test_any_title_survives_writing(title):
    scene = parse_deck(SOUND, "x").model_copy(update={"title": title})
    assert parse_deck(write_deck(scene), "x").title == title


EXTREMES = [1e22, 1.0000000000000002e-99, 0.1 + 0.2, 9.999999999999999e99, 12345678901234567890.0]


@pytest.mark.parametrize("number", EXTREMES)
def test_floats_survive_writing_bit_for_bit(number):
    scene = parse_deck(SOUND, "x", [f"material.youngs_modulus={number!r}"])
    assert parse_deck(write_deck(scene), "x").material.youngs_modulus == number


# --- overrides --------------------------------------------------------------------------------------------


def test_overrides_take_toml_values_and_bare_words():
    parsed = parse_overrides(["a.b=0.1", "a=[1, 2]", "kind=adr", 'name="x y"', "on=true", "a.c = x = y"])
    assert [override.value for override in parsed] == [0.1, [1, 2], "adr", "x y", True, "x = y"]
    assert parsed[0].path == ("a", "b")


def test_tables_from_python_are_a_deck():
    """As TOML would give them, tuples too; problems name the key, and the tables stay as they were."""
    tables = tomllib.loads(SOUND)
    tables["mesh"]["upper"] = tuple(tables["mesh"]["upper"])
    before = copy.deepcopy(tables)
    assert read_deck(tables) == parse_deck(SOUND, "deck.toml")
    assert read_deck(tables, {"mesh.upper.0": 2.0}).mesh.upper[0] == 2.0
    with pytest.raises(DeckError, match=r"deck: mesh\.spacing"):
        read_deck(tables | {"mesh": tables["mesh"] | {"spacing": "wide"}})
    assert tables == before


def test_list_items_are_found_by_index_and_by_name():
    scene = parse_deck(
        SOUND,
        "x",
        ["loads.1.total=[-5.0, 0.0, 0.0]", "regions.bonds.lower=[0.1, 0, 0]", "probes.end.name=tip"],
    )
    assert scene.loads[1].total == (-5.0, 0.0, 0.0)
    assert scene.regions[1].lower == (0.1, 0.0, 0.0)
    assert scene.probes[0].name == "tip"


def test_override_creates_a_table_that_the_deck_leaves_to_defaults():
    assert parse_deck(SOUND, "x", ["solver.tolerance=1e-3"]).solver.tolerance == 1e-3


def test_later_override_wins():
    assert parse_deck(SOUND, "x", ["mesh.spacing=0.07", "mesh.spacing=0.2"]).mesh.spacing == 0.2


@pytest.mark.parametrize("text", ["mesh.spacing", "=3", "mesh..spacing=1", "mesh.spacing=", "mesh.=1"])
def test_override_without_key_or_value(text):
    assert only(text).startswith(f"--set {text}: must read key.path=value")


@pytest.mark.parametrize(
    ("text", "part"),
    [
        ("mesh.lower=[1,", "is not a TOML value"),
        ("mesh.spacing.x=1", "mesh.spacing = 0.1 is not a table"),
        ("loads.2.total=1", "loads has no item 2. Items are: 0 to 1"),
        ("regions.bond.lower=1", "or by name elements, bonds. Did you mean bonds?"),
        ("loads.-1.total=1", "loads has no item -1"),
        ("mesh.spacing=0.1\ntitle=3", "is not a TOML value"),
    ],
)
def test_override_that_leads_nowhere(text, part):
    with pytest.raises(DeckError) as caught:
        parse_deck(SOUND, "bar.toml", [text])
    assert len(caught.value.messages) == 1
    assert part in caught.value.messages[0]


def test_problem_of_an_override_says_so():
    assert only("mesh.spacing=-1").endswith("(This value was given by --set.)")
    assert "--set" not in only(text=SOUND.replace("spacing = 0.1", "spacing = -1"))


def test_bad_overrides_are_all_reported():
    with pytest.raises(DeckError) as caught:
        parse_overrides(["a", "b=[", "c=1"])
    assert len(caught.value.messages) == 2


# --- files ------------------------------------------------------------------------------------------------


def test_missing_file_suggests_a_near_name(tmp_path):
    (tmp_path / "bar_tension.toml").write_text(SOUND)
    with pytest.raises(DeckError) as caught:
        read_deck(tmp_path / "bar_tensoin.toml")
    (message,) = caught.value.messages
    assert message.startswith(f"{tmp_path / 'bar_tensoin.toml'}: there is no such file.")
    assert message.endswith(f"Did you mean {tmp_path / 'bar_tension.toml'}?")


def test_missing_folder_is_a_sentence_too(tmp_path):
    with pytest.raises(DeckError, match="there is no such file"):
        read_deck(tmp_path / "nowhere" / "bar.toml")


def test_folder_in_place_of_a_deck(tmp_path):
    with pytest.raises(DeckError, match="this is a folder"):
        read_deck(tmp_path)


def test_binary_file(tmp_path):
    (tmp_path / "x.toml").write_bytes(b"title = '\xff\xfe'")
    with pytest.raises(DeckError, match="byte 9 is not UTF-8"):
        read_deck(tmp_path / "x.toml")


def test_path_that_no_file_can_have():
    with pytest.raises(DeckError, match="cannot be read"):
        read_deck("a\0b.toml")


@pytest.mark.parametrize("text", ["mesh = [", "a = 1\na = 2", "just words", "x = " + "[" * 5000, "x = 1" + "0" * 5000])
def test_text_that_is_not_toml(text):
    message = only(text=text)
    assert "this is not a TOML file" in message


def test_empty_deck_names_every_table_that_is_needed():
    messages = problems("")
    for table in ("mesh", "material", "regions"):
        assert any(message.startswith(f"bar.toml: {table} is missing.") for message in messages)


# --- keys, types, ranges ----------------------------------------------------------------------------------


def test_misspelt_key_is_one_problem_not_two():
    """The validation library reports a missing key and an unknown one; the user made one mistake."""
    message = only(text=SOUND.replace("spacing =", "spacng ="))
    assert message == "bar.toml: unknown key mesh.spacng = 0.1. Did you mean spacing?"


def test_misspelt_key_with_a_default():
    message = only("solver.tolerence=1e-3")
    assert message.startswith("bar.toml: unknown key solver.tolerence = 0.001. Did you mean tolerance?")


def test_misspelt_table():
    message = only(text=SOUND.replace("[material]", "[materiel]"))
    assert message == "bar.toml: unknown table materiel. Did you mean material?"


def test_key_in_the_wrong_table_is_sent_home():
    assert only("solver.spacing=0.1").endswith("It is a key of mesh: move it there.")


def test_key_like_nothing_lists_the_keys():
    assert "the keys here are kind, tolerance, max_evaluations" in only("solver.zzz=1")


def test_unknown_key_in_a_list_item():
    assert only("loads.0.totl=3").startswith("bar.toml: unknown key loads.0.totl = 3. Did you mean total?")


def test_missing_key_has_an_example():
    message = only(text=without("youngs_modulus = 1.0e7"))
    assert message.startswith("bar.toml: material.youngs_modulus is missing. Give Young's modulus")


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        (
            'material.youngs_modulus="70 GPa"',
            '"70 GPa" is not a number. Use a number above 0 (dimension force',
        ),
        ("material.youngs_modulus=true", "true is not a number"),
        ("material.youngs_modulus=2024-01-01", "2024-01-01 is not a number"),
        ("material.youngs_modulus=[1.0]", "[1.0] is not a number"),
        ("material.youngs_modulus=" + "1" * 400, "a whole number of 400 digits is beyond 1e+100"),
        ("material.youngs_modulus=-1.0", "-1.0 is out of range. Use a number above 0"),
        ("material.youngs_modulus=0", "0 is out of range"),
        ("material.youngs_modulus=nan", "nan is not finite. Use a number above 0"),
        ("material.youngs_modulus=inf", "inf is not finite"),
        ("material.poissons_ratio=0.5", "0.5 is out of range. Use a number above -1 and below 0.5."),
        ("mesh.spacing=-0.1", "-0.1 is out of range"),
        ("mesh.lower=[0.0, 0.0]", "[0.0, 0.0] has 2 numbers. Write three numbers [x, y, z]."),
        ("mesh.lower=[0.0, 0.0, 0.0, 0.0]", "has 4 numbers. Write three numbers"),
        ("mesh.lower=1.0", "1.0 is not three numbers [x, y, z]."),
        ("mesh.lower=[-1.0, nan, -0.2]", "mesh.lower.1 = nan is not finite"),
        ('mesh.lower=[-1.0, "b", -0.2]', 'mesh.lower.1 = "b" is not a number'),
        ("coupling.overlap=0", "0 is out of range. Use a whole number of 1 or more."),
        ("coupling.overlap=1.5", "1.5 is not a whole number"),
        ("coupling.kind=papr", 'Use one of "paper", "paper_a", "exact". Did you mean paper?'),
        ("mesh.kind=plate", 'mesh.kind = "plate" is unknown. Give kind = "box" or kind = "plate_with_hole" or'),
        ("title=3", '3 is not a text in quotes ("...")'),
        ("output.fields=1", "1 is not true or false"),
        ("solver.tolerance=1.0", "1.0 is out of range. Use a number above 0 and below 1."),
        ("stepping.load_factors=[]", "[] is empty"),
        ("stepping.load_factors=[1.0, 0.5]", "has 0.5 after 1.0"),
        ("regions=[]", "Add at least one table [[regions]]"),
        ("regions.0.name=''", "is empty. Give the region a name"),
        ("mesh=3", "mesh = 3 is not a table. Write its keys under a line [mesh]."),
        ("loads=3", "loads = 3 is not a list of tables"),
        ("loads=[3]", "loads.0 = 3 is not a table"),
        ("loads={kind = 'traction'}", "loads is one table and must be a list of tables. Write [[loads]]"),
        ("solver=[{kind = 'adr'}]", "solver is a list and must be one table. Write [solver]"),
        ("loads.0.kind=body_froce", 'loads.0.kind = "body_froce" is unknown'),
        ("loads.0.kind=3", "loads.0.kind = 3 is unknown"),
        ("loads.0.face=left", 'Use one of "x-", "x+", "y-", "y+", "z-", "z+".'),
        ("loads.0.density=[1, 0, 0]", "must have either density or total, and has both"),
        ("mesh.spacing=0.07", "0.07 does not divide the box's sides x = 2 and y = 0.4 and z = 0.4"),
        ("material.poissons_ratio=0.495", "0.495 is out of range for bonds"),
        ("peridynamics.cutoff_radius=0.05", "0.05 is below mesh.spacing = 0.1"),
    ],
)
def test_wrong_value(override, sentence):
    message = only(override)
    assert sentence in message
    assert message.startswith(f"bar.toml: {override.partition('=')[0].partition('.')[0]}")


PLATE = SOUND.replace("[mesh]\n", '[mesh]\nkind = "plate_with_hole"\nhole_radius = 0.2\n').replace(
    "-0.2, -0.2]\nupper = [1.0, 0.2, 0.2]", "-0.5, -0.2]\nupper = [1.0, 0.5, 0.2]"
)


@pytest.mark.parametrize("kind", ["", 'kind = "box"\n'], ids=["left out", "given"])
def test_mesh_is_a_box_by_default(kind):
    """The kind may be left out; it is written into complete decks."""
    scene = parse_deck(SOUND.replace("[mesh]\n", f"[mesh]\n{kind}"), "x")
    assert isinstance(scene.mesh, BoxMesh)
    assert 'kind = "box"' in write_deck(scene)


def test_plate_with_hole_is_read_and_written():
    scene = parse_deck(PLATE, "x")
    assert isinstance(scene.mesh, PlateWithHoleMesh)
    assert parse_deck(write_deck(scene), "x") == scene


@pytest.mark.parametrize(
    ("override", "sentence"),
    [
        ("mesh.hole_radius=0", "mesh.hole_radius = 0 is out of range. Use a number above 0 (dimension length)."),
        ("mesh.hole_radius=0.4", "mesh.hole_radius = 0.4 does not fit: it leaves 0.1 between the hole and"),
        ("mesh.hole_radius=0.1", "mesh.hole_radius = 0.1 is below 2 * spacing = 0.2"),
        ("mesh.hole_raduis=0.1", "unknown key mesh.hole_raduis = 0.1. Did you mean hole_radius?"),
        ("mesh.spacing=0.07", "mesh.spacing = 0.07 does not divide the box's sides"),
        ("mesh.kind=plate_with_holes", 'or kind = "file". Did you mean plate_with_hole?'),
        ("mesh.kind=box", 'unknown key mesh.hole_radius = 0.2. It is a key of kind = "plate_with_hole": set that kind'),
        ("mesh.kind=3", "mesh.kind = 3 is unknown. Give kind ="),
        ("mesh.lower=[0, 0]", "[0, 0] has 2 numbers"),
        ("probes.0={kind = 'line', name = 'a', start = [0, 0, 0], stop = [1, 0, 0], n = 1}", "probes.0.n = 1 is out"),
        ("probes.0={kind = 'line', name = 'a b', start = [0, 0, 0], stop = [1, 0, 0]}", "Use letters, digits, - and _"),
        ("probes.0={kind = 'line', name = 'a', start = [0, 0, 0]}", "probes.0.stop is missing. Give the last point"),
    ],
)
def test_wrong_value_of_a_plate_or_line(override, sentence):
    assert sentence in only(override, text=PLATE)


def test_missing_hole_radius_has_an_example():
    message = only(text=PLATE.replace("hole_radius = 0.2\n", ""))
    assert message == "bar.toml: mesh.hole_radius is missing. Give the radius of the hole, for example 0.4."


def test_checks_of_a_bad_plate_go_on():
    """A wrong radius hides neither the spacing nor checks between tables."""
    messages = problems(PLATE, "mesh.hole_radius=x", "mesh.spacing=0.07", "peridynamics.cutoff_radius=0.01")
    for key in ("mesh.hole_radius", "mesh.spacing = 0.07 does not", "peridynamics.cutoff_radius"):
        assert sum(key in message for message in messages) == 1, messages
    assert len(messages) == 3


def test_load_without_kind():
    message = only(text=without('kind = "traction"\n'))
    kinds = " or ".join(f'kind = "{kind}"' for kind in ("body_force", "traction", "pressure", "force"))
    assert message == f"bar.toml: loads.1 has no kind. Give {kinds}."


def test_nothing_that_moves():
    assert "loads and supports are both empty" in only("loads=[]")


# --- all at once ------------------------------------------------------------------------------------------


def test_all_problems_are_reported_at_once():
    """A wrong key hides neither its neighbours, nor checks between tables that do not need it."""
    messages = problems(
        SOUND,
        "material.youngs_modulus=stiff",
        "material.poissons_ratio=0.495",
        "mesh.spacng=1",
        "peridynamics.internal_length=0.2",
        "peridynamics.cutoff_radius=0.05",
        "peridynamics.kinematics=cubic",
        "regions.0.model=elements",
        "loads.0.region=bnds",
        "solver.tolerance=nan",
        "stepping.load_factors=[2, 1]",
        "supports=[{}]",
        "probes.0.point=[0]",
        "output.colour=1",
        "nonsense",
    )
    keys = [
        "material.youngs_modulus",
        "material.poissons_ratio",
        "mesh.spacng",
        "peridynamics.cutoff_radius = 0.05 is below internal_length",
        "peridynamics.cutoff_radius = 0.05 is below mesh.spacing",
        "peridynamics.kinematics",
        "regions.0.model",
        "loads.0.region",
        "loads.0 must say where",
        "solver.tolerance",
        "stepping.load_factors",
        "supports.0 must say where",
        "supports.0 prescribes nothing",
        "probes.0.point",
        "output.colour",
        "--set nonsense",
    ]
    for key in keys:
        assert sum(key in message for message in messages) == 1, (key, messages)
    assert len(messages) == len(keys)


def test_list_whose_only_item_is_wrong_is_not_called_empty():
    text = SOUND[: SOUND.index("[[regions]]")] + "[[regions]]\nname = 'bonds'\nmodel = 'x'\n"
    messages = problems(text, "supports=[{face = 'x-', x = 0.0}]")
    assert len(messages) == 1 and "regions.0.model" in messages[0], messages


def test_no_problem_is_reported_twice():
    messages = problems(SOUND, "mesh.spacing=0.07", "mesh.lower=[0, 0, 0]", "title=3", "loads.0.kind=x")
    assert len(messages) == len(set(messages)) == 3


@pytest.mark.parametrize(
    ("key", "dimension"),
    [
        ("mesh.spacing", "length"),
        ("mesh.upper.2", "length"),
        ("regions.bonds.lower", "length"),
        ("loads.0.total", "force"),
        ("materials.steel.youngs_modulus", "force / length^2"),
        ("title", ""),
        ("solver.max_evaluations", ""),
    ],
)
def test_dimension_of_a_key(key, dimension):
    """What labels of studies print units from; items of lists by index or name."""
    text = SOUND + "[materials.steel]\nyoungs_modulus = 2.0e7\n"
    scene = parse_deck(text, "deck.toml", ("regions.bonds.material=steel",))
    assert dimension_of(scene, key) == dimension


def test_conjugate_gradients_are_the_default_and_relaxation_is_that_of_a_ramp():
    assert parse_deck(SOUND, "bar.toml").solver.kind == "cg"
    ramp = ("material.critical_stretch=0.01", "stepping.kind=ramp", "stepping.increment=1e-4")
    assert parse_deck(SOUND, "bar.toml", ramp).solver.kind == "adr"
    assert parse_deck(SOUND, "bar.toml", (*ramp, "solver.tolerance=1e-3")).solver.kind == "adr"
    assert any("solver.kind" in message for message in problems(SOUND, *ramp, "solver.kind=cg"))
    messages = problems(SOUND, *ramp, "mesh.spacing=-1")  # a deck with another mistake is not told of a solver too
    assert len(messages) == 1 and "mesh.spacing" in messages[0]


def test_numbers_and_arrays_of_numpy_serve_in_dictionaries():
    """The same scene, with plain numbers in it, and the same sentences about what is wrong."""
    plain = tomllib.loads(SOUND)
    given = copy.deepcopy(plain)
    given["mesh"] |= {"lower": np.array(plain["mesh"]["lower"]), "spacing": np.float64(0.1)}
    given["regions"][0]["upper"] = tuple(np.array([0.0, 0.2, 0.2]))
    given["cracks"] = [{"polygon": np.array([[0.5, -1, -1], [0.5, 1, -1], [0.5, 1, 1]])}]
    plain["cracks"] = [{"polygon": [[0.5, -1, -1], [0.5, 1, -1], [0.5, 1, 1]]}]
    keys = {"solver.max_evaluations": 500, "output.damage": True, "mesh.upper": [1.0, 0.2, 0.2]}
    of_numpy = {
        "solver.max_evaluations": np.int64(500), "output.damage": np.bool_(True),
        "mesh.upper": np.array([1.0, 0.2, 0.2]),
    }  # fmt: skip
    expected, found = read_deck(plain, keys), read_deck(given, of_numpy)
    assert found == expected
    assert type(found.solver.max_evaluations) is int and type(found.mesh.spacing) is float
    with pytest.raises(DeckError, match=r"mesh.spacing = -0.5 is out of range"):
        read_deck(plain, {"mesh.spacing": np.float32(-0.5)})
