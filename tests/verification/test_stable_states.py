"""Peaks of stable states: a tenfold tighter tolerance changes nothing, nor do mirror planes in place of three quarters.

Residuals of 1e-3 alone let the plate's quarter with "virial" carry 2 % more than it can. Under energy control whole
bodies take long: docs/failure.md has their peaks.
"""

import pytest

from pdfem_mpi.deck.toml import parse_deck
from support.failing import followed
from support.helpers import ROOT

PEAK = 1e-3  # as promised; 1e-8 is found
CASES = {
    "plate, virial": ("plate_cutout.toml", ["mesh.spacing=0.1", "peridynamics.surface_correction=virial"]),
    "plate, appendix A": ("plate_cutout.toml", ["mesh.spacing=0.1"]),
    "centre crack": ("plate_centre_crack.toml", ["stepping.end_reaction=0.9"]),
    "double cantilever": ("double_cantilever.toml", ["stepping.end_load_factor=0.6"]),
}
MIRRORS = {"plate_cutout.toml": "xy", "plate_centre_crack.toml": "xy", "double_cantilever.toml": "xz"}


def read(deck, overrides):
    return parse_deck((ROOT / "jobs" / deck).read_text(encoding="utf-8"), deck, overrides)


def part(scene, axes):
    """What lies above mirror planes at 0: regions and supports on the other side are left out."""
    lower = tuple(0.0 if axis in axes else low for axis, low in zip("xyz", scene.mesh.lower, strict=True))
    kept = {
        "regions": tuple(r for r in scene.regions if r.upper is None or r.upper[0] > 0.0),
        "supports": tuple(s for s in scene.supports if s.face != "x-" and (s.upper is None or s.upper[0] > 0.0)),
        "mesh": scene.mesh.model_copy(update={"lower": lower, "symmetry": tuple(f"{axis}-" for axis in axes)}),
    }
    return scene.model_copy(update=kept)


def peak(scene, tolerance=None):
    if tolerance is not None:
        scene = scene.model_copy(update={"stepping": scene.stepping.model_copy(update={"arrest_tolerance": tolerance})})
    return max(row.reaction for row in followed(scene).rows if row.event == "critical")


@pytest.mark.slow
@pytest.mark.parametrize("name", CASES)
def test_peaks_of_the_default_tolerance(name):
    """Within 0.1 % of a tolerance ten times tighter; at a held load the whole's is twice that of a quarter."""
    deck, overrides = CASES[name]
    scene = read(deck, overrides)
    quarter = part(scene, MIRRORS[deck])
    found = peak(quarter)
    assert peak(quarter, 0.1 * scene.stepping.arrest_tolerance) == pytest.approx(found, rel=PEAK)
    if scene.stepping.control == "load":
        assert peak(scene) == pytest.approx(2.0 * found, rel=PEAK)
