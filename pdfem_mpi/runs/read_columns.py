"""What is read off each state of a load program for history.csv: probes, and forces of what has a name."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from pdfem_mpi.body.model_units import ModelUnits
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.mechanical_probes import SetProbe
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import AXES
from pdfem_mpi.model.gauges import Gauge, gauge_of, means_over
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.resultants import resultant_of
from pdfem_mpi.runs.history_rows import columns_of
from pdfem_mpi.stepping import Report


@dataclass(frozen=True)
class Gauges:
    """Columns beside those that every history has.

    Attributes
    ----------
    units : ModelUnits
    of_displacements : dict of Gauge
        By the names of their columns.
    supports : dict of int
        Number of each named support.
    springs : dict of int
        Number of each named table of springs.
    loads : dict of (float64 of shape (3,), bool)
        Force of each named load at load factor 1, and whether it is constant.
    """

    units: ModelUnits
    of_displacements: dict[str, Gauge]
    supports: dict[str, int]
    springs: dict[str, int]
    loads: dict[str, tuple[np.ndarray, bool]]

    @property
    def columns(self) -> tuple[str, ...]:
        """Names of the columns."""
        held = (*self.supports, *self.springs, *self.loads)
        return (*self.of_displacements, *(f"{name}.force_{axis}" for name in held for axis in AXES))

    def read(self, comm, u: np.ndarray, report: Report) -> dict[str, Any]:
        """The columns at a state and its report, in the deck's units. Collective.

        Parameters
        ----------
        u : float64, shape (n_unknowns,), dimension length
        """
        found = {name: gauge.read(comm, u) * self.units.length for name, gauge in self.of_displacements.items()}
        of_names = {name: report.of_supports[number] for name, number in self.supports.items()}
        of_names |= {name: report.of_springs[number] for name, number in self.springs.items()}
        of_names |= {
            name: force if constant else report.load_factor * force for name, (force, constant) in self.loads.items()
        }
        for name, resultant in of_names.items():
            for axis, force in zip(AXES, resultant.tolist(), strict=True):
                found[f"{name}.force_{axis}"] = force * self.units.force
        return found


def all_columns(simulation: Any) -> tuple[str, ...]:
    """Names of all columns of history.csv, of a simulation."""
    return columns_of(simulation.failure is not None, simulation.scene) + simulation.gauges.columns


def make_gauges(scene: Scene, share: Share, model: Model) -> Gauges:
    """What the deck's probes and names ask for. Collective."""
    found = {name: gauge_of(share, model, weights) for name, weights in share.probes.items()}
    for group in model.ties.groups if model.ties else ():
        if (name := scene.ties[group.table].name) is not None:
            found[f"{name}.u_{AXES[group.axis]}"] = Gauge(group.index, group.ones / group.count)
    for probe, chosen in zip(scene.probes, share.selections.probes, strict=True):
        if isinstance(probe, SetProbe) and "displacement" in probe.fields and chosen is not None:
            means = means_over(share, model, chosen.cells)
            found |= {f"{probe.name}.u_{axis}": gauge for axis, gauge in zip(AXES, means, strict=True)}
    loads = {
        name: (resultant_of(scene, share, index)[0], scene.loads[index].constant)
        for name, index in _numbers(scene.loads).items()
    }
    return Gauges(share.units, found, _numbers(scene.supports), _numbers(scene.springs), loads)


def _numbers(tables: Sequence[Any]) -> dict[str, int]:
    return {table.name: index for index, table in enumerate(tables) if table.name is not None}
