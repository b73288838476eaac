"""What comes before the large arrays: memory, kernels, sizes for ``pdfem check``."""

from __future__ import annotations

import math
import os
from collections.abc import Collection
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

import numpy as np

from pdfem_mpi.body.cutting import cells_seen, share_of
from pdfem_mpi.body.found_region import Turning
from pdfem_mpi.body.meshing import make_mesh
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import agree, broadcast, node_communicator, sum_integers
from pdfem_mpi.peridynamics.bonds import total_bonds
from pdfem_mpi.runs.compilation import compile_kernels
from pdfem_mpi.runs.first_region import first_turning
from pdfem_mpi.runs.memory_estimate import Need, check_mesh, check_model
from pdfem_mpi.runs.softening_notes import softening_of
from pdfem_mpi.solvers.preconditioner.cycle import Cycle


def warm_up(comm, features: Collection[str] | None = None) -> None:
    """Compile the kernels that a scene with these features calls, or all of them: each rank of a node compiles a share,
    and finds those of the others. Collective.
    """
    node = node_communicator(comm)
    if node.size > 1:
        compile_kernels(features, node.rank, node.size)
        node.Barrier()
    compile_kernels(features)
    node.Free()


def fit_folders(out: Path) -> tuple[Path, ...]:
    """Where fits of bond factors are kept: the run folder, and the user's cache beside the compiled kernels."""
    cache = os.environ.get("NUMBA_CACHE_DIR")
    return (out, Path(cache)) if cache else (out,)


class Prepared(NamedTuple):
    """A rank's share of a body that fits into memory, what it will need, and what a first region of bonds left."""

    share: Share
    need: Need
    cycle: Cycle | None = None


def prepare(scene: Scene, comm, turned: np.ndarray | None = None) -> Prepared:
    """This rank's share of a scene that fits into memory, and what it will need. Collective.

    Parameters
    ----------
    turned : int64, optional
        Cells that a run has turned into bonds already; where it finds them by itself, the first are found here.

    Raises
    ------
    SceneError
        On all ranks.
    """
    share = cut_share(scene, comm, None if turned is None else Turning(turned, np.empty(0, np.int64)))
    cycle = None
    if scene.is_adaptive and turned is None:
        turning, cycle = first_turning(scene, share)
        share = cut_share(scene, comm, turning, share)
    softening_of(scene, share)  # refuses strengths and energies that do not go with the internal length
    return Prepared(share, check_model(scene, share, comm), cycle)


def cut_share(scene: Scene, comm, turning: Turning | None = None, before: Share | None = None) -> Share:
    """This rank's share of a scene whose mesh fits into memory; a mesh file is read by rank 0. Collective.

    Parameters
    ----------
    turning : Turning, optional
        Which cells are bonds, where the run finds them.
    before : Share, optional
        Of the same scene, with bonds elsewhere.

    Raises
    ------
    SceneError
        On all ranks.
    """
    if before and before.found.before:
        return share_of(scene, comm, None, turning, before=before)
    mesh = before_whole = None
    if isinstance(scene.mesh, FileMesh):
        messages = []
        if comm.rank == 0:
            try:
                mesh = make_mesh(scene)
            except SceneError as error:
                messages = error.messages
        if messages := agree(comm, messages):
            raise SceneError(messages)
        check_mesh(scene, broadcast(comm, len(mesh.cells) if mesh else 0), comm)
        mesh = broadcast(comm, mesh)
    else:
        check_mesh(scene, n_cells := math.prod(scene.mesh.n_cells), comm, cells_seen(scene, comm))
        before_whole = partial(check_mesh, scene, n_cells, comm)
    return share_of(scene, comm, mesh, turning, before_whole)


def cut_again(scene: Scene, before: Share) -> Share:
    """The same share for a scene with other loads and supports. Collective.

    Raises
    ------
    SceneError
        On all ranks; also for a mesh file that has changed.
    """
    turning = Turning(before.found.turned, np.empty(0, np.int64)) if before.found else None
    share = cut_share(scene, before.comm, turning)
    if share.mesh_sha256 != before.mesh_sha256:
        raise SceneError([f"mesh.path = {scene.mesh.path} has changed since. Make a new simulation."])
    return replace(share, boundaries=None)


def count_sizes(share: Share, model: Model | None) -> dict[str, int]:
    """Sizes of the whole body. Collective when there is a model."""
    sizes = {
        "nodes": share.counts.nodes,
        "elements": share.counts.elements,
        "points": 8 * share.counts.point_cells,
        "overlap_cells": share.counts.overlap_cells,
    }
    if model is not None:
        sizes["undirected_bonds"] = total_bonds(model.comm, model.bonds)
        sizes["unknowns"] = int(sum_integers(model.comm, np.array([model.n_unknowns]))[0])
    return sizes


def describe_mirrors(scene: Scene) -> str:
    """The planes, and what part of the body they leave."""
    faces = scene.mesh.symmetry
    endless = [axis for axis in "xyz" if {f"{axis}-", f"{axis}+"} <= set(faces)]
    if endless:
        return f"{', '.join(faces)}: a cell of a body without end along {' and '.join(endless)}"
    return f"{', '.join(faces)}: {('half', 'a quarter', 'an eighth')[len(faces) - 1]} of the body is modelled"
