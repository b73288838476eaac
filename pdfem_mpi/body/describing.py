"""Which description each cell has, where the peridynamic cells are known: bonds, elements, or both in the overlap."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.fitted_bodies import FittedBodies, find_fitted_bodies, same_bonds
from pdfem_mpi.body.materials import MaterialTable
from pdfem_mpi.body.meshing import check_folded
from pdfem_mpi.body.overlap import check_cracks, check_joints, check_overlap_materials, find_overlap
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.mesh.hexmesh import HexMesh
from pdfem_mpi.mesh.quality import Quality
from pdfem_mpi.parallel.comm import report_progress


def describe(
    scene: Scene,
    mesh: HexMesh,
    quality: Quality,
    region: np.ndarray,
    peridynamic: np.ndarray,
    materials: tuple[MaterialTable, np.ndarray],
) -> dict[str, np.ndarray]:
    """What of a `Discretization` depends on which cells are peridynamic, by the names of its attributes.

    Parameters
    ----------
    region : int16, shape (n_cells,)
    peridynamic : bool, shape (n_cells,)
    materials : MaterialTable, and int16, shape (n_cells,)

    Raises
    ------
    SceneError
        Folded cells with bonds, an overlap that does not fit or where two Poisson's ratios meet.
    """
    bodies = _find_bodies(scene, mesh, peridynamic, *materials)
    is_overlap, has_points = bodies.is_overlap, bodies.number >= 0
    report_progress()
    check_folded(mesh, quality, has_points)
    nu = materials[0].poissons_ratio[materials[1]]
    check_overlap_materials(scene, mesh, region, nu, is_overlap, has_points)
    keeps_both = scene.coupling.kind == "paper_a"
    has_stiffness = ~peridynamic & (keeps_both | ~is_overlap)
    carries = np.zeros(len(mesh.nodes), bool)
    carries[mesh.cells[has_stiffness | is_overlap]] = True
    return {
        "is_peridynamic": peridynamic,
        "has_points": has_points,
        "is_overlap": is_overlap,
        "body": bodies.number,
        "thin": bodies.thin,
        "has_stiffness": has_stiffness,
        "carries": carries,
    }


def _find_bodies(
    scene: Scene, mesh: HexMesh, peridynamic: np.ndarray, materials: MaterialTable, material: np.ndarray
) -> FittedBodies:
    """Bodies between which there are no bonds: several where factors are fitted, else one.

    Parameters
    ----------
    peridynamic : bool, shape (n_cells,)
    material : int16, shape (n_cells,)

    Raises
    ------
    SceneError
        An overlap that does not fit, or joints of fitted bodies that bonds would be needed for.
    """
    thin = np.empty(0, np.int64)
    if scene.peridynamics.surface_correction == "fitted" and peridynamic.any():
        kind = same_bonds(materials)[material]
        is_overlap = find_overlap(scene, mesh, peridynamic, ~np.isin(kind, kind[peridynamic]))
        found = find_fitted_bodies(mesh, peridynamic, is_overlap, kind)
        if not len(found.thin):
            check_joints(scene, materials, material, found.number)
            check_cracks(scene, mesh, peridynamic & found.is_overlap)
            return found
        thin = found.thin
    is_overlap = find_overlap(scene, mesh, peridynamic)
    return FittedBodies(np.where(peridynamic | is_overlap, 0, -1).astype(np.int32), is_overlap, thin)
