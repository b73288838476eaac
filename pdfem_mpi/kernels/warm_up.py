"""Compile the kernels that a scene calls ahead of the first time step."""

import os
from collections.abc import Collection
from typing import Any

import numba

from pdfem_mpi.kernels import (
    bond_factors,
    ceilings,
    components,
    cracks,
    exact_sums,
    failure,
    families,
    finite_elements,
    fronts,
    images,
    krylov,
    local_damage,
    overlap,
    peridynamics,
    preconditioner,
    relaxation,
    surface_correction,
)

MODULES = (
    bond_factors,
    cracks,
    ceilings,
    components,
    exact_sums,
    failure,
    families,
    finite_elements,
    fronts,
    images,
    krylov,
    local_damage,
    overlap,
    peridynamics,
    preconditioner,
    relaxation,
    surface_correction,
)


#: What a scene must have for the kernels of a module, or a kernel, to be called; every scene calls the others.
NEEDED_BY = {
    bond_factors: {"fitted"},
    ceilings: {"bench"},
    cracks: {"cracks"},
    components.join_bonds: {"bonds"},
    failure: {"failing"},
    failure.add_broken_blocks: {"failing", "cg"},
    failure.add_noise: {"noise"},
    families: {"bonds"},
    finite_elements: {"elements"},
    images: {"mirrors"},
    krylov: {"cg"},
    local_damage: {"damage"},
    overlap: {"overlap"},
    peridynamics: {"bonds"},
    peridynamics.add_forces_series: {"finite"},
    peridynamics.add_forces_closed: {"finite"},
    peridynamics.add_forces_series_failing: {"finite", "failing"},
    peridynamics.add_forces_closed_failing: {"finite", "failing"},
    peridynamics.add_forces_linear: {"linear"},
    peridynamics.add_forces_linear_failing: {"linear", "failing"},
    peridynamics.add_tangent_series: {"finite", "cg"},
    peridynamics.add_tangent_closed: {"finite", "cg"},
    peridynamics.complete_z: {"finite"},
    preconditioner: {"cg"},
    preconditioner.add_point_blocks: {"bonds", "cg"},
    relaxation: {"adr"},
    surface_correction: {"correction"},
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


def compile_kernels(features: Collection[str] | None = None) -> None:
    """Compile kernels for the one signature each is called with, or load them from the cache.

    Afterwards a call of one of them with other types is a TypeError instead of a silent second compilation. The others
    are compiled or loaded when they are first called. Does nothing with ``NUMBA_DISABLE_JIT=1``.

    Parameters
    ----------
    features : words of `NEEDED_BY`, optional
        What the scene has; all kernels without.
    """
    if numba.config.DISABLE_JIT:
        return
    chosen = kernels(features)
    for kernel in kernels():
        kernel.disable_compile(False)  # those that the new ones call
    for kernel, signature in chosen.items():
        kernel.compile(tuple(signature.args))  # as a call does: the cache keeps an entry with a return type apart
    for kernel in kernels():
        if kernel.signatures:
            kernel.disable_compile()


def not_compiled(features: Collection[str] | None = None) -> int:
    """How many of the kernels are not in the cache."""
    if numba.config.DISABLE_JIT:
        return 0
    return sum(not os.path.exists(kernel._cache._cache_file._index_path) for kernel in kernels(features))
