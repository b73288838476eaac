"""Section 4.2: the plate with a circular cutout meshed by Gmsh gives the answer of the structured mesh."""

import importlib.util

import pytest

from support.bodies import run_deck
from support.helpers import ROOT

# Displacements of plate_fe.toml in in: of the end in x, and of the hole's top in y, with mesh.spacing=0.025.
FINE = {"right_end": (0, 4.7724e-3), "top_of_hole": (1, -4.949e-4)}
# Errors of the structured mesh with cells of 0.2, 0.1 and 0.05: measured -0.62, -0.14, -0.03 % and -14.3, -3.6, -0.8 %.
# Gmsh's mesh has shorter edges at the hole: -0.35, -0.11, -0.02 % and -6.0, -2.5, -0.3 %.
SYMMETRY = 1e-6  # of the end displacement: the solver's tolerance


def displacements(deck, out, *overrides):
    probes = run_deck(deck, out, *overrides)["probes"]
    return probes, {name: probes[name][axis] for name, (axis, _) in FINE.items()}


def check(tmp_path, spacing, mesh):
    """Displacements rise to those of the fine mesh, and the meshes differ by less than the structured one's error."""
    _, structured = displacements("plate_fe.toml", tmp_path / "structured", f"mesh.spacing={spacing}")
    probes, by_gmsh = displacements("plate_fe_gmsh.toml", tmp_path / "gmsh", *mesh)
    for name, (_, fine) in FINE.items():
        ratios = [found[name] / fine for found in (structured, by_gmsh)]
        assert ratios[0] < ratios[1] < 1.0, (name, ratios)
    assert abs(probes["right_end"][1]) <= SYMMETRY * by_gmsh["right_end"]
    assert abs(probes["top_of_hole"][0]) <= SYMMETRY * by_gmsh["right_end"]


def test_plate_by_gmsh_agrees_within_the_discretization_error(tmp_path):
    """The mesh that comes with the deck, cells of 0.2 in: format 4.1, groups of volumes and surfaces."""
    check(tmp_path, 0.2, ())


@pytest.mark.slow
@pytest.mark.parametrize("spacing", [0.1, 0.05])
def test_finer_plates_by_gmsh(tmp_path, spacing):
    """The script of jobs/meshes makes any spacing."""
    pytest.importorskip("gmsh", reason="the extra gmsh is not installed", exc_type=ImportError)
    path = ROOT / "jobs" / "meshes" / "plate_with_hole_gmsh.py"
    spec = importlib.util.spec_from_file_location("plate_with_hole_gmsh", path)
    script = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(script)
    script.make_plate(spacing, tmp_path / "plate.msh")
    check(tmp_path, spacing, (f"mesh.path={tmp_path / 'plate.msh'}",))
