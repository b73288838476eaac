"""A run on coarser cells says where bonds are needed."""

import numpy as np
import pytest

from pdfem_mpi import Simulation
from pdfem_mpi.deck.meshes import BoxMesh
from pdfem_mpi.deck.table import SceneError, Units
from pdfem_mpi.deck.toml import write_deck
from pdfem_mpi.parallel.comm import mpi
from support.adaptive import CELLS, NOTCH, plate, rows_of
from support.restarts import alone


def test_what_broke_in_the_pilot_is_turned_from_the_beginning(tmp_path):
    """A region that stays then holds to the end, on cells half as wide as well."""
    assert alone(plate(), tmp_path / "pilot") == 0
    settings = {"growth": 0.0, "pilot": str(tmp_path / "pilot"), "pilot_distance": 3.0}
    simulation = Simulation(plate(adaptive=settings), mpi().COMM_SELF)
    first = simulation.share.found.turned
    rows = rows_of(simulation)
    assert rows[-1]["event"] == "end"
    assert {row["event"] for row in rows} >= {"critical", "batch"}
    assert "switch" not in {row["event"] for row in rows}
    np.testing.assert_array_equal(simulation.share.found.turned, first)

    finer = BoxMesh(lower=(0.0, 0.0, 0.0), upper=CELLS, spacing=0.5, remove=(NOTCH,))
    twice = plate(adaptive=settings | {"pilot_distance": None})
    found = Simulation(twice.model_copy(update={"mesh": finer}), mpi().COMM_SELF)
    centroids = found.share.mesh.centroids[found.share.found.is_turned]
    assert found.share.counts.cells == 8 * simulation.share.counts.cells
    assert np.ptp(centroids[:, 1]) > 6.0  # along the whole way of the crack


def test_a_folder_without_broken_bonds_is_refused(tmp_path):
    scene = plate(adaptive={"pilot": str(tmp_path)})
    with pytest.raises(SceneError, match=r"adaptive\.pilot = .* is no run folder"):
        Simulation(scene, mpi().COMM_SELF)
    (tmp_path / "deck.toml").write_text("", encoding="utf-8")
    with pytest.raises(SceneError, match="has no checkpoint"):
        Simulation(scene, mpi().COMM_SELF)


@pytest.mark.parametrize(
    ("units", "scale", "part"),
    [
        (("mm", "N"), 1.0, 'has units.length = "mm", and this deck "m". Give a run in the same units'),
        (("m", "N"), 1000.0, r"in \[0, 18000\] x \[0, 12000\] x \[0, 1000\], and that of this deck lies in \[0, 18\]"),
    ],
)
def test_a_pilot_of_another_body_is_refused(tmp_path, units, scale, part):
    """Places in other units would turn cells that are not meant, or none."""
    folder = tmp_path / "pilot"
    (folder / "checkpoints").mkdir(parents=True)
    upper = tuple(scale * side for side in CELLS)
    mesh = BoxMesh(lower=(0.0, 0.0, 0.0), upper=upper, spacing=scale)
    tables = {"units": Units(length=units[0], force=units[1])}
    (folder / "deck.toml").write_text(write_deck(plate(**tables).model_copy(update={"mesh": mesh})))
    (folder / "checkpoints" / "ckpt-000001.h5").write_bytes(b"of no interest")
    scene = plate(adaptive={"pilot": str(folder)}, units=Units(length="m", force="N"))
    with pytest.raises(SceneError, match=rf"adaptive\.pilot = .*{part}"):
        Simulation(scene, mpi().COMM_SELF)


def test_a_torn_checkpoint_is_named(tmp_path):
    """A sentence on all ranks, and no error of the library that reads it."""
    folder = tmp_path / "pilot"
    (folder / "checkpoints").mkdir(parents=True)
    (folder / "deck.toml").write_text(write_deck(plate()))
    (folder / "checkpoints" / "ckpt-000001.h5").write_bytes(b"torn")
    with pytest.raises(SceneError, match=r"pilot = .* has a checkpoint that cannot be read .* Run it again"):
        Simulation(plate(adaptive={"pilot": str(folder)}), mpi().COMM_SELF)
