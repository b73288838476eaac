"""What the deck's mechanical probes read at a row of the load program, all ranks together."""

from __future__ import annotations

from typing import Any

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.mechanical_probes import CutProbe, PointProbe, SetProbe
from pdfem_mpi.deck.outputs import LineProbe
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.measure.cut import Cut, meets_body, near_mirrors, resultant, sides
from pdfem_mpi.measure.field_values import field_of
from pdfem_mpi.measure.geometry import gather_geometry
from pdfem_mpi.measure.line import positions_along
from pdfem_mpi.measure.places import find_places, mechanics_at, over_cells
from pdfem_mpi.measure.recovered import Recovered
from pdfem_mpi.model.model import Model


class ProbeReader:
    """Knows where the deck's mechanical probes lie, and reads them.

    Parameters
    ----------
    scene : Scene
    share : Share
    model : Model

    Raises
    ------
    SceneError
        On all ranks: a probe that meets nothing.
    """

    def __init__(self, scene: Scene, share: Share, model: Model):
        self.share, self.model, self.probes = share, model, []
        mesh, length = share.mesh, share.units.length
        self.near = np.empty((0, 3), bool)
        if any(isinstance(probe, CutProbe) for probe in scene.probes):
            self.near = near_mirrors(model, share.cutoff, mesh.tolerance / length)
        self._geometry = gather_geometry(share) if any(_is_of_places(probe) for probe in scene.probes) else None
        messages: list[str] = []
        for index, probe in enumerate(scene.probes):
            place = None
            try:
                place = self._place(probe, index)
            except SceneError as error:
                messages += error.messages
            if place is not None:
                self.probes.append((probe, place))
        self._geometry = None
        if messages:
            raise SceneError(messages)

    def _place(self, probe: Any, index: int) -> Any:
        """What a probe needs to be read again and again; None for those that need nothing. Collective."""
        if _is_of_places(probe):
            positions = [probe.point] if isinstance(probe, PointProbe) else positions_along(probe)[1]
            return find_places(self.share, self._geometry, positions)
        if isinstance(probe, SetProbe):
            selections = self.share.selections
            if selections.problems["probes"][index]:
                raise SceneError(selections.problems["probes"][index])
            return self.share.mesh.cell_id[selections.probes[index].cells]
        if isinstance(probe, CutProbe):
            return self._cut(probe, f"probes.{index}")
        return None

    def _cut(self, probe: CutProbe, where: str) -> tuple[Cut, np.ndarray]:
        units, mesh = self.share.units, self.share.mesh
        cut = Cut((np.array(probe.point) - units.origin) / units.length, np.array(probe.normal))
        below = sides(self.model, cut, mesh.tolerance / units.length)
        if not meets_body(self.model, below):
            low, high = (", ".join(f"{c:.6g}" for c in corner) for corner in (mesh.lower, mesh.upper))
            raise SceneError(
                [
                    f"{where} cuts nothing: all of the body, from ({low}) to ({high}), is on one side of the plane "
                    f"through ({', '.join(f'{c:.6g}' for c in probe.point)}). Move the point."
                ]
            )
        return cut, below

    def read(self, recovered: Recovered, u: np.ndarray) -> dict[str, Any]:
        """What every probe finds, by its name; on rank 0 all of it. Collective.

        Parameters
        ----------
        u : float64, shape (n_unknowns,)
            Displacements of the last evaluation.
        """
        found: dict[str, Any] = {}
        internal = recovered.internal(u) if any(isinstance(probe, CutProbe) for probe, _ in self.probes) else None
        units = self.share.units
        for probe, place in self.probes:
            if isinstance(probe, CutProbe):
                total = resultant(self.model, *place, internal, u, self.near) * units.force
                total[3:] *= units.length
                found[probe.name] = {"force": _known(total[:3]), "moment": _known(total[3:])}
            elif isinstance(probe, SetProbe):
                found[probe.name] = over_cells(recovered, place, probe.recovered) if probe.recovered else {}
            else:
                values = mechanics_at(place, recovered)
                if values is not None:
                    names = [name for name in probe.fields if name != "displacement"]
                    found[probe.name] = {
                        name: field_of(values, name, units).reshape(len(values.cells), -1) for name in names
                    }
        return found


def _is_of_places(probe: Any) -> bool:
    """Whether a probe reads more than displacements at places."""
    return isinstance(probe, PointProbe | LineProbe) and set(probe.fields) != {"displacement"}


def _known(values: np.ndarray) -> list[float | None]:
    return [None if np.isnan(value) else float(value) for value in values]
