"""State: the unknowns of a run on one rank, declared in one table."""

from __future__ import annotations

from dataclasses import dataclass, field
from time import perf_counter
from typing import NamedTuple

import numpy as np

from pdfem_mpi.model.bounds import Bounds
from pdfem_mpi.model.model import Model


class Field(NamedTuple):
    """A field over the unknowns: its name, dimension, what it is, and whether it is there from the beginning.

    Others appear, as zeros, when a solver first asks for them.
    """

    name: str
    dimension: str
    meaning: str
    always: bool


#: Every field that a run must keep to go on as if nothing had happened.
FIELDS = (
    Field("u", "length", "displacement", True),
    Field("v", "length", "velocity at the half step (time step 1), of relaxation", False),
    Field("previous_force", "force", "residual force of the evaluation before, of relaxation", False),
)


@dataclass
class State:
    """Unknowns of one rank, in model units: an array of shape (n_unknowns,) for each row of `FIELDS` in use.

    Attributes
    ----------
    fields : dict of float64 arrays
        In the order of `FIELDS`; the same on all ranks.
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

    @property
    def v(self) -> np.ndarray:
        """Velocity of the unknowns."""
        return self.add("v")

    @property
    def previous_force(self) -> np.ndarray:
        """Residual force on the unknowns at the evaluation before."""
        return self.add("previous_force")

    def add(self, name: str) -> np.ndarray:
        """The field of this name: zeros if nobody asked for it before."""
        if name not in self.fields:
            self.fields[name] = np.zeros_like(self.u)
            self.fields = {entry.name: self.fields[entry.name] for entry in FIELDS if entry.name in self.fields}
        return self.fields[name]


def new_state(model: Model) -> State:
    """A body at rest."""
    return State({entry.name: np.zeros(model.n_unknowns) for entry in FIELDS if entry.always})
