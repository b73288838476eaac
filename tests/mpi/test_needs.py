"""What ranks allocate together: parts that are shared out take the same bytes on any number of them."""

import json

import pytest

from pdfem_mpi.deck.outputs import Output
from pdfem_mpi.deck.toml import write_deck
from pdfem_mpi.parallel.comm import broadcast, mpi
from pdfem_mpi.runs.memory_report import SHARED_OUT
from pdfem_mpi.runs.run import run
from support.bodies import make_scene
from support.helpers import assert_all
from support.reporters import Silence

pytestmark = pytest.mark.mpi(min_size=2)

SCENES = {
    "coupled": make_scene((6, 3, 2), 3, correction="none", output=Output(fields=False, figures=False)),
    "peridynamics with damage": make_scene(
        (5, 3, 2), correction="none", kinematics="finite", solver="cg", output=Output(figures=False, damage=True)
    ),
}


def summary_of(scene, comm, folder):
    """What a run of the scene says, on all ranks. Collective."""
    run(scene, comm, folder, write_deck(scene), True, Silence())
    text = (folder / "summary.json").read_text(encoding="utf-8") if comm.rank == 0 else None
    return json.loads(broadcast(comm, text))


@pytest.mark.parametrize("name", SCENES)
def test_parts_that_are_shared_out_take_the_same_bytes(comm, mpi_tmp_path, name):
    """And digests of the fields, with files of them or without, are those of one rank."""
    folder = mpi_tmp_path / f"{comm.size}-{broadcast(comm, mpi().COMM_WORLD.rank)}"
    together = summary_of(SCENES[name], comm, folder)
    alone = None
    if comm.rank == 0:
        alone = summary_of(SCENES[name], mpi().COMM_SELF, folder / "alone")
    alone = broadcast(comm, alone)
    found, expected = (summary["memory"] for summary in (together, alone))
    for part in SHARED_OUT:
        same = found["array_bytes"].get(part) == expected["array_bytes"].get(part)
        assert_all(comm, same, f"{part}: {found['array_bytes'].get(part)}, alone {expected['array_bytes'].get(part)}")
    assert_all(comm, together["fields_sha256"] == alone["fields_sha256"] is not None, "fields differ")
    assert_all(comm, found["bond_kernels"] == expected["bond_kernels"])
    more = {"exchange"} if comm.size > 1 else set()
    assert_all(comm, set(expected["left_out"]) - set(found["left_out"]) == more, f"{found['left_out']}")
    assert_all(comm, sum(found["array_bytes"].values()) == sum(found["array_bytes_per_rank"]))
    # the part of the mesh that each rank sees: its own cells and those around them
    whole = expected["array_bytes"]["mesh"]
    assert_all(comm, whole <= found["array_bytes"]["mesh"] <= comm.size * whole)
    if name == "coupled" and comm.size > 1:  # long enough: a rank of its elements does not see the other end
        assert_all(comm, found["array_bytes"]["mesh"] < comm.size * whole, "each rank has the whole mesh")
