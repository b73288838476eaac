"""Kernels are compiled ahead for the types of their calls, and nothing is compiled twice."""

import os
import subprocess
import sys
from importlib.util import module_from_spec, spec_from_file_location

import numba
import numpy as np
import pytest

from pdfem_mpi.runs import compilation as warm_up

# One kernel calls the other; as in the package, a signature states what is returned.
SOURCE = """
from numba import njit, types

@njit(cache=True)
def halved(x):
    return 0.5 * x[0]

@njit(cache=True)
def caller(x, n):
    return halved(x) + n

@njit(cache=True)
def first(x):
    return x[0]

SIGNATURES = {
    first: types.float64(types.float64[:]),
    halved: types.float64(types.float64[::1]),
    caller: types.float64(types.float64[::1], types.int64),
}
"""

pytestmark = pytest.mark.skipif(numba.config.DISABLE_JIT, reason="nothing is compiled")


def imported(path, name):
    """The kernels of a file as another process would import them; pickled by the name of their module."""
    spec = spec_from_file_location(name, path)
    sys.modules[name] = module = module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_calls_find_in_the_cache_what_was_compiled_ahead(tmp_path, monkeypatch):
    """By a signature with its return type, numba would keep it apart, and compile once more at the first call."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    path = tmp_path / "kernels.py"
    path.write_text(SOURCE)
    names = ["kernels_ahead", "kernels_called"]
    for name in names:
        monkeypatch.setitem(sys.modules, name, None)
    ahead, called = (imported(path, name) for name in names)
    monkeypatch.setattr(warm_up, "MODULES", (ahead,))
    assert warm_up.not_compiled() == 3
    warm_up.compile_kernels()
    assert warm_up.not_compiled() == 0
    assert called.caller(np.array([3.0]), 2) == 3.5
    assert sum(called.caller.stats.cache_hits.values()) == 1
    assert not called.caller.stats.cache_misses
    with pytest.raises(TypeError):
        ahead.caller(np.array([3.0], np.float32), 2)


def test_a_kernel_that_was_called_but_not_compiled_ahead_stays_open(tmp_path, monkeypatch):
    """In one process one body may call a kernel of any layout with whole arrays, and the next with parts of them."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    path = tmp_path / "kernels.py"
    path.write_text(SOURCE)
    monkeypatch.setitem(sys.modules, "kernels_open", None)
    module = imported(path, "kernels_open")
    monkeypatch.setattr(warm_up, "MODULES", (module,))
    monkeypatch.setattr(warm_up, "NEEDED_BY", {module.first: {"asked for"}})
    numbers = np.array([3.0, 1.0, 2.0, 4.0])
    assert module.first(numbers) == 3.0
    warm_up.compile_kernels(())
    assert module.first(numbers[1::2]) == 1.0
    warm_up.compile_kernels({"asked for"})
    with pytest.raises(TypeError):
        module.first(numbers.astype(np.float32))


LOADING = """
import sys
import numba
import numpy as np
import some_kernels
from pdfem_mpi.runs import compilation

compilation.MODULES = (some_kernels,)
compilation.compile_kernels()
registered = "numba.np.arraymath" in sys.modules
print(registered, some_kernels.caller(np.array([3.0]), 2), numba.njit(lambda x: x.sum())(np.array([3.0, 1.0])))
"""


def test_kernels_of_the_cache_are_loaded_without_what_compiles_others(tmp_path):
    """The registries of numba are for compiling; where something is compiled after all, they are there."""
    (tmp_path / "some_kernels.py").write_text(SOURCE)
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path / "cache"), "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", LOADING]
    said = [subprocess.run(command, env=environment, capture_output=True, text=True).stdout for _ in range(2)]
    assert said == ["True 3.5 4.0\n", "False 3.5 4.0\n"]


def test_kernels_return_what_their_signatures_say():
    warm_up.compile_kernels()
    for kernel, signature in warm_up.kernels().items():
        found = kernel.overloads[signature.args].signature.return_type
        assert found == signature.return_type, kernel.__name__


@pytest.mark.parametrize("n", [1, 2, 5])
def test_kernels_are_shared_out_file_by_file(n):
    """Two processes that write one file of the cache would lose what the other wrote, or take it for their own."""
    shares = warm_up.share_out(warm_up.kernels(), n)
    assert sorted(id(kernel) for share in shares for kernel in share) == sorted(map(id, warm_up.kernels()))
    files = [{kernel._cache._cache_file._index_path for kernel in share} for share in shares]
    assert sum(map(len, files)) == len(set.union(*files)) and all(files)


def test_what_another_processor_compiled_counts_as_not_compiled(tmp_path, monkeypatch):
    """Where different processors share a cache: kernels are compiled again, and the run says so."""
    monkeypatch.setattr(numba.config, "CACHE_DIR", str(tmp_path / "cache"))
    path = tmp_path / "kernels.py"
    path.write_text(SOURCE)
    monkeypatch.setitem(sys.modules, "kernels_shared", None)
    module = imported(path, "kernels_shared")
    monkeypatch.setattr(warm_up, "MODULES", (module,))
    warm_up.compile_kernels()
    assert warm_up.not_compiled() == 0
    codegen = type(module.first.targetctx.codegen())
    monkeypatch.setattr(codegen, "magic_tuple", lambda self: ("x86_64-unknown-linux-gnu", "another", "+avx2"))
    assert warm_up.not_compiled() == 3
