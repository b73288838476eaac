"""The whole body over the load program, finite elements and peridynamics in one file for the viewer."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi.measure.body_fields import cell_damage, corner_displacements
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.runs.frames import FramesOutput, write_cells
from pdfem_mpi.runs.output import Place

BODY_FILE = "body.vtkhdf"
FINITE_ELEMENTS, PERIDYNAMICS, OVERLAP = 0, 1, 2  # of the field ``model``


class BodyFrames(FramesOutput):
    """All cells of the body as hexahedra: displacements at their corners, damage on the cells."""

    def __init__(self) -> None:
        super().__init__(BODY_FILE, create_body, lambda fields: None, True)
        self.place: Place

    def open(self, place: Place) -> None:
        self.place = place
        super().open(place)

    def arrays(self, fields: Fields | None, damage: np.ndarray | None) -> tuple[dict[str, Any], dict[str, Any]]:
        """Displacements of all corners, and the damage of all cells."""
        discretization = self.place.discretization
        on_cells = {} if damage is None else {"damage": cell_damage(discretization, damage)}
        return {"displacement": corner_displacements(discretization, fields)}, on_cells


def create_body(place: Place, path: Path) -> None:
    """Write the geometry of all cells."""
    discretization = place.discretization
    model = np.where(discretization.has_points, PERIDYNAMICS, FINITE_ELEMENTS)
    data = {
        "region": discretization.region,
        "material": discretization.material,
        "model": np.where(discretization.is_overlap, OVERLAP, model).astype("u1"),
    }
    write_cells(place, path, discretization.mesh.nodes, discretization.mesh.cells, data)
