"""A mesh file is read by rank 0 and is the same on all ranks; what is wrong with it is told on all of them."""

from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
import pytest

from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh.generators import box
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.parallel.comm import broadcast
from pdfem_mpi.runs import prepare as preparing
from support.bodies import make_scene
from support.helpers import ROOT, assert_all
from support.mesh_files import write_mesh

pytestmark = pytest.mark.mpi(min_size=2)


def scene_of(path):
    supports = (Support(face="x-", x=0.0, y=0.0, z=0.0),)
    return make_scene((1, 1, 1), 1, loads=(), supports=supports, mesh=FileMesh(path=str(path)))


def test_rank_0_reads_and_all_have_the_mesh(comm):
    """With the named sets, and no other rank opens the file."""
    with (
        patch.object(preparing, "make_mesh", wraps=preparing.make_mesh) as reading,
        patch.object(preparing, "share_of", wraps=preparing.share_of) as cutting,
    ):
        preparing.prepare(scene_of(ROOT / "jobs" / "meshes" / "plate_with_hole.msh"), comm)
    mesh = cutting.call_args.args[2]
    digests = comm.allgather((mesh.sha256(), len(mesh.cells), sorted(mesh.cell_sets)))
    assert_all(comm, reading.call_count == (comm.rank == 0), "only rank 0 reads")
    assert_all(comm, all(digest == digests[0] for digest in digests) and digests[0][1] == 600, digests)


def test_a_bad_mesh_is_refused_on_all_ranks(comm):
    """Rank 0 alone sees the file; the sentence reaches every rank, and none waits."""
    mesh = box((0.0, 0.0, 0.0), (2.0, 1.0, 1.0), (2, 1, 1))
    folder = TemporaryDirectory() if comm.rank == 0 else None
    path = Path(broadcast(comm, folder and folder.name)) / "bad.vtu"
    if folder:
        write_mesh(path, HexMesh(mesh.nodes * np.array([-1.0, 1.0, 1.0]), mesh.cells))
    messages = []
    try:
        preparing.prepare(scene_of(path), comm)
    except SceneError as error:
        messages = error.messages
    comm.Barrier()
    if folder:
        folder.cleanup()
    assert_all(comm, len(messages) == 1 and "2 of 2 cells that are wound clockwise" in messages[0], messages)
