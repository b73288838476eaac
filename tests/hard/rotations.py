"""Hard cases that no deck can describe: what they check on the model of a deck, as numbers in a summary.json."""

from __future__ import annotations

import json
import math
from pathlib import Path

import numpy as np

from pdfem_mpi.body.cutting import share_of
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.measure.fields import fields_sha256, gather_fields
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.model import build_model
from pdfem_mpi.model.state import new_state
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.clusters import point_rows

#: The strain whose force a rotation's is compared with.
STRAIN = 1e-2


def rotation(scene: Scene, comm, degrees: float) -> dict[str, float]:
    """Rotate a body, elements included, about z and look at its forces and its bonds. Collective.

    Returns
    -------
    dict of float
        ``force``, relative to that of a strain of 1e-2, and ``broken`` bonds.
    """
    share = share_of(scene, comm)
    model = build_model(scene, share, comm)
    state = new_state(model)
    forces, failure = Forces(model, state.bounds), make_failure(scene, share, model)
    x = point_rows(model.unknowns.of_points(model.points.x))
    if model.nodes:
        x = np.concatenate([x, model.nodes.x[: model.nodes.n_owned]])
    c, s = round(math.cos(math.radians(degrees)), 15), round(math.sin(math.radians(degrees)), 15)
    c, s = c / math.hypot(c, s), s / math.hypot(c, s)
    turned = np.stack([c * x[:, 0] - s * x[:, 1], s * x[:, 0] + c * x[:, 1], x[:, 2]], axis=1) - x
    strained = np.stack([STRAIN * x[:, 0], 0.0 * x[:, 1], 0.0 * x[:, 2]], axis=1)
    nothing, force = np.zeros(model.n_unknowns), np.empty(model.n_unknowns)

    def size(u, breaking=None):
        forces.evaluate_surely(np.ascontiguousarray(u), nothing, force, breaking)
        return math.sqrt(exact_dots(comm, [(force, force)])[0])

    of_strain = size(model.unknowns.join(strained))
    state.u[:] = model.unknowns.join(turned)
    size(state.u)  # bounds that suit the rotation
    found = size(state.u, failure)
    broken = failure.close(model.comm)
    fields = gather_fields(share, forces, state.u)
    return {
        "force": found / of_strain,
        "broken": float(broken),
        "evaluations": forces.evaluations,
        "fields_sha256": fields_sha256(fields) if fields else "",
    }


CHECKS = {
    "rotation_10": lambda scene, comm: rotation(scene, comm, 10.0),
    "rotation_90": lambda scene, comm: rotation(scene, comm, 90.0),
}


def run_check(program: str, scene: Scene, comm, folder: Path) -> None:
    """Run a check and write its summary.json on rank 0. Collective."""
    found = CHECKS[program](scene, comm)
    if comm.rank == 0:
        folder.mkdir(parents=True, exist_ok=True)
        found["solve"] = {"evaluations": found.pop("evaluations")}
        (folder / "summary.json").write_text(json.dumps(found), encoding="utf-8")
