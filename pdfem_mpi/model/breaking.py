"""Which bonds of a model may break, and the books of those that do."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.model import Model
from pdfem_mpi.peridynamics.critical_stretches import UNBREAKABLE, critical_stretches, point_classes
from pdfem_mpi.peridynamics.failure import RECORDS, Failure
from pdfem_mpi.peridynamics.softening_failure import SofteningFailure

#: Fitted bonds up to this fraction of the mean edge of the cells with bonds set no load: where strains vary, the
#: distance of the nearest points reads up to a third too much (docs/failure.md).
TOO_NEAR = 0.5


def make_failure(scene: Scene, share: Share, model: Model) -> Failure | None:
    """The scene's critical stretches; None if no bond can break. Collective."""
    if not model.bonds:
        return None
    stretch = critical_stretches(scene, share)
    if not (stretch < UNBREAKABLE).any():
        return None
    cells = model.subdomain.point_cells
    room = max(RECORDS, model.bonds.most_slots)
    fitted = model.body_fit is not None and model.body_fit.fit is not None
    kind, more = (SofteningFailure, {"softened": model.bonds.softened}) if model.bonds.softened else (Failure, {})
    return kind(
        class_of=np.repeat(point_classes(scene, share)[cells].astype(np.uint8), 2),
        stretch=stretch,
        pairs=np.empty((room, 2), np.int64),
        strengths=np.empty((room, 2), np.float32),
        counter=np.zeros(1, np.int64),
        nearest=TOO_NEAR * share.average_edge(share.has_points) / share.units.length if fitted else 0.0,
        **more,
    )
