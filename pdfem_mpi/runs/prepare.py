"""What comes before the large arrays: memory, kernels, sizes for ``pdfem check``."""

from __future__ import annotations

import math
import os
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from pdfem_mpi.body.meshing import make_mesh
from pdfem_mpi.body.share import Share, share_of
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.model.model import Model
from pdfem_mpi.parallel.comm import agree, broadcast, largest, node_communicator, sum_integers
from pdfem_mpi.peridynamics.bonds import total_bonds
from pdfem_mpi.peridynamics.fit.fit import EXPECTED_SWEEPS, SWEEP_RATE
from pdfem_mpi.runs.compilation import compile_kernels
from pdfem_mpi.runs.memory_estimate import Need, check_mesh, check_model, show_bytes
from pdfem_mpi.runs.softening_notes import describe_softening, softening_of, softening_warnings


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


def prepare(scene: Scene, comm) -> tuple[Share, Need]:
    """This rank's share of a scene that fits into memory, and what it will need. Collective.

    Raises
    ------
    SceneError
        On all ranks.
    """
    share = cut_share(scene, comm)
    softening_of(scene, share)  # refuses strengths and energies that do not go with the internal length
    return share, check_model(scene, share, comm)


def cut_share(scene: Scene, comm) -> Share:
    """This rank's share of a scene whose mesh fits into memory; a mesh file is read by rank 0. Collective.

    Raises
    ------
    SceneError
        On all ranks.
    """
    mesh = None
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
        check_mesh(scene, math.prod(scene.mesh.n_cells), comm)
    return share_of(scene, comm, mesh)


def cut_again(scene: Scene, before: Share) -> Share:
    """The same share for a scene with other loads and supports. Collective.

    Raises
    ------
    SceneError
        On all ranks; also for a mesh file that has changed.
    """
    share = cut_share(scene, before.comm)
    if share.mesh_sha256 != before.mesh_sha256:
        raise SceneError([f"mesh.path = {scene.mesh.path} has changed since. Make a new simulation."])
    return replace(share, boundaries=None)


def check_scene(scene: Scene, comm) -> dict[str, str]:
    """What a run of the scene would allocate, by name; nothing large is allocated. Collective.

    Raises
    ------
    SceneError
        Also when it would not fit into memory.
    """
    share, need = prepare(scene, comm)
    softening = softening_of(scene, share)
    warnings = [text.removeprefix("warning: ") for text in softening_warnings(scene, softening)]
    sizes, quality = count_sizes(share, None), share.quality
    bonds, total = sum_integers(comm, np.array([int(need.bonds), int(need.bytes)]))
    return {
        **({"mirror planes": describe_mirrors(scene)} if share.mirrors else {}),
        "cells": f"{share.counts.cells}",
        **({"of the mesh file": "; ".join(share.notes)} if share.notes else {}),
        "nodes": f"{sizes['nodes']}",
        "edges of cells": f"{quality.shortest_edge:.4g} to {quality.longest_edge:.4g}",
        "smallest scaled Jacobian": f"{quality.smallest_scaled_jacobian:.4g}",
        "smallest Gauss volume": f"{quality.smallest_gauss_volume:.4g}",
        "elements": f"{sizes['elements']}",
        "points": f"{sizes['points']}",
        "undirected bonds, about": f"{bonds:.3g}",
        **dict(describe_softening(scene, softening)),
        **({"of bonds that soften": "; ".join(warnings)} if warnings else {}),
        "memory, about": f"{show_bytes(total)} in all, of the largest rank "
        f"{show_bytes(float(largest(comm, np.array([need.bytes]))[0]))}",
    } | _fit_cost(scene, bonds, comm.size)


def _fit_cost(scene: Scene, bonds: int, ranks: int) -> dict[str, str]:
    """What the fit of bond factors would take."""
    if not bonds or scene.peridynamics.surface_correction != "fitted":
        return {}
    sweeps = EXPECTED_SWEEPS[scene.peridynamics.signs]
    seconds = sweeps * bonds / (SWEEP_RATE * ranks)
    return {"fit of bond factors, about": f"{sweeps} sweeps, {seconds:.2g} s unless it is found from before"}


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
