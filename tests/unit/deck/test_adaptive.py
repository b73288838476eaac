"""Deck tables of a region that is found: what is filled in, and what is refused by name."""

import pytest

from pdfem_mpi import read_deck
from pdfem_mpi.deck.table import DeckError
from pdfem_mpi.deck.toml import parse_deck, write_deck

SOUND = """
regions = "auto"
[mesh]
kind = "box"
lower = [0.0, 0.0, 0.0]
upper = [8.0, 4.0, 1.0]
spacing = 1.0
[material]
youngs_modulus = 1000.0
critical_stretch = 0.002
[peridynamics]
surface_correction = "virial"
kinematics = "linear"
[[supports]]
face = "x-"
x = -0.01
[[supports]]
face = "x+"
x = 0.01
[stepping]
kind = "events"
"""


def refused(*overrides, text=SOUND):
    with pytest.raises(DeckError) as caught:
        parse_deck(text, "deck", list(overrides))
    return "\n".join(caught.value.messages)


def test_auto_is_one_region_and_a_table():
    scene = parse_deck(SOUND, "deck")
    assert [(region.name, region.model) for region in scene.regions] == [("body", "auto")]
    assert scene.is_adaptive
    assert scene.adaptive.threshold_with("virial") == 0.8
    assert scene.adaptive.threshold_with("appendix_a") == 0.75
    assert parse_deck(write_deck(scene), "deck") == scene


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("peridynamics.surface_correction=fitted", 'peridynamics.surface_correction = "fitted" does not go with'),
        ("coupling.kind=paper_a", 'coupling.kind = "paper_a" does not go with'),
        ("peridynamics.kinematics=finite", 'peridynamics.kinematics = "finite" does not go with'),
        ("material.poissons_ratio=0.3", "material.poissons_ratio = 0.3 is not 0.25"),
        ('adaptive.widening_check="end"', 'adaptive.widening_check = "end" is not true or false or "peak". Use'),
        ("temperature.change=10.0", 'temperature does not go with regions of model = "auto": bonds that break have no'),
        ("adaptive.growth=1.2", "adaptive.growth = 1.2 is not above reach = 1.5"),
        ("adaptive.threshold=3.0", "adaptive.threshold = 3"),
        ("adaptive.pilot_distance=3.0", "adaptive.pilot_distance = 3"),
        ("supports.0.region=body", 'supports.0.region = "body" has model = "auto"'),
    ],
)
def test_what_does_not_go_with_it_is_refused_by_name(override, words):
    text = SOUND.replace('face = "x-"\n', "") if "region=" in override else SOUND
    assert words in refused(override, text=text)


def test_the_default_kinematics_are_refused_with_what_to_write():
    said = refused(text=SOUND.replace('kinematics = "linear"\n', ""))
    assert 'peridynamics.kinematics is "finite" where it is not given' in said
    assert 'Set it to "linear"' in said


def test_bonds_that_soften_may_be_found():
    text = SOUND.replace("critical_stretch = 0.002\n", "tensile_strength = 2.0\nfracture_energy = 0.02\n")
    assert parse_deck(text, "deck").softens


def test_ties_of_an_automatic_region_are_refused():
    text = SOUND + '[[ties]]\nregion = "body"\nalong = ["x"]\n'
    assert 'ties.0.region = "body" has model = "auto"' in refused(text=text)


def test_times_are_refused():
    said = refused("stepping.kind=steps", "stepping.load_factors=[0.5, 1.0]", "stepping.times=[1.0, 2.0]")
    assert 'stepping.times = [1.0, 2.0] does not go with regions of model = "auto": a region that was found' in said


def test_regions_that_are_always_elements_are_refused_in_one_sentence():
    more = '[[regions]]\nname = "a"\nmodel = "auto"\nalways_elements = true\n'
    said = refused(text=SOUND.replace('regions = "auto"\n', "") + more)
    assert said == 'deck: regions leave no cell to "auto": all are always elements. Leave some.'


def test_ramps_are_refused():
    assert 'stepping.kind = "ramp" does not go with' in refused("stepping.kind=ramp", "stepping.increment=1e-4")


def test_the_table_needs_a_region():
    text = SOUND.replace('regions = "auto"\n', "") + '[[regions]]\nname = "a"\nmodel = "peridynamics"\n[adaptive]\n'
    assert 'adaptive is of regions with model = "auto"' in refused(text=text)


def test_drawn_bonds_beside_it_are_refused():
    more = '[[regions]]\nname = "a"\nmodel = "auto"\n[[regions]]\nname = "b"\nmodel = "peridynamics"\n'
    assert 'regions.1.model = "peridynamics" beside' in refused(text=SOUND.replace('regions = "auto"\n', "") + more)


def test_paths_of_pilots_are_those_of_the_deck(tmp_path):
    path = tmp_path / "deck.toml"
    path.write_text(SOUND + '[adaptive]\npilot = "coarse"\n', encoding="utf-8")
    assert read_deck(path).adaptive.pilot == str(tmp_path / "coarse")
