"""Strain, stress and what follows from them, by name, gathered on rank 0 in the deck's units."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np

from pdfem_mpi.body.model_units import ModelUnits
from pdfem_mpi.deck.field_names import GAUSS_FIELDS, MECHANICAL_FIELDS, field_problems
from pdfem_mpi.measure.recovered import Recovered
from pdfem_mpi.measure.stresses import Mechanics
from pdfem_mpi.measure.tensors import principal, von_mises
from pdfem_mpi.parallel.slabs import gather_rows

Arrays = dict[str, np.ndarray]


def gather_mechanics(recovered: Recovered, names: Iterable[str]) -> tuple[Arrays, Arrays]:
    """The fields of these names at the displacements of the last evaluation; empty except on rank 0. Collective.

    Parameters
    ----------
    names : of `MECHANICAL_FIELDS` and `GAUSS_FIELDS`
        Nothing is computed for others.

    Raises
    ------
    ValueError
        On all ranks: there is no such field.

    Returns
    -------
    of_points : dict of float64, shape (n_points,) or (n_points, k)
        By point ids.
    of_cells : dict of float64, shape (n_cells,) or (n_cells, k)
        Means of the cells with elements or overlap, in the order of the mesh; `GAUSS_FIELDS` of their eight Gauss
        points, one after the other.
    """
    names, share, comm = tuple(names), recovered.share, recovered.share.comm
    of_points: Arrays = {}
    of_cells: Arrays = {}
    if problems := field_problems("names", names, MECHANICAL_FIELDS + GAUSS_FIELDS):
        raise ValueError(f"{problems[0].key} {problems[0].text}")
    if not names:
        return of_points, of_cells
    virial = recovered.bonds if set(names) & set(MECHANICAL_FIELDS) else None
    elements = recovered.elements
    for name in names:
        if virial and name in MECHANICAL_FIELDS:
            values = field_of(virial, name, share.units)
            table = gather_rows(comm, virial.rows, values, share.counts.point_cells)
            if table is not None:
                of_points[name] = table.reshape(-1, *table.shape[2:])
        if elements and name in MECHANICAL_FIELDS + GAUSS_FIELDS:
            values = cell_field_of(elements, name, share.units)
            table = gather_rows(comm, elements.rows, values, share.counts.node_cells)
            if table is not None:
                of_cells[name] = table
    return of_points, of_cells


def field_of(mechanics: Mechanics, name: str, units: ModelUnits) -> np.ndarray:
    """One of `MECHANICAL_FIELDS` in the deck's units at the eight points of cells, float64, (n, 8) or (n, 8, k)."""
    strain, stress = mechanics.strain, mechanics.stress
    if name == "strain":
        return strain
    if name == "stress":
        return stress * units.stress
    if name == "principal_strains":
        return principal(strain)[0]
    if name == "principal_stresses":
        return principal(stress)[0] * units.stress
    if name == "principal_axes":
        return principal(stress)[1].reshape(*stress.shape[:2], 9)
    if name == "von_mises":
        return von_mises(stress) * units.stress
    if name == "energy_density":
        return mechanics.energy_density * units.stress
    raise ValueError(f"{name} is not one of {', '.join(MECHANICAL_FIELDS)}")


def cell_field_of(mechanics: Mechanics, name: str, units: ModelUnits) -> np.ndarray:
    """The same of the cells' means, float64, (n,) or (n, k); of `GAUSS_FIELDS` what the eight points have, in a row."""
    if name in GAUSS_FIELDS:
        values = field_of(mechanics, name.removesuffix("_at_gauss_points"), units)
        return values.reshape(len(values), 8 * values.shape[2])
    values = field_of(mean_of(mechanics), name, units)
    return values[:, 0]


def mean_of(mechanics: Mechanics) -> Mechanics:
    """Means over the volumes of the cells, as if each had one point; shape (n, 1, ...)."""
    whole = np.zeros(len(mechanics.volume))
    for g in range(8):
        whole += mechanics.volume[:, g]
    means = []
    for values in (mechanics.strain, mechanics.stress, mechanics.energy_density):
        share = mechanics.volume.reshape(-1, 8, *(1,) * (values.ndim - 2))
        total = np.zeros_like(values[:, :1])
        for g in range(8):
            total[:, 0] += share[:, g] * values[:, g]
        means.append(total / whole.reshape(-1, *(1,) * (values.ndim - 1)))
    return Mechanics(mechanics.cells, mechanics.rows, whole[:, None], *means)
