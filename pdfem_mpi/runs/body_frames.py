"""The whole body over the load program, finite elements and peridynamics in one file for the viewer."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pdfem_mpi.measure.body_fields import cell_damage, cell_fields, corner_displacements
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.measure.geometry import Geometry
from pdfem_mpi.runs.frames import Arrays, FramesOutput, by_part, fields_of_points, write_cells
from pdfem_mpi.runs.output import Place

BODY_FILE = "body.vtkhdf"
FINITE_ELEMENTS, PERIDYNAMICS, OVERLAP = 0, 1, 2  # of the field ``model``


class BodyFrames(FramesOutput):
    """All cells of the body as hexahedra: displacements at their corners, and on cells what else is asked for.

    Parameters
    ----------
    with_model : bool
        Which description a cell has changes on the way: it is a field of every frame.
    """

    def __init__(self, names: tuple[str, ...], with_model: bool = False) -> None:
        super().__init__(BODY_FILE, create_changing_body if with_model else create_body, fields_of_points, names, True)
        self.with_model = with_model
        self.place: Place

    def open(self, place: Place) -> None:
        self.place = place
        super().open(place)

    def arrays(self, fields: Fields | None, damage: np.ndarray | None) -> tuple[Arrays, Arrays]:
        """Displacements of all corners; the other fields of all cells."""
        geometry = self.place.geometry
        on_cells = {name: values for name, values in cell_fields(geometry, fields).items() if name in self.names}
        if damage is not None:
            on_cells |= {name: cell_damage(geometry, values) for name, values in by_part(damage).items()}
        if self.with_model:
            on_cells["model"] = model_of(geometry)
        moved = {"displacement": corner_displacements(geometry, fields)} if "displacement" in self.names else {}
        return moved, on_cells


def create_body(place: Place, path: Path) -> None:
    """Write the geometry of all cells."""
    geometry = place.geometry
    data = {"region": geometry.region, "material": geometry.material, "model": model_of(geometry)}
    write_cells(place, path, geometry.mesh.nodes, geometry.mesh.cells, data)


def create_changing_body(place: Place, path: Path) -> None:
    """Write the geometry of all cells, whose descriptions are fields of the frames."""
    geometry = place.geometry
    data = {"region": geometry.region, "material": geometry.material}
    write_cells(place, path, geometry.mesh.nodes, geometry.mesh.cells, data)


def model_of(geometry: Geometry) -> np.ndarray:
    """Which description each cell has, uint8, shape (n_cells,)."""
    model = np.where(geometry.has_points, PERIDYNAMICS, FINITE_ELEMENTS)
    return np.where(geometry.is_overlap, OVERLAP, model).astype("u1")
