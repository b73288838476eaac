"""Keys of bonds that soften: what belongs together, what is refused by name, and defaults that they bring."""

import pytest

from pdfem_mpi.deck.table import DeckError
from pdfem_mpi.deck.toml import parse_deck, write_deck

BASE = """
[mesh]
lower = [0.0, 0.0, 0.0]
upper = [8.0, 4.0, 1.0]
spacing = 1.0
[material]
youngs_modulus = 1000.0
{material}
[[regions]]
name = "bonds"
model = "peridynamics"
[peridynamics]
kinematics = "linear"
{peridynamics}
[[supports]]
face = "x-"
x = 0.0
[[supports]]
face = "x+"
x = 0.1
[solver]
kind = "cg"
[stepping]
{stepping}
{more}
"""
PAIR = "tensile_strength = 2.0\nfracture_energy = 1.0"
EVENTS = 'kind = "events"'


def deck(material=PAIR, stepping=EVENTS, peridynamics="", more=""):
    return BASE.format(material=material, stepping=stepping, peridynamics=peridynamics, more=more)


def refusals(**parts):
    with pytest.raises(DeckError) as refused:
        parse_deck(deck(**parts), "deck.toml")
    return refused.value.messages


def test_defaults_of_decks_that_soften():
    """Wide batches, few sweeps and some noise, where the deck says nothing; what it says stays. Others keep theirs."""
    scene = parse_deck(deck(), "deck.toml")
    assert (scene.stepping.eta, scene.stepping.inner_iterations, scene.peridynamics.stiffness_noise) == (1e-2, 4, 0.005)
    given = parse_deck(deck(stepping=f"{EVENTS}\neta = 0.003", peridynamics="stiffness_noise = 0.0"), "deck.toml")
    assert (given.stepping.eta, given.stepping.inner_iterations, given.peridynamics.stiffness_noise) == (0.003, 4, 0.0)
    brittle = parse_deck(deck("critical_stretch = 0.002"), "deck.toml")
    assert (brittle.stepping.eta, brittle.stepping.inner_iterations) == (1e-3, 8)
    assert brittle.peridynamics.stiffness_noise == 0.0 and not brittle.softens
    steps = parse_deck(deck(stepping="load_factors = [0.5]"), "deck.toml")
    assert steps.softens and steps.peridynamics.stiffness_noise == 0.005


@pytest.mark.parametrize(
    "material",
    [
        PAIR,
        f'{PAIR}\nsoftening = "line"',
        f"{PAIR}\nkink_stretch_ratio = 0.26\nkink_force_ratio = 0.114",
        "traction_opening = [[0.0, 2.6], [0.036, 0.6], [0.2, 0.0]]",
    ],
)
def test_decks_are_written_and_read_again(material):
    """The complete deck of a scene gives an equal scene."""
    scene = parse_deck(deck(material), "deck.toml")
    assert parse_deck(write_deck(scene), "again.toml") == scene


@pytest.mark.parametrize(
    "material, words",
    [
        ("tensile_strength = 2.0", "material.tensile_strength = 2.0 needs fracture_energy beside it"),
        (f"{PAIR}\ncritical_stretch = 0.1", "material.critical_stretch and tensile_strength are both given"),
        (
            "critical_stretch = 0.1\nfracture_energy = 1.0",
            "material.critical_stretch and fracture_energy are both given",
        ),
        ('softening = "drop"\ncritical_stretch = 0.1', 'material.softening = "drop" shapes bonds that soften'),
        ('tensile_strength = 2.0\nfracture_energy = 1.0\nsoftening = "bend"', 'material.softening = "bend"'),
        (f"{PAIR}\nkink_force_ratio = 0.1", "material.kink_force_ratio is given without kink_stretch_ratio"),
        (f"{PAIR}\nkink_force_ratio = 0.6\nkink_stretch_ratio = 0.2", "material.kink_force_ratio = 0.6"),
        (
            f'{PAIR}\nsoftening = "line"\nkink_force_ratio = 0.1\nkink_stretch_ratio = 0.2',
            'material.kink_stretch_ratio belongs to softening = "drop"',
        ),
        (f"{PAIR}\ntraction_opening = [[0.0, 2.0], [1.0, 0.0]]", "and traction_opening are both given"),
        ("traction_opening = [[0.0, 2.0], [1.0, 0.5]]", "must have tractions that fall to 0"),
        ("traction_opening = [[0.1, 2.0], [1.0, 0.0]]", "must begin with opening 0"),
        ("traction_opening = [[0.0, 2.0], [0.0, 1.0], [1.0, 0.0]]", "must have rising openings"),
        ("traction_opening = [[0.0, 2.0]]", "material.traction_opening = [[0.0, 2.0]] needs two points or more"),
        ("traction_opening = [[0.0, 2.0], [1.0]]", "Write two numbers [opening, traction]"),
        ("tensile_strength = -2.0\nfracture_energy = 1.0", "material.tensile_strength = -2.0"),
    ],
)
def test_keys_that_do_not_go_together(material, words):
    messages = refusals(material=material)
    assert any(words in message for message in messages), messages
    assert all("Traceback" not in message and message.startswith("deck.toml: ") for message in messages)


def test_teeth_are_of_bonds_that_soften():
    (message,) = refusals(material="critical_stretch = 0.002", stepping=f"{EVENTS}\ntooth_ratio = 1.2")
    assert "stepping.tooth_ratio = 1.2 is of bonds that soften" in message
    (message,) = refusals(stepping=f"{EVENTS}\ntooth_ratio = 1.0")
    assert "stepping.tooth_ratio = 1.0" in message


def test_fitted_factors_of_both_signs_cannot_soften():
    (message,) = refusals(peridynamics='surface_correction = "fitted"\nsigns = "free"')
    assert 'peridynamics.signs = "free" lets bonds push where they are stretched' in message


def test_all_problems_at_once():
    """A deck with several mistakes gets a sentence for each."""
    more = "[materials.other]\nyoungs_modulus = 10.0\ntensile_strength = 1.0\n"
    messages = refusals(material=f"{PAIR}\ncritical_stretch = 0.1", stepping=f"{EVENTS}\ntooth_ratio = 3.0", more=more)
    for key in ("material.critical_stretch", "stepping.tooth_ratio", "materials.other.tensile_strength"):
        assert any(key in message for message in messages), messages


def test_strength_without_bonds_is_refused():
    text = deck().replace('model = "peridynamics"', 'model = "finite_elements"').replace(EVENTS, 'kind = "steps"')
    with pytest.raises(DeckError) as refused:
        parse_deck(text, "deck.toml")
    assert any("breaks bonds, and no region has any" in message for message in refused.value.messages)


def test_any_poissons_ratio_of_bonds():
    """The volumetric part softens with its bonds."""
    assert parse_deck(deck(material=f"{PAIR}\npoissons_ratio = 0.39"), "deck.toml").softens
    messages = refusals(material=f"{PAIR}\npoissons_ratio = 0.39", peridynamics='surface_correction = "fitted"')
    assert any("does not go with peridynamics.surface_correction" in text for text in messages)
