"""What `pdfem check --picture` draws, collected on rank 0."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pdfem_mpi.body.owners import owners_of_cells
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.measure.geometry import gather_geometry
from pdfem_mpi.model.loads import LoadCase
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.parts import positions
from pdfem_mpi.results.sketch import Sketch, draw_sketch


def draw_scene(path: Path, scene: Scene, share: Share, model: Model, case: LoadCase, ranks: int | None) -> None:
    """Draw a scene that was made ready; only rank 0 draws. Collective.

    Raises
    ------
    NoPicture
        On rank 0 alone: nothing to draw with.
    """
    x = positions(model) * model.units.length + model.units.origin
    on_planes = np.zeros(model.n_unknowns, bool)
    on_planes[model.rollers] = True
    held = {"supports": case.fixed & ~on_planes, "springs": np.zeros_like(on_planes), "ties": np.zeros_like(on_planes)}
    for name, restraint in (("springs", model.springs), ("ties", model.ties)):
        if restraint:
            held[name][restraint.index] = True
    marks = {name: _gathered(share, x[model.unknowns.rows(chosen).any(axis=1)]) for name, chosen in held.items()}
    forces = model.unknowns.rows(case.forces(1.0))
    loaded = forces.any(axis=1)
    places, forces = _gathered(share, x[loaded]), _gathered(share, forces[loaded])
    geometry = gather_geometry(share)
    if geometry is None:
        return
    mesh = geometry.mesh
    draw_sketch(
        path,
        Sketch(
            corners=mesh.nodes[mesh.cells],
            region=geometry.region.astype(np.int64),
            names=tuple(f"{region.name} ({region.model.replace('_', ' ')})" for region in scene.regions),
            marks=marks,
            places=places,
            forces=forces,
            cracks=tuple(np.array(crack.corners(mesh.lower, mesh.upper)) for crack in scene.cracks),
            rank=owners_of_cells(scene, ranks, share.found and share.found.turned) if ranks else None,
        ),
        scene.title,
    )


def _gathered(share: Share, rows: np.ndarray) -> np.ndarray:
    """Rows of three numbers of all ranks; on rank 0 alone. Collective."""
    found = share.comm.gather(rows)
    return np.concatenate(found) if found is not None else np.empty((0, 3))
