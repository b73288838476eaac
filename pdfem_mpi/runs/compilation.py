"""Compile the kernels that a scene calls ahead of the first time step."""

import os
from collections.abc import Collection
from importlib import import_module
from pkgutil import iter_modules
from typing import Any

import numba
from numba.core.registry import cpu_target
from numba.core.runtime import rtsys

from pdfem_mpi import kernels as package
from pdfem_mpi.kernels import (
    banded,
    bond_cuts,
    bond_densities,
    bond_failure,
    bond_moments,
    bond_stresses,
    bond_sweeps,
    bond_tangent,
    cell_strains,
    correction_sweeps,
    cycle_steps,
    dense,
    dilatation_changes,
    dilatation_fit,
    dilatation_sweeps,
    dilatations,
    families,
    foretold,
    fronts,
    gap_cuts,
    grid_rows,
    interpolation,
    krylov,
    linear_elements,
    local_damage,
    moment_blocks,
    moment_grid,
    multigrid,
    near_cells,
    nearest,
    node_table,
    plane_crossings,
    point_table,
    reflections,
    relaxation,
    softened_bonds,
    softened_volumetric,
    turning_elements,
    union_find,
    volumetric_sweeps,
    weighted_blocks,
)
from pdfem_mpi.parallel.comm import report_progress

#: All modules of kernels, by name.
MODULES = tuple(
    module
    for module in (import_module(f"{package.__name__}.{found.name}") for found in iter_modules(package.__path__))
    if hasattr(module, "SIGNATURES")
)

#: What a scene must have for the kernels of a module, or a kernel, to be called; every scene calls the others.
NEEDED_BY = {
    bond_densities: {"bonds"},
    bond_sweeps.add_forces_series: {"finite"},
    bond_sweeps.add_forces_closed: {"finite"},
    bond_sweeps.add_forces_series_failing: {"finite", "failing"},
    bond_sweeps.add_forces_closed_failing: {"finite", "failing"},
    bond_sweeps.add_forces_linear: {"linear"},
    bond_sweeps.add_forces_linear_failing: {"linear", "failing"},
    bond_densities.add_family_sums: {"volumetric"},
    dilatations: {"volumetric"},
    dilatations.listed_terms: {"volumetric", "failing"},
    dilatation_fit: {"volumetric", "fitted"},
    **{
        sweep: {"volumetric", "finite" if finite else "linear"}
        | ({"failing"} if failing else set())
        | ({"fitted"} if weighted else set())
        for (finite, _, failing, weighted), sweep in dilatation_sweeps.SWEEPS.items()
    },
    **{
        sweep: {"volumetric", "finite" if finite else "linear"} | ({"fitted"} if weighted else set())
        for (finite, _, weighted), sweep in volumetric_sweeps.SWEEPS.items()
    },
    **{
        sweep: {"volumetric", "finite", "cg"} | ({"fitted"} if weighted else set())
        for table in (dilatation_changes.CHANGES, volumetric_sweeps.TANGENTS)
        for (_, weighted), sweep in table.items()
    },
    banded: {"cg"},
    cycle_steps: {"cg"},
    dense.make_orthonormal: {"cg"},
    dense.remove_rows: {"cg"},
    fronts: {"fitted"},
    grid_rows: {"cg"},
    bond_moments: {"fitted"},
    bond_stresses: {"stresses"},
    bond_tangent: {"finite", "cg"},
    bond_cuts: {"cracks"},
    gap_cuts: {"gaps"},
    union_find.join_bonds: {"bonds"},
    bond_failure: {"failing"},
    bond_failure.add_broken_blocks: {"failing", "cg"},
    bond_failure.add_noise: {"noise"},
    softened_bonds: {"softening"},
    softened_bonds.add_softened_tangent: {"softening", "finite", "cg"},
    softened_volumetric: {"softening", "volumetric"},
    softened_volumetric.add_softened_changes: {"softening", "volumetric", "finite", "cg"},
    softened_volumetric.add_softened_volumetric_tangent: {"softening", "volumetric", "finite", "cg"},
    families: {"bonds"},
    cell_strains: {"adaptive"},
    near_cells: {"adaptive"},
    nearest: {"bonds"},
    foretold: {"adaptive"},
    linear_elements: {"elements"},
    node_table: {"elements"},
    plane_crossings: {"failing"},
    reflections: {"mirrors"},
    krylov: {"cg"},
    local_damage: {"damage"},
    moment_blocks: {"fitted"},
    moment_grid: {"fitted"},
    interpolation: {"overlap"},
    point_table: {"bonds"},
    point_table.complete_z: {"finite"},
    multigrid: {"cg"},
    multigrid.add_point_blocks: {"bonds", "cg"},
    relaxation: {"adr"},
    correction_sweeps: {"correction"},
    turning_elements: {"turning"},
    turning_elements.add_tangent: {"turning", "cg"},
    weighted_blocks: {"bonds", "adr"},
}


