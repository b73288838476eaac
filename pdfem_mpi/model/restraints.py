"""What springs and ties make of the forces on the unknowns, and the forces of bonds and elements without them."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.ties import find_problems

if TYPE_CHECKING:
    from pdfem_mpi.model.forces import Forces


def restrain(forces: Forces, u: np.ndarray, force: np.ndarray) -> None:
    """Add the forces of springs at displacements ``u``, and take the mean over places that are tied. Collective."""
    if not forces.restrained:
        return
    if forces.model.springs:
        forces.model.springs.pull(u, force)
    tie(forces.model, force)


def tie(model: Model, vector: np.ndarray) -> np.ndarray:
    """A vector over the unknowns with the mean over places that are tied, in place. Collective."""
    if model.ties:
        model.ties.average(model.comm, vector)
    return vector


def problems_of_restraints(share: Share, model: Model, fixed: np.ndarray) -> list[str]:
    """What is wrong with springs and ties; ``fixed``, bool, (n_unknowns,), is what supports hold. Collective."""
    chosen = share.selections.problems
    messages = [text for kind in ("springs", "ties") for found in chosen.get(kind, ()) for text in found]
    return messages + (find_problems(share, model.ties, fixed) if model.ties else [])


def energy_of_springs(model: Model, u: np.ndarray) -> float:
    """What is stored in springs, dimension force length. Collective."""
    return model.springs.energy(model.comm, u) if model.springs else 0.0


def internal_forces(forces: Forces, u: np.ndarray) -> np.ndarray:
    """Minus the forces by which bonds and elements alone resist ``u``, both of shape (n_unknowns,). Collective."""
    force = np.empty_like(u)
    forces.restrained = False
    try:
        forces.evaluate_surely(u, np.zeros_like(u), force)
    finally:
        forces.restrained = True
    return force


def sprung_unknowns(model: Model) -> np.ndarray:
    """Unknowns that springs hold; bool, shape (n_unknowns,)."""
    held = np.zeros(model.n_unknowns, bool)
    if model.springs:
        held[model.springs.index] = True
    return held
