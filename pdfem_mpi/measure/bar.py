"""A bar's comparison with uniform tension, by means over its cross sections."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from pdfem_mpi.deck.outputs import BarProbe
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.kernels.hex8 import gauss_volumes
from pdfem_mpi.measure.fields import Fields
from pdfem_mpi.measure.geometry import Geometry

#: Stations nearer than this many cutoff radii to an end or to the interface are left out of straight-line fits.
MARGIN = 2.0
#: Layers whose exact strains agree within this fraction have one modulus.
SAME_STRAIN = 1e-9


@dataclass(frozen=True)
class Bar:
    """Mean displacements of the cross sections of a bar.

    Attributes
    ----------
    coordinate : float64, shape (n,), dimension length
        Centres of the layers of cells along the axis.
    displacement, exact : float64, shape (n,), dimension length
        Mean axial displacement of each layer, its rigid part chosen so that the two end faces move by opposite
        amounts (a face's displacement is its layer's, continued linearly; of a bar halved by a mirror plane, as it is),
        and the integral of ``strain`` from the middle.
    strain : float64, shape (n,), dimension 1
        ``stress / E`` of each layer, with the mean of Young's modulus over its volume: exact where the materials of
        a cross section have one Poisson's ratio, and away from changes along the axis.
    elongation : float, dimension length
        The exact one, from end face to end face.
    moduli_change : float64, shape (n_changes,), dimension length
        Axial coordinates between layers of different moduli.
    has_points : bool, shape (n,)
        Layers described by free peridynamic points (else by elements or the overlap).
    lateral_strain : float64, shape (n,), dimension 1
        Slope of the lateral displacements over the lateral positions.
    interfaces : tuple of float
        Axial coordinates between free peridynamic cells and the overlap.
    overlap : tuple of float or None
        Axial interval of the overlap at the first interface.
    """

    coordinate: np.ndarray
    displacement: np.ndarray
    exact: np.ndarray
    strain: np.ndarray
    elongation: float
    moduli_change: np.ndarray
    has_points: np.ndarray
    lateral_strain: np.ndarray
    interfaces: tuple[float, ...]
    overlap: tuple[float, float] | None

    @property
    def interface(self) -> float | None:
        """The first interface."""
        return self.interfaces[0] if self.interfaces else None

    def first_run(self, of_points: bool) -> np.ndarray:
        """Layers of one description and modulus, up to the first that is not; bool, shape (n,)."""
        same = self.has_points == of_points
        starts = same & (np.diff(same, prepend=False) | np.append(False, changes(self.strain)))
        return same & (np.cumsum(starts) == 1)


def measure_bar(scene: Scene, geometry: Geometry, fields: Fields, probe: BarProbe, factor: float) -> Bar:
    """Average a bar over its cross sections at a load factor."""
    mesh = geometry.mesh
    axis = "xyz".index(probe.axis)
    others = [d for d in range(3) if d != axis]
    place = np.rint((mesh.centroids[:, axis] - mesh.lower[axis]) / mesh.tolerance).astype(np.int64)
    values, layer = np.unique(np.floor((place + 10) / 20).astype(np.int64), return_inverse=True)
    n = len(values)

    x_points = u_points = None
    if geometry.has_points.any():
        x_points = geometry.point_positions.reshape(-1, 8, 3)
        u_points = fields.u_points.reshape(-1, 8, 3)
    coordinate, displacement, lateral = np.zeros(n), np.zeros(n), np.zeros(n)
    faces = []
    of_points = np.zeros(n, bool)
    units = geometry.units
    planes = [
        [position * units.length + units.origin[d] for position in positions]
        for d, positions in enumerate(geometry.mirrors.planes)
    ]
    for k in range(n):
        cells = np.flatnonzero(layer == k)
        of_points[k] = geometry.is_peridynamic[cells].all()
        if of_points[k]:
            number = geometry.point_row[cells]
            x, u = x_points[number].reshape(-1, 3), u_points[number].reshape(-1, 3)
        else:
            cells = cells[geometry.has_nodes[cells]]
            corners = mesh.cells[cells]
            x = mesh.nodes[corners].reshape(-1, 3)
            u = fields.u_nodes[geometry.node_row[corners]].reshape(-1, 3)
        coordinate[k] = mesh.centroids[cells, axis].mean()
        displacement[k] = u[:, axis].mean()
        lateral[k] = np.mean([_slope(x[:, d], u[:, d], planes[d]) for d in others])
        if k in (0, n - 1):
            face = mesh.lower[axis] if k == 0 else mesh.upper[axis]
            faces.append(_straight(*_line(x[:, axis], u[:, axis]), face))
    if geometry.mirrors.planes[axis]:
        fixed_end = 0.0
    else:
        displacement -= 0.5 * (faces[0] + faces[-1])
        fixed_end = 0.5
    reach = np.array([mesh.nodes[mesh.cells[layer == k], axis].max() for k in range(n)])
    strain = factor * probe.stress / (scene.material.youngs_modulus * _layer_moduli(geometry, layer, n))
    ends = np.concatenate([[0.0], np.cumsum(strain * np.diff(reach, prepend=mesh.lower[axis]))])
    exact = 0.5 * (ends[:-1] + ends[1:]) - fixed_end * ends[-1]
    switches = np.flatnonzero(of_points[1:] != of_points[:-1])
    overlap = None
    if len(switches):
        first, last = _first_overlap(geometry, layer, switches[0])
        overlap = (float(reach[first - 1]) if first else float(mesh.lower[axis]), float(reach[last]))
    interfaces = tuple(reach[switches].tolist())
    moduli_change = reach[:-1][changes(strain)]
    return Bar(
        coordinate, displacement, exact, strain, float(ends[-1]), moduli_change, of_points, lateral, interfaces, overlap
    )


def _first_overlap(geometry: Geometry, layer: np.ndarray, switch: int) -> tuple[int, int]:
    """First and last layer of cells of the overlap at the interface after layer ``switch``; ``layer``, (n_cells,)."""
    n = int(layer.max()) + 1
    of_elements = geometry.is_overlap & ~geometry.is_peridynamic
    shared = np.array([of_elements[layer == k].any() for k in range(n)])
    first = last = switch if shared[switch] else switch + 1
    while first > 0 and shared[first - 1]:
        first -= 1
    while last + 1 < n and shared[last + 1]:
        last += 1
    return first, last


def changes(strain: np.ndarray) -> np.ndarray:
    """Whether the strain of a layer differs from the one before by more than round-off; bool, shape (n - 1,)."""
    return ~np.isclose(strain[1:], strain[:-1], rtol=SAME_STRAIN, atol=0.0)


def _layer_moduli(geometry: Geometry, layer: np.ndarray, n: int) -> np.ndarray:
    """Mean of Young's modulus over the volume of each layer of cells, model units; float64, shape (n,)."""
    volume = gauss_volumes(geometry.model_nodes[geometry.mesh.cells]).sum(axis=1)
    stiffness = np.bincount(layer, volume * geometry.materials.youngs_modulus[geometry.material], n)
    return stiffness / np.bincount(layer, volume, n)


