"""Communicators for the MPI tests: each test runs in groups of 1, 2, ... ranks, up to all there are.

Four ranks on two cores are slow: of the groups of 3 and of 4, one is marked slow, by turns from test to test.
"""

import zlib

import pytest

from pdfem_mpi.parallel.comm import world
from pdfem_mpi.solvers.preconditioner import nested_grids


def pytest_generate_tests(metafunc):
    """Run a test that takes ``comm`` in groups of the sizes above half: runs on 2 and 4 ranks have 1, 2, 3 and 4."""
    if "comm" in metafunc.fixturenames:
        option = metafunc.config.getoption
        n_ranks = world().size if option("--with-mpi") or option("--only-mpi") else 1
        sizes = range(n_ranks // 2 + 1, n_ranks + 1)
        metafunc.parametrize("comm", sizes, ids="{}_ranks".format, indirect=True)


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items):
    """Mark one of the sizes 3 and 4 of each test slow, before marks are selected by."""
    for item in items:
        size = item.callspec.params.get("comm", 0) if hasattr(item, "callspec") else 0
        if size in (3, 4):
            rest = item.name.replace(f"{size}_ranks", "")
            if size != 3 + zlib.crc32(rest.encode()) % 2:
                item.add_marker(pytest.mark.slow)


@pytest.fixture
def comm(request):
    """The first n ranks as one group and the others as a second one; both run the test.

    Tests make their collective calls before they assert, so a failing rank leaves nobody waiting.
    """
    everyone = world()
    group = everyone.Split(int(everyone.rank >= request.param))
    yield group
    group.Free()


@pytest.fixture
def small_last_grids(monkeypatch):
    """Grids have several levels, as those of large bodies."""
    monkeypatch.setattr(nested_grids, "MOST_UNKNOWNS", 300)
