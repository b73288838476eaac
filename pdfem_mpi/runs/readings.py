"""What can be read off a simulation between its steps: fields, forces, bonds and cells, in the deck's units."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.measure.cells import Cells, list_cells
from pdfem_mpi.measure.fields import Fields, NodalForces, gather_damage, gather_fields, gather_forces
from pdfem_mpi.measure.geometry import gather_geometry
from pdfem_mpi.measure.probed import ProbeReader
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import LoadCase
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.restraints import internal_forces
from pdfem_mpi.model.state import State
from pdfem_mpi.peridynamics.bond_list import BondList, list_bonds
from pdfem_mpi.peridynamics.failure import Failure


class Readings:
    """The part of `Simulation` that reads and changes nothing. All methods are collective."""

    scene: Scene
    comm: Any
    share: Share
    model: Model
    state: State
    case: LoadCase
    forces: Forces
    probe_reader: ProbeReader
    failure: Failure | None
    _evaluated: bool

    def evaluate(self) -> np.ndarray:
        """Bring the tables of the forces to the state, and return minus the internal forces, shape (n_unknowns,).

        It does not count as an evaluation.
        """
        before = self.forces.evaluations
        force = internal_forces(self.forces, self.state.u)
        self.forces.evaluations = before
        self._evaluated = True
        return force

    def fields(self, *names: str, probes: ProbeReader | None = None) -> Fields | None:
        """Displacements, and fields of these names (see ``docs/results.md``); None except on rank 0."""
        if not self._evaluated:
            self.evaluate()
        thermal = self.case.thermal and self.case.thermal.at(self.state.load_factor)
        return gather_fields(self.share, self.forces, self.state.u, names, probes, thermal)

    def probes(self) -> dict[str, Any] | None:
        """What the scene's probes of points, sets and cuts read at the state, by name; None except on rank 0."""
        fields = self.fields(probes=self.probe_reader)
        return fields and fields.probed

    def internal_forces(self) -> NodalForces | None:
        """Forces by which bonds and elements resist the displacements, at points and nodes; None except on rank 0.

        Supports and loads are not in them: in equilibrium they are what these put on the body. Points of the overlap
        hand theirs to the nodes that they follow, and have 0.
        """
        return gather_forces(self.share, self.model, -self.evaluate())

    def damage(self) -> np.ndarray | None:
        """Local damage (eq. 5) of all points, float64, shape (n_points,); None except on rank 0.

        The deck must have ``output.damage = true``: weights of the intact bonds are kept for it.
        """
        return gather_damage(self.share, self.model)

    def bonds(self) -> BondList | None:
        """The intact bonds that this rank computes, each of the body on one rank; None without peridynamics.

        Some 100 bytes a bond: meant for bodies small enough to look at single bonds.
        """
        if self.model.bonds is None:
            return None
        if not self._evaluated:
            self.evaluate()
        units = self.share.units
        found = list_bonds(self.model.points, self.model.bonds, self.forces.of_bonds.S)
        return replace(
            found,
            start=found.start * units.length + units.origin,
            vector=found.vector * units.length,
            stiffness=found.stiffness * units.force * units.length,
        )

    def broken_bonds(self) -> np.ndarray:
        """Points of the bonds that broke on this rank, int64, shape (n, 2), in the order in which they broke.

        Ids are those of `BondList.points`.
        """
        return self.failure.broken_pairs() if self.failure else np.empty((0, 2), np.int64)

    @property
    def points(self) -> np.ndarray | None:
        """Reference positions of the peridynamic points, float64, shape (n_points, 3); None except on rank 0."""
        return getattr(gather_geometry(self.share), "point_positions", None)

    @property
    def nodes(self) -> np.ndarray | None:
        """Reference positions of the nodes of elements, float64, shape (n_nodes, 3); None except on rank 0."""
        return getattr(gather_geometry(self.share), "node_positions", None)

    @property
    def cells(self) -> Cells | None:
        """The cells of the mesh: corners, regions, and what describes each; None except on rank 0."""
        geometry = gather_geometry(self.share)
        return list_cells(self.scene, geometry) if geometry else None
