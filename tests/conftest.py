"""Time limit of every test, barrier after every MPI test; ``mpi_tmp_path`` (rank 0) is from pytest-mpi."""

import faulthandler
import gc
import sys

import pytest

from pdfem_mpi.system import launcher as launch
from support.helpers import assert_all

launch.prepare_environment()  # before anything loads numba

__all__ = ["assert_all"]

TEST_SECONDS = 120  # a deadlock becomes a failure; the longest default test takes a few seconds
SLOW_TEST_SECONDS = 3600


def _stderr(config):
    """The terminal's stderr: the one that pytest captures is lost when the process ends."""
    try:
        from _pytest.faulthandler import fault_handler_stderr_fd_key

        return config.stash[fault_handler_stderr_fd_key]
    except (ImportError, KeyError):
        return 2


def pytest_collection_finish():
    """Modules and thousands of collected tests stay: searching them for garbage took most of the time of MPI tests."""
    gc.collect()
    gc.freeze()


@pytest.fixture(autouse=True)
def time_limit(request):
    """End the process, with the stacks of all threads, when a test takes too long."""
    slow = request.node.get_closest_marker("slow")
    seconds = SLOW_TEST_SECONDS if slow else TEST_SECONDS
    faulthandler.dump_traceback_later(seconds, exit=True, file=_stderr(request.config))
    yield
    faulthandler.cancel_dump_traceback_later()


@pytest.fixture(autouse=True)
def compiled_once():
    """No test makes a kernel compile for other types than those of its signature: it would take time once more."""
    before = _compiled_for_others()
    yield
    more = _compiled_for_others() - before
    assert not more, f"compiled once more: {more}"


def _compiled_for_others():
    """Kernels and the types they were compiled for beside their signatures; one for any layout has that of arrays."""
    warm_up = sys.modules.get("pdfem_mpi.runs.compilation")  # tests without numba load none
    if not warm_up or warm_up.numba.config.DISABLE_JIT:
        return set()
    return {
        (kernel.__name__, str(found))
        for kernel, signature in warm_up.kernels().items()
        for found in kernel.signatures
        if found != signature.args and not all(map(_is_one_of, found, signature.args))
    }


def _is_one_of(found, declared):
    return found == declared or (getattr(declared, "layout", "") == "A" and found.copy(layout="A") == declared)


@pytest.fixture(autouse=True)
def barrier(request, time_limit):
    """Let no rank start the next test before all have ended this one and freed what it left."""
    yield
    option = request.config.getoption
    if request.node.get_closest_marker("mpi") and (option("--only-mpi") or option("--with-mpi")):
        from pdfem_mpi.parallel.comm import world

        gc.collect()
        world().Barrier()
