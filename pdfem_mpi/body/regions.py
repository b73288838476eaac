"""Which region of the deck each cell of the mesh belongs to."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.deck.regions import Region
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.mesh import named_sets
from pdfem_mpi.mesh.hexmesh import HexMesh, list_cells


def assign_regions(scene: Scene, mesh: HexMesh) -> np.ndarray:
    region = np.full(len(mesh.cells), -1, np.int16)
    messages, unknown = [], False
    round_ones = np.zeros(len(mesh.cells), bool)
    for entry in scene.regions:
        if entry.radius is not None:
            round_ones |= _inside(mesh, entry)
    for index, entry in enumerate(scene.regions):
        if entry.set is None:
            inside = _inside(mesh, entry)
        else:
            where = f"regions.{entry.name}.set"
            try:
                named_sets.kind_of(mesh, entry.set, "regions", where)
            except SceneError as error:
                messages += error.messages
                unknown = True
                continue
            inside = named_sets.cells(mesh, entry.set)
        if mesh.everywhere.lacks(inside):
            shape = "box misses" if entry.radius is None else "ball or cylinder misses"
            keys = "lower or upper" if entry.radius is None else "centre or radius"
            messages.append(
                f"regions.{entry.name} contains no cell: its {shape} all centroids of the mesh, which lie in "
                f"{_span(mesh.centroids)}. Correct {keys}, or remove the region."
            )
        elif entry.radius is None:
            inside &= ~round_ones
            if mesh.everywhere.lacks(inside):
                messages.append(
                    f"regions.{entry.name} contains no cell: regions with a radius take all of its box. "
                    "Remove the region, or make them smaller."
                )
        twice = inside & (region >= 0)
        if mesh.everywhere.wrong(twice):
            other = scene.regions[region[np.flatnonzero(twice)[0]]].name
            messages.append(
                f"regions.{entry.name} overlaps regions.{other} in {np.count_nonzero(twice)} cells, the first "
                f"{list_cells(mesh, twice)}. Give each cell to one region."
            )
        region[inside & (region < 0)] = index
    left = region < 0
    if mesh.everywhere.wrong(left) and not unknown:
        messages.append(
            f"regions leave out {np.count_nonzero(left)} of {len(region)} cells, the first {list_cells(mesh, left)}. "
            "Extend a region, or add one."
        )
    if messages:
        raise SceneError(messages)
    return region


def _inside(mesh: HexMesh, entry: Region) -> np.ndarray:
    """Cells whose centroid lies in the region's box and, where it has a radius, in its ball or cylinder."""
    inside = mesh.cells_in_box(entry.lower, entry.upper)
    if entry.radius is not None:
        across = [d for d in range(3) if "xyz"[d] != entry.axis]
        offset = (mesh.centroids - np.array(entry.centre))[:, across]
        inside &= np.sqrt((offset**2).sum(axis=1)) <= entry.radius + mesh.tolerance
    return inside


def _span(points: np.ndarray) -> str:
    low, high = points.min(axis=0), points.max(axis=0)
    return " x ".join(f"[{a:.6g}, {b:.6g}]" for a, b in zip(low, high, strict=True))
