"""While modules are loaded Python does not search for garbage; afterwards it does as before."""

import gc

import pytest

from pdfem_mpi.system.garbage import no_search_for_garbage


@pytest.mark.parametrize("searched", [True, False])
def test_the_search_goes_on_as_it_was(searched):
    before = gc.isenabled()
    try:
        (gc.enable if searched else gc.disable)()
        with pytest.raises(ImportError), no_search_for_garbage():
            assert not gc.isenabled()
            raise ImportError
        assert gc.isenabled() == searched
    finally:
        (gc.enable if before else gc.disable)()
