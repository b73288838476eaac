"""Smallest eigenvalue of the preconditioned stiffness, estimated by a few steps of Lanczos' method from seeded forces.

Factors of either sign can make a body unstable. The preconditioner is the intact body of elements, the local limit of
the bonds, so that eigenvalues of ``P K`` are of order 1 whatever the body's shape; a negative one is a direction that
lets go. The Lanczos matrix is that of conjugate gradients (`energy_error.Coefficients`), its eigenvalues lie inside
the spectrum: an estimate from above. The forces are those of random displacements, so that rigid motions, which cost
nothing, take no part.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.solvers.convergence import Breakdown, NotConverged
from pdfem_mpi.solvers.preconditioner.preconditioner import Preconditioner
from pdfem_mpi.solvers.sequence import Sequence

#: Steps, and the seed of the displacements.
STEPS, SEED = 20, 20100801
#: Size of the displacements in internal lengths.
SIZE = 1e-3


def smallest_eigenvalue(model: Model, fixed: np.ndarray, preconditioner: Preconditioner) -> float | None:
    """Estimated smallest eigenvalue of ``P K`` at rest; None where a direction without stiffness is met. Collective.

    Parameters
    ----------
    model : Model
    fixed : bool, shape (n_unknowns,)
    preconditioner : Preconditioner
    """
    forces = Forces(model, tangent=model.finite)
    rest = np.zeros(model.n_unknowns)
    if forces.tangent:
        forces.linearise(rest, 0.0)
    residual = np.empty_like(rest)
    forces.evaluate_surely(np.where(fixed, 0.0, _random(model)), rest, residual)
    residual[fixed] = 0.0
    (square,) = exact_dots(model.comm, [(residual, residual)])
    # what the cycle meets here must not change the rounding of the run's sums
    own = replace(preconditioner, forces=preconditioner.forces.with_own_bounds())
    sequence = Sequence(forces, fixed, own, rest)
    try:
        sequence.run(residual, math.sqrt(square), 0.0, STEPS, 0.0, lambda norm: None, stop=True)
    except (Breakdown, NotConverged):
        return None
    return sequence.coefficients.smallest_ritz()


def _random(model: Model) -> np.ndarray:
    """Displacements that a point or node has on any number of ranks: hashes of its number in the mesh."""
    parts = [np.empty(0)]
    for kind, part, rows, number in (
        (0, model.points, 24, model.points and model.points.cell_number[: model.points.n_free]),
        (1, model.nodes, 3, model.nodes and model.nodes.number[: model.nodes.n_owned]),
    ):
        if part:
            key = (rows * number[:, None] + np.arange(rows)).reshape(-1).astype(np.uint64)
            parts.append(SIZE * _uniform(2 * key + np.uint64(kind)))
    return np.concatenate(parts)


def _uniform(key: np.ndarray) -> np.ndarray:
    """Numbers from -1 to 1 by splitmix64 (Steele, Lea, Flood 2014) of keys, uint64."""
    with np.errstate(over="ignore"):
        z = (key + np.uint64(SEED)) * np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    return (z >> np.uint64(11)).astype(float) * 2.0**-52 - 1.0