def _line(x: np.ndarray, u: np.ndarray) -> tuple[float, float, float]:
    """The straight line of least squares: slope, and the place and value of its middle."""
    middle, value = float(x.mean()), float(u.mean())
    return float(((x - middle) * (u - value)).sum() / ((x - middle) ** 2).sum()), middle, value


def _straight(slope: float, middle: float, value: float, x: float) -> float:
    return value + slope * (x - middle)


def _slope(x: np.ndarray, u: np.ndarray, planes: list[float]) -> float:
    """Slope of the straight line through displacements, of those beyond a mirror plane as well."""
    if not planes:
        return _line(x, u)[0]
    return float(((x - planes[0]) * u).sum() / ((x - planes[0]) ** 2).sum())


def bar_results(scene: Scene, geometry: Geometry, bar: Bar, probe: BarProbe, factor: float) -> dict:
    """End error, moduli and Poisson's ratio of each description, and the jump at the first interface.

    The end error is that of the last layer of cells, in percent of the exact displacement of the end face.
    Moduli, relative to the run's own, and the jump come from straight lines fitted to the first run of layers of each
    description and modulus, those more than ``MARGIN`` cutoff radii (of cell edges, without peridynamics) away from the
    ends, the interfaces and changes of the modulus. The jump is the peridynamic line minus the finite-element line at
    the interface, in units of the bar's mean strain times cell edge; only where both runs reach it.
    """
    margin = MARGIN * (geometry.cutoff * geometry.units.length or geometry.mesh.mean_edge)
    lower, upper = (corner["xyz".index(probe.axis)] for corner in (geometry.mesh.lower, geometry.mesh.upper))
    strain = bar.elongation / (upper - lower)
    halved = bool(geometry.mirrors.planes["xyz".index(probe.axis)])
    half_length = (1.0 if halved else 0.5) * (upper - lower)
    clear = (halved | (bar.coordinate > lower + margin)) & (bar.coordinate < upper - margin)
    for interface in (*bar.interfaces, *bar.moduli_change):
        clear &= np.abs(bar.coordinate - interface) > margin
    results = {
        "end_displacement": float(bar.displacement[-1]),
        "end_error_percent": float(100.0 * (bar.displacement[-1] - bar.exact[-1]) / (strain * half_length)),
    }
    lines, runs = {}, []
    for name, of_points in (("finite_elements", False), ("peridynamics", True)):
        chosen = run = bar.first_run(of_points)
        if np.count_nonzero(chosen & clear) >= 2:
            chosen = chosen & clear
        if np.count_nonzero(chosen) < 2:
            continue
        lines[name] = _line(bar.coordinate[chosen], bar.displacement[chosen])
        runs.append(np.flatnonzero(run)[[0, -1]])
        results[f"modulus_ratio_{name}"] = float(bar.strain[run][0] / lines[name][0])
        results[f"poissons_ratio_{name}"] = float(-bar.lateral_strain[chosen].mean() / lines[name][0])
    if len(lines) == 2 and (runs[0][1] + 1 == runs[1][0] or runs[1][1] + 1 == runs[0][0]):
        bonds, elements = (_straight(*lines[name], bar.interface) for name in ("peridynamics", "finite_elements"))
        results["interface_jump"] = float((bonds - elements) / (strain * geometry.mesh.mean_edge))
    return results
