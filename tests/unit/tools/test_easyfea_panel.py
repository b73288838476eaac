"""The phase field's panel: it is the deck's, and without the peer one sentence says so."""

import importlib.util
import tomllib
from importlib.machinery import SourceFileLoader

import pytest

from support.helpers import ROOT, run_python

PATH = ROOT / "tools" / "benchmarks" / "easyfea_panel"


def test_the_panel_is_that_of_the_deck():
    loader = SourceFileLoader("easyfea_panel", str(PATH))
    panel = importlib.util.module_from_spec(importlib.util.spec_from_loader("easyfea_panel", loader))
    loader.exec_module(panel)
    deck = tomllib.loads(panel.DECK.read_text(encoding="utf-8"))
    (corner,) = deck["mesh"]["remove"]
    assert deck["mesh"]["upper"] == [panel.WIDE, panel.WIDE, 0.5 * panel.THICKNESS]
    assert corner["lower"][0] == corner["upper"][1] == panel.LEG
    (lift,) = (one for one in deck["supports"] if one["name"] == "lift")
    assert {tuple(end[:2]) for end in lift["line"]} == {(panel.LIFTED, panel.LEG)}
    assert {"youngs_modulus", "fracture_energy"} <= set(deck["material"])


def test_without_the_peer_a_sentence_says_so():
    if importlib.util.find_spec("EasyFEA"):
        pytest.skip("EasyFEA is here")
    answer = run_python("tools/benchmarks/easyfea_panel")
    assert answer.returncode == 1 and "has no EasyFEA" in answer.stderr and "Traceback" not in answer.stderr
