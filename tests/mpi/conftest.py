"""Communicators for the MPI tests: each test runs in groups of 1, 2, ... ranks, up to all there are."""

import pytest

from pdfem_mpi.parallel.comm import world


def pytest_generate_tests(metafunc):
    """Run a test that takes ``comm`` in groups of the sizes above half: runs on 2 and 4 ranks have 1, 2, 3 and 4."""
    if "comm" in metafunc.fixturenames:
        option = metafunc.config.getoption
        n_ranks = world().size if option("--with-mpi") or option("--only-mpi") else 1
        sizes = range(n_ranks // 2 + 1, n_ranks + 1)
        metafunc.parametrize("comm", sizes, ids="{}_ranks".format, indirect=True)


@pytest.fixture
def comm(request):
    """The first n ranks as one group and the others as a second one; both run the test.

    Tests make their collective calls before they assert, so a failing rank leaves nobody waiting.
    """
    everyone = world()
    group = everyone.Split(int(everyone.rank >= request.param))
    yield group
    group.Free()
