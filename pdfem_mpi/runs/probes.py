"""Outputs of the deck's probes: numbers, tables and figures."""

from __future__ import annotations

from typing import Any

import numpy as np

from pdfem_mpi.deck.mechanical_probes import CutProbe, EnergyReleaseProbe, PointProbe, SetProbe
from pdfem_mpi.deck.outputs import BarProbe, DisplacementProbe, LineProbe, OpeningProbe
from pdfem_mpi.deck.table import AXES
from pdfem_mpi.measure.bar import Bar, bar_results, measure_bar
from pdfem_mpi.measure.displacement import displacement_at
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.measure.line import Line, measure_line
from pdfem_mpi.results.lines import COMPONENTS, write_line
from pdfem_mpi.results.samples import BarStations, LineSamples
from pdfem_mpi.runs.output import Drawing, Output, Place, new_figure


class DisplacementOutput(Output):
    """The displacement at a point."""

    def __init__(self, probe: DisplacementProbe) -> None:
        super().__init__()
        self.probe = probe

    def measure(self, place: Place, fields: Fields, load_factor: float) -> None:
        self.results = {self.probe.name: displacement_at(place.geometry, fields, self.probe.point).tolist()}


class OpeningOutput(Output):
    """How far two points move apart: the last row of its column."""

    def __init__(self, probe: OpeningProbe) -> None:
        super().__init__()
        self.column, self.name = f"{probe.name}.opening", probe.name

    def write(self, columns: dict[str, Any], fields: Fields | None, damage: np.ndarray | None) -> None:
        self.results = {self.name: columns[self.column]}


class BarOutput(Output):
    """A bar's comparison with uniform tension, and its figure."""

    def __init__(self, probe: BarProbe) -> None:
        super().__init__()
        self.probe = probe
        self.bar: Bar | None = None

    def measure(self, place: Place, fields: Fields, load_factor: float) -> None:
        self.bar = measure_bar(place.scene, place.geometry, fields, self.probe, load_factor)
        self.results = bar_results(place.scene, place.geometry, self.bar, self.probe, load_factor)

    def drawings(self, place: Place) -> list[Drawing]:
        if self.bar is None:
            return []
        bar = self.bar
        kind = np.where(bar.has_points, "peridynamics", "finite elements")
        stations = BarStations(
            bar.coordinate, bar.displacement, bar.exact, kind, bar.interface, bar.overlap, self.probe.axis
        )
        words = place.scene.title, place.scene.units.length
        return [Drawing(new_figure(place, "axial_displacement"), _draw_bar, (stations, *words))]


class LineOutput(Output):
    """Displacements along a line: a table, and its figure."""

    def __init__(self, probe: LineProbe) -> None:
        super().__init__()
        self.probe = probe
        self.line: Line | None = None
        self.more: dict[str, np.ndarray] = {}

    def measure(self, place: Place, fields: Fields, load_factor: float) -> None:
        self.line = measure_line(place.geometry, fields, self.probe)
        self.more = fields.probed.get(self.probe.name, {})

    def close(self, place: Place) -> None:
        line = self.line
        if line is None:
            return
        (place.written.folder / "lines").mkdir(exist_ok=True)
        inside = line.kind != ""
        u = [values if known else None for values, known in zip(line.displacement, inside, strict=True)]
        rows = zip(line.distance, line.position, u, line.kind, strict=True)
        more = {
            f"{name}_{word}": values[:, k]
            for name, values in self.more.items()
            for k, word in enumerate(COMPONENTS[values.shape[1]])
        }
        write_line(place.written.new(f"lines/{self.probe.name}.csv"), rows, more)

    def drawings(self, place: Place) -> list[Drawing]:
        line = self.line
        if line is None:
            return []
        moving = np.flatnonzero(np.ptp(line.position, axis=0) > 0.0)
        on_axis = len(moving) == 1
        fixed = (f"{'xyz'[d]} = {line.position[0, d]:.6g}" for d in range(3) if d not in moving)
        samples = LineSamples(
            line.position[:, moving[0]] if on_axis else line.distance,
            line.displacement[:, :2],
            line.kind,
            "xyz"[moving[0]] if on_axis else "distance from its start",
            f"line {self.probe.name}" + (f": {', '.join(fixed)}" if on_axis else ""),
        )
        words = place.scene.title, place.scene.units.length
        return [Drawing(new_figure(place, f"line_{self.probe.name}"), _draw_line, (samples, *words))]


def _draw_bar(*arguments: Any) -> None:
    from pdfem_mpi.results import plots

    plots.axial_displacement(*arguments)


def _draw_line(*arguments: Any) -> None:
    from pdfem_mpi.results import plots

    plots.displacement_along_line(*arguments)


class PointOutput(Output):
    """Fields at a point."""

    def __init__(self, probe: PointProbe) -> None:
        super().__init__()
        self.probe = probe

    def measure(self, place: Place, fields: Fields, load_factor: float) -> None:
        rows = {name: values[0].tolist() for name, values in fields.probed.get(self.probe.name, {}).items()}
        found = {name: row if len(row) > 1 else row[0] for name, row in rows.items()}
        if "displacement" in self.probe.fields:
            found = {"displacement": displacement_at(place.geometry, fields, self.probe.point).tolist()} | found
        self.results = {self.probe.name: found}


class ReadOutput(Output):
    """What all ranks together read: of a set of cells, or of a plane."""

    def __init__(self, probe: SetProbe | CutProbe | EnergyReleaseProbe) -> None:
        super().__init__()
        self.probe = probe

    def measure(self, place: Place, fields: Fields, load_factor: float) -> None:
        if self.probe.name in fields.probed:  # the rate of a run that did not come to its end is not known
            self.results = {self.probe.name: fields.probed[self.probe.name]}


class SetOutput(ReadOutput):
    """Means and extremes over a set of cells, and its mean displacement as the last row of the history has it."""

    def __init__(self, probe: SetProbe) -> None:
        super().__init__(probe)
        self.mean: dict[str, Any] = {}

    def write(self, columns: dict[str, Any], fields: Fields | None, damage: np.ndarray | None) -> None:
        if "displacement" in self.probe.fields:
            self.mean = {"displacement": {"mean": [columns[f"{self.probe.name}.u_{axis}"] for axis in AXES]}}

    def measure(self, place: Place, fields: Fields, load_factor: float) -> None:
        super().measure(place, fields, load_factor)
        self.results = {self.probe.name: self.mean | self.results.get(self.probe.name, {})}


#: Which output a table of ``[[probes]]`` asks for.
OF_PROBE = {
    DisplacementProbe: DisplacementOutput,
    BarProbe: BarOutput,
    LineProbe: LineOutput,
    PointProbe: PointOutput,
    SetProbe: SetOutput,
    CutProbe: ReadOutput,
    EnergyReleaseProbe: ReadOutput,
    OpeningProbe: OpeningOutput,
}
