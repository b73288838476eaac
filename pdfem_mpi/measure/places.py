"""Strain and stress at places of the body, and over sets of cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.discretization import Discretization
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS
from pdfem_mpi.measure.displacement import locate
from pdfem_mpi.measure.field_values import field_of, mean_of
from pdfem_mpi.measure.recovered import Recovered
from pdfem_mpi.measure.stresses import Mechanics
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.parallel.slabs import gather_rows
from pdfem_mpi.parallel.sums import exact_dots


@dataclass(frozen=True)
class Places:
    """Places of the body, and the cells that hold them; the same on all ranks.

    Attributes
    ----------
    cells : int64, shape (n_cells,)
        Cells of the mesh that hold any of them.
    share : float64, shape (n_places, n_cells, 8)
        Weight of each cell's eight points at each place; rows add up to 1, and are NaN outside of the body.
    """

    cells: np.ndarray
    share: np.ndarray


def find_places(discretization: Discretization, positions: Sequence) -> Places:
    """Where positions lie: in a cell of elements by the functions through its Gauss points, in others by the mean."""
    found = []
    for position in positions:
        holders, outside = locate(discretization, np.asarray(position, float))
        found.append(holders if outside <= discretization.mesh.tolerance else {})
    cells = np.unique([cell for holders in found for cell in holders]).astype(np.int64)
    share = np.zeros((len(found), len(cells), 8))
    for row, holders in zip(share, found, strict=True):
        for cell, coordinates in holders.items():
            weights = np.full(8, 0.125)
            if discretization.has_nodes[cell]:
                rst = np.clip(coordinates, -1.0, 1.0)
                weights = np.prod((1.0 + 3.0 * rst * GAUSS_POINTS) / 2.0, axis=1)
            row[np.searchsorted(cells, cell)] += weights / len(holders)
        if not holders:
            row[:] = np.nan
    return Places(cells, share)


def mechanics_at(places: Places, recovered: Recovered) -> Mechanics | None:
    """Strain, stress and energy density at the places, shape (n_places, 1, ...); None except on rank 0. Collective."""
    discretization, comm = recovered.discretization, recovered.forces.model.comm
    on_elements = discretization.has_nodes[places.cells]
    table = np.zeros((len(places.cells), 8, 13))
    element_number = np.cumsum(discretization.has_nodes) - 1
    for chosen, mechanics, number in (
        (on_elements, recovered.elements, element_number),
        (~on_elements, recovered.bonds, discretization.point_cell_number),
    ):
        wanted = number[places.cells[chosen]]
        if mechanics is None or not len(wanted):
            continue
        here = np.isin(mechanics.cells, wanted)
        order = np.argsort(wanted)
        ids = order[np.searchsorted(wanted, mechanics.cells[here], sorter=order)]
        energy = mechanics.energy_density[here][..., None]
        rows = np.concatenate([mechanics.strain[here], mechanics.stress[here], energy], axis=-1)
        gathered = gather_rows(comm, ids, rows, len(wanted))
        if gathered is not None:
            table[chosen] = gathered
    if comm.rank > 0:
        return None
    n = len(places.share)
    values = (places.share.reshape(n, -1, 1) * table.reshape(-1, 13)).sum(axis=1)[:, None]
    return Mechanics(np.arange(n), np.ones((n, 1)), values[..., :6], values[..., 6:12], values[..., 12])


def over_cells(recovered: Recovered, chosen: np.ndarray, names: Sequence[str]) -> dict[str, dict[str, list[float]]]:
    """Means by volume, smallest and largest values of the means of cells. Collective.

    Parameters
    ----------
    chosen : bool, shape (n_cells,)
        Cells of the mesh; those of the overlap count as elements.

    Returns
    -------
    dict
        ``mean``, ``smallest`` and ``largest`` by name of the field, lists of its components, the deck's units.
    """
    discretization, comm = recovered.discretization, recovered.forces.model.comm
    of_elements = chosen[discretization.has_nodes]
    of_bonds = (chosen & ~discretization.has_nodes)[discretization.has_points]
    parts = []
    for mechanics, mask in ((recovered.elements, of_elements), (recovered.bonds, of_bonds)):
        if mechanics is not None:
            parts.append(mean_of(_rows(mechanics, mask[mechanics.cells])))
    results = {}
    volume = np.concatenate([part.volume[:, 0] for part in parts])
    for name in names:
        found = [field_of(part, name, discretization.units) for part in parts]
        values = np.concatenate([part.reshape(len(part), math.prod(part.shape[1:])) for part in found])
        ones = np.ones_like(volume)
        pairs = [(volume, ones), *((volume, column) for column in values.T)]
        whole, *sums = exact_dots(comm, pairs)
        extremes = largest(comm, np.concatenate([values, -values], axis=1).max(axis=0, initial=-np.inf))
        highest, lowest = np.split(extremes, 2)
        results[name] = {
            "mean": [float(total / whole) for total in sums],
            "smallest": (-lowest).tolist(),
            "largest": highest.tolist(),
        }
    return results


def _rows(mechanics: Mechanics, chosen: np.ndarray) -> Mechanics:
    arrays = mechanics.cells, mechanics.volume, mechanics.strain, mechanics.stress, mechanics.energy_density
    return Mechanics(*(array[chosen] for array in arrays))
