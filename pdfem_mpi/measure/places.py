"""Strain and stress at places of the body, and over sets of cells."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from pdfem_mpi.body.locating import locate
from pdfem_mpi.body.share import Share
from pdfem_mpi.kernels.hex8 import GAUSS_POINTS
from pdfem_mpi.measure.field_values import field_of, mean_of
from pdfem_mpi.measure.geometry import Geometry
from pdfem_mpi.measure.recovered import Recovered
from pdfem_mpi.measure.stresses import Mechanics
from pdfem_mpi.parallel.comm import broadcast, largest
from pdfem_mpi.parallel.slabs import gather_rows
from pdfem_mpi.parallel.sums import exact_dots


@dataclass(frozen=True)
class Places:
    """Places of the body, and the cells that hold them; the same on all ranks.

    Attributes
    ----------
    cells : int64, shape (n_cells,)
        Cells of the mesh that hold any of them.
    on_elements : bool, shape (n_cells,)
        Those with nodes; what the others have is read off their bonds.
    weights : float64, shape (n_places, n_cells, 8)
        Of each cell's eight points at each place; they add up to 1, and to 0 outside of the body.
    inside : bool, shape (n_places,)
        Those that any cell holds.
    """

    cells: np.ndarray
    on_elements: np.ndarray
    weights: np.ndarray
    inside: np.ndarray


def find_places(share: Share, geometry: Geometry | None, positions: Sequence) -> Places:
    """Where positions lie: in a cell of elements by the functions through its Gauss points, in others by the mean.

    Collective; ``geometry`` is needed on rank 0.
    """
    return broadcast(share.comm, None if geometry is None else _find(geometry, positions))


def _find(geometry: Geometry, positions: Sequence) -> Places:
    found = []
    for position in positions:
        holders, outside = locate(geometry, np.asarray(position, float))
        found.append(holders if outside <= geometry.mesh.tolerance else [])
    cells = np.unique([holder.cell for holders in found for holder in holders]).astype(np.int64)
    weights = np.zeros((len(found), len(cells), 8))
    for row, holders in zip(weights, found, strict=True):
        for holder in holders:
            own = np.full(8, 0.125)
            if holder.nodes is not None:
                own = np.prod((1.0 + 3.0 * np.clip(holder.coordinates, -1.0, 1.0) * GAUSS_POINTS) / 2.0, axis=1)
            row[np.searchsorted(cells, holder.cell)] += own / len(holders)
    return Places(cells, geometry.has_nodes[cells], weights, np.array([len(holders) > 0 for holders in found]))


def mechanics_at(places: Places, recovered: Recovered) -> Mechanics | None:
    """Strain, stress and energy density at the places, shape (n_places, 1, ...); None except on rank 0. Collective.

    They are NaN outside of the body.
    """
    comm, table = recovered.share.comm, np.zeros((len(places.cells), 8, 13))
    for chosen, mechanics in ((places.on_elements, recovered.elements), (~places.on_elements, recovered.bonds)):
        wanted = places.cells[chosen]
        if mechanics is None or not len(wanted):
            continue
        here = np.isin(mechanics.cells, wanted)
        ids = np.searchsorted(wanted, mechanics.cells[here])
        energy = mechanics.energy_density[here][..., None]
        rows = np.concatenate([mechanics.strain[here], mechanics.stress[here], energy], axis=-1)
        gathered = gather_rows(comm, ids, rows, len(wanted))
        if gathered is not None:
            table[chosen] = gathered
    if comm.rank > 0:
        return None
    n = len(places.weights)
    values = (places.weights.reshape(n, -1, 1) * table.reshape(-1, 13)).sum(axis=1)[:, None]
    values[~places.inside] = np.nan
    numbers, one = np.arange(n), np.ones((n, 1))
    return Mechanics(numbers, numbers, one, values[..., :6], values[..., 6:12], values[..., 12])


def over_cells(recovered: Recovered, cells: np.ndarray, names: Sequence[str]) -> dict[str, dict[str, list[float]]]:
    """Means by volume, smallest and largest values of the means of cells. Collective.

    Parameters
    ----------
    cells : int64
        Numbers of those of the share in the mesh; those of the overlap count as elements.

    Returns
    -------
    dict
        ``mean``, ``smallest`` and ``largest`` by name of the field, lists of its components, the deck's units.
    """
    share, parts = recovered.share, []
    with_nodes = share.mesh.cell_id[share.has_nodes]
    for mechanics, wanted in (
        (recovered.elements, cells[np.isin(cells, with_nodes)]),
        (recovered.bonds, cells[~np.isin(cells, with_nodes)]),
    ):
        if mechanics is not None:
            parts.append(mean_of(_rows(mechanics, np.isin(mechanics.cells, wanted))))
    results = {}
    volume = np.concatenate([part.volume[:, 0] for part in parts])
    for name in names:
        found = [field_of(part, name, share.units) for part in parts]
        values = np.concatenate([part.reshape(len(part), math.prod(part.shape[1:])) for part in found])
        ones = np.ones_like(volume)
        whole, *sums = exact_dots(share.comm, [(volume, ones), *((volume, column) for column in values.T)])
        extremes = largest(share.comm, np.concatenate([values, -values], axis=1).max(axis=0, initial=-np.inf))
        highest, lowest = np.split(extremes, 2)
        results[name] = {
            "mean": [float(total / whole) for total in sums],
            "smallest": (-lowest).tolist(),
            "largest": highest.tolist(),
        }
    return results


def _rows(mechanics: Mechanics, chosen: np.ndarray) -> Mechanics:
    rows = mechanics.cells, mechanics.rows, mechanics.volume
    arrays = *rows, mechanics.strain, mechanics.stress, mechanics.energy_density
    return Mechanics(*(array[chosen] for array in arrays))