def kernels(features: Collection[str] | None = None) -> dict[Any, Any]:
    """The kernels that a scene with these features calls, or all of them, with their signatures."""
    found = {}
    for module in MODULES:
        for kernel, signature in module.SIGNATURES.items():
            needed = NEEDED_BY.get(kernel, NEEDED_BY.get(module, set()))
            if features is None or needed <= set(features):
                found[kernel] = signature
    return found


def share_out(chosen: Collection[Any], n: int) -> list[list[Any]]:
    """Divide kernels among processes that compile at the same time; those that have a cache file together stay so."""
    of_file: dict[str, list[Any]] = {}
    for kernel in chosen:
        of_file.setdefault(_cache_file(kernel), []).append(kernel)
    largest_first = sorted(of_file.values(), key=len, reverse=True)
    return [[kernel for group in largest_first[k::n] for kernel in group] for k in range(n)]


def _cache_file(kernel: Any) -> str:
    return kernel._cache._cache_file._index_path


def compile_kernels(features: Collection[str] | None = None, share: int = 0, n_shares: int = 1) -> None:
    """Compile kernels for the one signature each is called with, or load them from the cache.

    Afterwards a call of one of them with other types is a TypeError instead of a silent second compilation. The others
    are compiled or loaded when they are first called. Does nothing with ``NUMBA_DISABLE_JIT=1``.

    Parameters
    ----------
    features : words of `NEEDED_BY`, optional
        What the scene has; all kernels without.
    share, n_shares : int
        Which part of them, of how many, where several processes compile at the same time.
    """
    if numba.config.DISABLE_JIT:
        return
    chosen = kernels(features)
    rtsys.initialize(cpu_target.target_context)  # kernels call it for memory, those from the cache as well
    for kernel in kernels():
        kernel.disable_compile(False)  # those that the new ones call
        load_past_registries(kernel)
    for kernel in share_out(chosen, n_shares)[share]:
        kernel.compile(tuple(chosen[kernel].args))  # as a call does: the cache keeps an entry with a return type apart
        report_progress()
    for kernel, signature in kernels().items():
        if tuple(signature.args) in kernel.signatures:  # one that was only called stays open for other layouts
            kernel.disable_compile()


def load_past_registries(kernel: Any) -> None:
    """Let a kernel that is in the cache be loaded without all that numba needs to compile one.

    Before each load numba brings its compiler up to date: at the first, it imports and registers whatever it can
    compile, 0.2 to 0.3 s of processor time, a part of it in scipy. Machine code is linked to none of that. A kernel
    that is not in the cache is compiled as ever, and numba makes up for it then.
    """
    cache = kernel._cache
    cache.load_overload = getattr(cache, "_load_overload", cache.load_overload)


def not_compiled(features: Collection[str] | None = None) -> int:
    """How many of the kernels are not in the cache, compiled from this source for this processor."""
    if numba.config.DISABLE_JIT:
        return 0
    return sum(not _is_cached(kernel, tuple(signature.args)) for kernel, signature in kernels(features).items())


def _is_cached(kernel: Any, arguments: tuple[Any, ...]) -> bool:
    """Whether the cache, which several kinds of processors may share, has what a compilation would find."""
    cache = kernel._cache
    if not os.path.exists(_cache_file(kernel)):
        return False
    return cache._index_key(arguments, kernel.targetctx.codegen()) in cache._cache_file._load_index()
