"""Strain and stress of one state, computed once for all that asks for them."""

from __future__ import annotations

from functools import cached_property

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.measure.stresses import Mechanics, mechanics_of_bonds, mechanics_of_elements
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.restraints import internal_forces
from pdfem_mpi.model.thermal import Thermal


class Recovered:
    """Strain and stress at the forces' last evaluation, computed when they are first asked for, on all ranks.

    Parameters
    ----------
    share : Share
    forces : Forces
    thermal : Thermal, optional
        At the load of that evaluation.
    """

    def __init__(self, share: Share, forces: Forces, thermal: Thermal | None = None):
        self.share, self.forces, self.thermal = share, forces, thermal

    @cached_property
    def bonds(self) -> Mechanics | None:
        """Of the peridynamic points. Collective."""
        return mechanics_of_bonds(self.share, self.forces, self.thermal)

    @cached_property
    def elements(self) -> Mechanics | None:
        """Of elements and overlap."""
        return mechanics_of_elements(self.share, self.forces, self.thermal)

    def internal(self, u: np.ndarray) -> np.ndarray:
        """Internal forces at the displacements ``u`` of that evaluation, both of shape (n_unknowns,). Collective."""
        before = self.forces.evaluations
        force = internal_forces(self.forces, u)
        self.forces.evaluations = before
        return force if self.thermal is None else force + self.thermal.forces
