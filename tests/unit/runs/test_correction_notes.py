"""A surface correction that did not converge is told, with its place; those that did say nothing."""

import json

import numpy as np
import pytest

from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.model.model import build_model
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.peridynamics.uneven import CONVERGED
from pdfem_mpi.runs.correction_notes import describe_correction
from support.bodies import YOUNGS_MODULUS, local_share, make_scene
from support.reporters import Listener
from support.restarts import alone

CELLS = 4, 2, 1
CORNERS = 0.3  # shift of nodes, in cells
REGULAR = 0.2  # as the warning says


def notes(correction, corners, cells=CELLS, contrast=0.1, stop=4.0):
    """Two materials, side by side, one cell thick; nodes shifted at random up to a place along x."""
    regions = (
        Region(name="first", model="peridynamics", upper=(2.0, float(cells[1]), 1.0)),
        Region(name="second", model="peridynamics", material="other", lower=(2.0, 0.0, 0.0)),
    )
    materials = {"other": Material(youngs_modulus=contrast * YOUNGS_MODULUS)}
    scene = make_scene(cells, correction=correction, loads=(), regions=regions, materials=materials)
    share = local_share(scene)
    places = share.nodes * share.units.length + share.units.origin
    moving = places[:, 0] < stop
    shift = corners * np.random.default_rng(1).uniform(-1.0, 1.0, share.nodes.shape)
    share.nodes[moving] += shift[moving]
    model = build_model(scene, share, mpi().COMM_SELF)
    return model, list(describe_correction(scene, share, model))


@pytest.mark.parametrize("correction", ["virial", "appendix_a"])
def test_an_unconverged_correction_is_told(correction):
    model, (note,) = notes(correction, CORNERS)
    assert model.correction_remaining > CONVERGED
    assert note.startswith(f'warning: the surface correction "{correction}" did not converge in its 20 sweeps')
    assert f"is still {model.correction_remaining:.2g}" in note
    other = "none" if correction == "appendix_a" else "appendix_a"
    assert f'peridynamics.surface_correction = "{other}"' in note


def test_its_place_is_told():
    """Only the cells at one end are distorted."""
    _, (note,) = notes("virial", CORNERS, cells=(10, 1, 1), contrast=1.0, stop=1.5)
    x, y, z = map(float, note.split("near (")[1].split(")")[0].split(", "))
    assert -CORNERS < x < 3.0 and -CORNERS < y < 1.0 + CORNERS and -CORNERS < z < 1.0 + CORNERS


@pytest.mark.parametrize("correction", ["virial", "appendix_a", "none"])
def test_regular_cells_say_nothing(correction):
    model, told = notes(correction, 0.0)
    assert model.correction_remaining < REGULAR and told == []


def test_a_run_tells_it(tmp_path):
    """Cubes between mirror planes, one across, whose halves differ 40 times: their correction does not converge."""
    regions = (
        Region(name="hard", model="peridynamics", upper=(1.0, 1.0, 1.0)),
        Region(name="soft", model="peridynamics", material="other", lower=(0.0, 0.0, 1.0)),
    )
    mesh = BoxMesh(lower=(0.0, 0.0, 0.0), upper=(1.0, 1.0, 4.0), spacing=1.0, symmetry=("x+", "y-", "y+"))
    tables = {
        "materials": {"other": Material(youngs_modulus=YOUNGS_MODULUS / 40.0)},
        "supports": (Support(face="z-", x=0.0, y=0.0, z=0.0), Support(face="z+", z=0.01)),
        "output": Output(fields=False, figures=False),
    }
    scene = make_scene((1, 1, 4), correction="virial", loads=(), regions=regions, mesh=mesh, **tables)
    reporter = Listener()
    assert alone(scene, tmp_path / "run", reporter=reporter) == 0
    remaining = json.loads((tmp_path / "run" / "summary.json").read_text())["surface_correction"]["remaining"]
    assert remaining > CONVERGED
    told = [text for text in reporter.lines if "did not converge" in text]
    assert len(told) == 1 and f"{remaining:.2g}" in told[0]
