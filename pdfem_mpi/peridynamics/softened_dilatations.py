"""Bonds that soften beside a volumetric part: what they do in the two sweeps of `volumetric_forces`.

Bonds move on before the dilatations are whole, so that those of a sweep are of the stiffness that bonds have after it.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from pdfem_mpi.kernels import softened_volumetric as kernels

if TYPE_CHECKING:
    from pdfem_mpi.peridynamics.failure import Failure
    from pdfem_mpi.peridynamics.volumetric_forces import VolumetricForces


def sum_softened(forces: VolumetricForces, failure: Failure | None, margin: float, met: np.ndarray) -> None:
    """Let bonds go on that do so in this sweep, and add the list's part to the dilatations; as `add_softened`."""
    if failure:
        failure.advance(forces.points, forces.S, margin)
    extremes = np.zeros(2)
    if forces.tangent:
        add_changes(forces, extremes)
        extremes[0] /= forces.law.largest_weight * forces.bonds.cutoff
    else:
        add_dilatations(forces, extremes)
    met[0] = max(met[0], extremes[0])


def add_dilatations(forces: VolumetricForces, extremes: np.ndarray) -> None:
    """Add the list's part to the sums of the dilatations; ``extremes`` as of the kernel."""
    softened, sums = forces.bonds.softened, (forces.qi, forces.dilatation_quantum, extremes)
    kernels.add_softened_dilatations(*softened.listed, softened.finite, forces.S.reshape(-1), *sums)


def add_changes(forces: VolumetricForces, extremes: np.ndarray) -> None:
    """The same for the change of the dilatations."""
    listed, sums = forces.bonds.softened.listed, (forces.qi, forces.dilatation_quantum, extremes)
    kernels.add_softened_changes(*listed, forces.S.reshape(-1), *sums)


def add_softened(forces: VolumetricForces, met: np.ndarray) -> None:
    """Add the forces of the list, or of the tangent their change, at the ``q`` of all points."""
    softened = forces.bonds.softened
    table = forces.S.reshape(-1), forces.SI.reshape(-1), forces.quantum
    if forces.tangent:
        numbers = *softened.listed, *table, forces.linearised, forces.q
        met[0] = max(met[0], kernels.add_softened_volumetric_tangent(*numbers))
    else:
        kernels.add_softened_volumetric_forces(*softened.listed, softened.finite, *table, forces.q)
    forces.swept.add("tangent, softened, volumetric" if forces.tangent else "softened, volumetric")
