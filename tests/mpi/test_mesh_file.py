"""A mesh file is read by rank 0 and is the same on all ranks; what is wrong with it is told on all of them."""

from pathlib import Path
from tempfile import TemporaryDirectory
from unittest.mock import patch

import numpy as np
import pytest

from pdfem_mpi.deck.loads import Pressure, Support, Traction
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.removals import RemovedBox
from pdfem_mpi.deck.restraints import Spring
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh.carving import carve
from pdfem_mpi.mesh.generators import box
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.parallel.comm import broadcast, mpi
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.bonds import total_bonds
from pdfem_mpi.runs import prepare as preparing
from support.bodies import build, make_scene
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


def dented_notch():
    """A notch one cell wide between cells whose corners are shifted at random; its lower face z = 0 stays plane."""
    notch = RemovedBox(kind="box", lower=(3.0, 1.0, 0.0), upper=(4.0, 4.0, 9.0))
    mesh = carve(box((0.0, 0.0, 0.0), (7.0, 4.0, 2.0), (7, 4, 2)), (notch,), ())
    shift = np.random.default_rng(4).uniform(-0.12, 0.12, mesh.nodes.shape)
    shift[mesh.nodes[:, 2] == 0.0, 2] = 0.0
    return HexMesh(mesh.nodes + shift, mesh.cells)


def bent(x):
    """Displacements that differ from bond to bond."""
    return 0.01 * np.stack([np.sin(x[:, 1]), np.cos(1.3 * x[:, 0]) * x[:, 2], np.sin(x[:, 0] * x[:, 1])], axis=1)


def bonds_and_forces(scene, comm):
    """How many bonds there are, and the squares of all forces at one displacement, summed exactly. Collective."""
    body = build(scene, comm, loaded=False)
    force = body.internal(body.of_positions(bent))
    return total_bonds(comm, body.model.bonds), float(exact_dots(comm, [(force, force)])[0])


@pytest.mark.parametrize("symmetry", [(), ("z-",)], ids=["whole", "mirrored"])
@pytest.mark.parametrize("n_elements", [0, 2])
def test_bonds_end_at_the_surface_on_any_ranks(comm, symmetry, n_elements):
    """Each rank sees the faces around its points: the same bonds, with the same forces, as on one rank."""
    folder = TemporaryDirectory() if comm.rank == 0 else None
    path = Path(broadcast(comm, folder and folder.name)) / "notch.vtu"
    if folder:
        write_mesh(path, dented_notch())
    comm.Barrier()
    mesh = FileMesh(path=str(path), spacing=1.0, symmetry=symmetry)
    scene = make_scene((7, 4, 2), n_elements, loads=(), correction="virial", mesh=mesh)
    found, expected = bonds_and_forces(scene, comm), bonds_and_forces(scene, mpi().COMM_SELF)
    comm.Barrier()
    if folder:
        folder.cleanup()
    assert_all(comm, found == expected, (found, expected))


@pytest.mark.parametrize("n_elements", [0, 3, 7])
def test_loads_on_faces_that_are_not_flat_do_not_depend_on_ranks(comm, n_elements):
    """Forces of tractions and pressures, and stiffness of springs, bit by bit as on one rank."""
    folder = TemporaryDirectory() if comm.rank == 0 else None
    path = Path(broadcast(comm, folder and folder.name)) / "notch.vtu"
    if folder:
        write_mesh(path, dented_notch())
    comm.Barrier()
    around = {"lower": (-1.0, -1.0, -1.0), "upper": (9.0, 9.0, 9.0)}
    loads = (
        Pressure(kind="pressure", pressure=0.3, **around),
        Traction(kind="traction", total=(1.0, -2.0, 0.5), lower=(2.0, 3.7, -1.0)),
    )
    scene = make_scene(
        (7, 4, 2),
        n_elements,
        regions=split_at(3.0) if n_elements == 3 else None,
        loads=loads,
        supports=(Support(face="z-", x=0.0, y=0.0, z=0.0),),
        springs=(Spring(stiffness=(1.0, 2.0, 3.0), lower=(2.0, 3.7, -1.0)),),
        correction="virial",
        mesh=FileMesh(path=str(path), spacing=1.0),
    )
    found, expected = loads_and_springs(scene, comm), loads_and_springs(scene, mpi().COMM_SELF)
    comm.Barrier()
    if folder:
        folder.cleanup()
    assert_all(comm, found == expected and found[0] > 0.0, (found, expected))


def split_at(x):
    """Elements before a place, bonds behind it, of cells whose corners are moved."""
    return (
        Region(name="elements", model="finite_elements", upper=(x, 9.0, 9.0)),
        Region(name="bonds", model="peridynamics", lower=(x, -9.0, -9.0)),
    )


def loads_and_springs(scene, comm):
    """Products of all loads and all springs with displacements that differ everywhere, summed exactly. Collective."""
    body = build(scene, comm)
    u, external, springs = body.of_positions(bent), body.case.external, body.model.springs
    pairs = [(external, external), (external, u), (springs.stiffness, u[springs.index])]
    return exact_dots(comm, pairs).tolist()
