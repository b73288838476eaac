"""What moves without stiffness, in words: for a solver that met such a motion."""

from __future__ import annotations

import math

import numpy as np

from pdfem_mpi.kernels.dense import eigen, product
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.motions import MOTION_NAMES, NO_ROTATION, PAIRS, modes_at, symmetric
from pdfem_mpi.model.parts import Parts, extents, in_words, positions, sum_over_parts
from pdfem_mpi.parallel.comm import largest

#: Places that move at least this fraction of the largest displacement belong to the region of a motion.
MOVING = 0.3
#: A motion is called a rotation from this fraction of its square on.
TURNING = 0.05


def describe_motion(model: Model, motion: np.ndarray) -> str:
    """Where a motion takes place and what it is like, as part of a sentence. Collective.

    Parameters
    ----------
    motion : float64, shape (n_unknowns,), dimension length
        Of any size, such as a search direction that met no stiffness.
    """
    rows, x = model.unknowns.rows(motion), positions(model)
    length = np.abs(rows).max(axis=1, initial=0.0)
    peak = float(largest(model.comm, np.array([length.max(initial=0.0)]))[0])
    if not 0.0 < peak < math.inf:
        return "no displacement"
    inside = length >= MOVING * peak
    region = Parts(np.zeros(len(x), np.int64), 1)
    sums = sum_over_parts(model.comm, region, inside, np.column_stack([np.ones(len(x)), x]))[0]
    modes = modes_at(x - sums[1:] / sums[0])
    table = np.zeros((len(x), 27))
    for column, (a, b) in enumerate(zip(*PAIRS, strict=True)):
        table[:, column] = (modes[:, a] * modes[:, b]).sum(axis=1)
    table[:, 21:] = (modes * (rows / peak)[:, None]).sum(axis=2)
    fit = sum_over_parts(model.comm, region, inside, table)[0]
    gram = symmetric(fit[:21])
    values, vectors = eigen(gram)
    along = product(vectors.T, fit[21:])
    real = values > NO_ROTATION * values[-1]
    amounts = product(vectors, np.where(real, along / np.where(real, values, 1.0), 0.0))
    shares = amounts**2 * np.diag(gram)
    if shares[3:].sum() > TURNING * shares.sum():  # about an axis beside the region it looks like a translation
        shares[:3] = 0.0
    counts, reach = extents(model, Parts(np.where(inside, 0, 1), 2))
    return f"{in_words(model, counts[0], reach[0])} move, mostly by {MOTION_NAMES[int(np.argmax(shares))]}"
