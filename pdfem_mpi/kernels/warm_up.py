"""Compile all kernels ahead of the first time step."""

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
    images,
    krylov,
    local_damage,
    overlap,
    peridynamics,
    preconditioner,
    relaxation,
    surface_correction,
)


def compile_kernels() -> None:
    """Compile every kernel for the one signature it is called with, or load it from the cache.

    Afterwards a call with other types is a TypeError instead of a silent second compilation. Does nothing the second
    time, and with ``NUMBA_DISABLE_JIT=1``.
    """
    if numba.config.DISABLE_JIT or not all(
        kernel._can_compile for module in MODULES for kernel in module.SIGNATURES
    ):
        return
    for module in MODULES:
        for kernel, signature in module.SIGNATURES.items():
            kernel.compile(signature)
    for module in MODULES:
        for kernel in module.SIGNATURES:
            kernel.disable_compile()
