"""State: the unknowns of a run on one rank, declared in one table."""

from __future__ import annotations

from dataclasses import dataclass, field
from time import perf_counter
from typing import NamedTuple

import numpy as np

from pdfem_mpi.forces import Bounds
from pdfem_mpi.model import Model


class Field(NamedTuple):
    """A field over the unknowns: its name, dimension, and what it is."""

    name: str
    dimension: str
    meaning: str


#: Every field that a run must keep to go on as if nothing had happened.
FIELDS = (
    Field("u", "length", "displacement"),
    Field("v", "length", "velocity at the half step (time step 1)"),
    Field("previous_force", "force", "residual force of the evaluation before"),
)


@dataclass
class State:
    """Unknowns of one rank, in model units: an array of shape (n_unknowns,) for each row of `FIELDS`.

    Attributes
    ----------
    fields : dict of float64 arrays
    bounds : Bounds
        What the quanta of the sums rest on.
    step : int
        Load steps completed.
    load_factor : float
    iteration : int
        Relaxation iterations since the load last changed, or of the ramp.
    spent : int
        Force evaluations of the solve under way.
    program : dict of numbers
        What the load program needs to go on; equal on all ranks.
    began : float
        Time of ``perf_counter`` at the last row of the history, less the seconds of earlier starts of the run.
    """

    fields: dict[str, np.ndarray]
    bounds: Bounds = field(default_factory=Bounds)
    step: int = 0
    load_factor: float = 0.0
    iteration: int = 0
    spent: int = 0
    program: dict[str, float] = field(default_factory=dict)
    began: float = field(default_factory=perf_counter)

    @property
    def u(self) -> np.ndarray:
        """Displacement of the unknowns."""
        return self.fields["u"]


def new_state(model: Model) -> State:
    """A body at rest."""
    return State({entry.name: np.zeros(model.n_unknowns) for entry in FIELDS})
