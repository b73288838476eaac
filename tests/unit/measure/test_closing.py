"""Crack faces that close are not in contact, and a run says so."""

import pytest

import pdfem_mpi as pdfem
from pdfem_mpi.deck.programs import Steps
from pdfem_mpi.measure.closing import measure_closing
from support.failing import followed, strip
from support.softening import soft_strip


@pytest.fixture(scope="module")
def top():
    """A load beyond the first break."""
    return 1.02 * followed(strip(), 1).rows[0].load_factor


@pytest.mark.parametrize("back", [0.5, 0.0, -0.8])
def test_faces_overlap_where_the_load_turns_its_sign(top, back):
    run = followed(strip(stepping=Steps(load_factors=(top, back * top), times=(1.0, 2.0))))
    found = measure_closing(run.body.share, run.body.forces, run.failure)
    assert bool(found.warning) == (back < 0.0)
    if back < 0.0:
        assert found.depth > 0.1 * 0.002  # of the stretch at which the strip's bonds break
        assert "crack faces overlap" in found.warning and "not in contact" in found.warning


def test_bonds_that_have_softened_and_still_hold_do_not_count():
    """A strip that softens and is pressed: before the first bond is gone nothing is told."""
    run = followed(soft_strip(crack=(-1.0, 2.1), stepping=Steps(load_factors=(0.5, -0.4), times=(1.0, 2.0))))
    assert run.failure.soft > 0 and run.failure.count == 0
    assert not measure_closing(run.body.share, run.body.forces, run.failure).warning


def test_a_run_says_it_once(top, tmp_path):
    scene = strip(stepping=Steps(load_factors=(top, -0.8 * top, -0.9 * top), times=(1.0, 2.0, 3.0)))
    lines = []
    pdfem.run(scene, tmp_path / "run", report=lines.append)
    assert sum("crack faces overlap" in line for line in lines) == 1
