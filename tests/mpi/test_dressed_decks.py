"""Decks that ask for several things at once: the same on any ranks, and after a stop that goes on with other ranks."""

from unittest.mock import patch

import numpy as np
import pytest

from pdfem_mpi.parallel.comm import broadcast, mpi
from pdfem_mpi.system.exit_codes import EXIT_STOPPED
from support.dressed_decks import dressed_scene
from support.helpers import assert_all
from support.reporters import Silence
from support.restarts import StopAt, differing, go, outcome

pytestmark = pytest.mark.mpi(min_size=2)

#: Events with a constant load in finite kinematics, events with softening bonds, steps with a temperature.
DEFAULT = (0, 23, 26)
#: What never comes to rest ends here on any number of ranks, and not minutes later.
MOST_EVALUATIONS = 3_000
SEEDS = [pytest.param(seed, marks=() if seed in DEFAULT else pytest.mark.slow) for seed in range(40)]


@pytest.mark.parametrize("seed", SEEDS)
def test_ranks_and_a_stop_change_nothing(comm, mpi_tmp_path, seed):
    """Alone; together; and stopped together somewhere, by a signal to the last rank, then gone on with alone."""
    folder = mpi_tmp_path / f"group_{broadcast(comm, mpi().COMM_WORLD.rank)}"
    scene = broadcast(comm, dressed_scene(seed, folder) if comm.rank == 0 else None)
    most = scene.solver.model_copy(update={"max_evaluations": MOST_EVALUATIONS})
    scene = scene.model_copy(update={"solver": most})
    counted, code = StopAt(10**9), 0
    with patch("pdfem_mpi.runs.prepare.warm_up"), patch("pdfem_mpi.runs.run.fit_folders", lambda out: (out,)):
        if comm.rank == 0:
            code = go(scene, mpi().COMM_SELF, folder / "alone", reporter=Silence(), requests=counted)
        code, safe_points = broadcast(comm, (code, counted.asked))
        together = go(scene, comm, folder / "together", reporter=Silence())
        stop = StopAt(int(np.random.default_rng(seed).integers(1, safe_points + 1)), comm.rank == comm.size - 1)
        resumed = go(scene, comm, folder / "stopped", reporter=Silence(), requests=stop)
        if comm.rank == 0 and resumed == EXIT_STOPPED:
            resumed = go(scene, mpi().COMM_SELF, folder / "stopped", reporter=Silence())
        resumed = broadcast(comm, resumed)
    found = []
    if comm.rank == 0 and code == 0:
        expected = outcome(folder / "alone")
        found = [name for run in ("together", "stopped") for name in differing(outcome(folder / run), expected)]
    assert_all(comm, code == together == resumed and not found, f"{code}, {together}, {resumed}: {found}")
