"""`pdfem check`: a scene is made as a run would make it, and told in a table."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from pdfem_mpi.body.counts import too_many_ranks
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import SceneError
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.peridynamics.fit.fit import EXPECTED_SWEEPS, SWEEP_RATE
from pdfem_mpi.results.whole_body import NoPicture
from pdfem_mpi.runs.memory_estimate import show_bytes
from pdfem_mpi.runs.memory_report import features_of
from pdfem_mpi.runs.prepare import count_sizes, describe_mirrors, prepare, warm_up
from pdfem_mpi.runs.sketching import draw_scene
from pdfem_mpi.runs.softening_notes import describe_softening, softening_of, softening_warnings
from pdfem_mpi.runs.understanding import Understood, describe, understand


def check_scene(scene: Scene, comm, ranks: int | None = None, picture: Path | None = None) -> dict[str, str]:
    """What was understood of a scene, and what a run would take, by name. Collective.

    Parameters
    ----------
    ranks : int, optional
        Ranks that a run would have, where it is not those that are here.
    picture : Path, optional
        What was understood is drawn there, as a PNG; why it is not, is in the row ``picture``.

    Raises
    ------
    SceneError
        For all that a run would refuse; also when it would not fit into memory.
    """
    share, need, _ = prepare(scene, comm)
    if ranks and ranks > share.counts.cells:
        raise SceneError([too_many_ranks(ranks, share.counts.cells)])
    warm_up(comm, features_of(scene))
    found = understand(scene, share, comm)
    softening = softening_of(scene, share)
    warnings = [text.removeprefix("warning: ") for text in softening_warnings(scene, softening)]
    drawn = {} if picture is None else {"picture": _drawn(picture, scene, share, found, ranks)}
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
        **_fit_cost(scene, bonds, comm.size),
        **({"cells and points of a rank, about": _shares(share, ranks)} if ranks else {}),
        **dict(describe(scene, share, found)),
        **drawn,
    }


def _drawn(path: Path, scene: Scene, share: Share, found: Understood, ranks: int | None) -> str:
    """Draw the scene; where it is drawn, or why it is not. Collective."""
    try:
        draw_scene(path, scene, share, found.model, found.case, ranks)
    except NoPicture as error:
        return f"not drawn: {error}"
    except OSError as error:
        return f"not drawn: {path} cannot be written ({error.strerror}). Choose another place."
    return str(path)


def _shares(share: Share, ranks: int) -> str:
    """What each of so many ranks would have."""
    return f"{share.counts.cells / ranks:,.0f} and {8 * share.counts.point_cells / ranks:,.0f} on each of {ranks:,}"


def _fit_cost(scene: Scene, bonds: int, ranks: int) -> dict[str, str]:
    """What the fit of bond factors would take."""
    if not bonds or scene.peridynamics.surface_correction != "fitted":
        return {}
    sweeps = EXPECTED_SWEEPS[scene.peridynamics.signs]
    seconds = sweeps * bonds / (SWEEP_RATE * ranks)
    return {"fit of bond factors, about": f"{sweeps} sweeps, {seconds:.2g} s unless it is found from before"}
