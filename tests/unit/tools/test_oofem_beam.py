"""The peer's beam: its input is the deck's, its output is read, and without the peer one sentence says so."""

import importlib.util
from importlib.machinery import SourceFileLoader

import pytest

from support.helpers import ROOT, run_python

PATH = ROOT / "tools" / "benchmarks" / "oofem_beam"
OUTPUT = """
Output for time 0.000e+00, solution step number 1
Node 5 iDof  2 reaction  0.0000e+00    [bc-id: 2]
Output for time 4.400e+01, solution step number 2
Node 5 iDof  2 reaction -9.0e+01    [bc-id: 2]
Node 6 iDof  2 reaction -8.0e+01    [bc-id: 2]
Node 1 iDof  2 reaction  1.7e+02    [bc-id: 1]
"""


@pytest.fixture(scope="module")
def beam():
    loader = SourceFileLoader("oofem_beam", str(PATH))
    module = importlib.util.module_from_spec(importlib.util.spec_from_loader("oofem_beam", loader))
    loader.exec_module(module)
    return module


def test_the_input_has_the_deck_of_the_beam(beam, tmp_path):
    cells = beam.write_input(tmp_path / "beam.in", 10)
    assert cells == 81 * 10 - 1  # an odd number along the beam, less the notch
    text = (tmp_path / "beam.in").read_text()
    assert text.count("\nnode ") == 82 * 11 - 2 + 2 and text.count("\nPlaneStress2D ") == cells
    assert "E 26110 n 0.2 ft 2.59" in text and "soft_w 3 0.0 0.0361 0.203" in text


def test_the_output_is_read(beam, tmp_path):
    path = tmp_path / "beam.out"
    path.write_text(OUTPUT)
    assert beam.read_output(path) == [(0.0, 0.0), (pytest.approx(beam.END), 170.0)]


def test_a_curve_through_the_measured_points_has_no_difference(beam):
    lines = [line.split(",") for line in beam.MEASURED.read_text().splitlines()[2:]]
    measured = [(float(x), float(y)) for x, y in lines]
    assert beam.difference([(0.0, 0.0), *measured]) == pytest.approx(0.0, abs=1e-12)


def test_without_the_peer_a_sentence_says_so():
    if importlib.util.find_spec("oofem"):
        pytest.skip("OOFEM is here")
    answer = run_python("tools/benchmarks/oofem_beam")
    assert answer.returncode == 1 and "has no OOFEM" in answer.stderr and "Traceback" not in answer.stderr
