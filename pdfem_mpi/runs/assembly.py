"""What a simulation is made of, made from its scene and its share of the body: once, or again where bonds are added."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.measure.probed import ProbeReader
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import make_load_case
from pdfem_mpi.model.model import build_model
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.peridynamics.weighted_failure import WeightedFailure
from pdfem_mpi.runs.read_columns import make_gauges
from pdfem_mpi.runs.readings import Readings
from pdfem_mpi.runs.region_watch import RegionWatch
from pdfem_mpi.solvers.equilibrium import EquilibriumSolver, make_solver
from pdfem_mpi.solvers.preconditioner.cycle import Cycle
from pdfem_mpi.solvers.preconditioner.preconditioner import make_preconditioner
from pdfem_mpi.system.heap import give_back

Note = Callable[[str], None]


def ignore(*words: Any) -> None:
    """Do nothing with what is reported."""


class Assembly(Readings):
    """The part of `Simulation` that makes what it holds. All methods are collective.

    Attributes
    ----------
    caches : paths
        Folders of fitted factors.
    known : dict
        What forces go on from: evaluations, and the time and kernels that they took.
    words : (callable, stop requests)
        Who hears remarks of the solver, and who says when to stop.
    observers : list
        Of switches: their ``let_go(comes_back)`` is called before one, and ``take(simulation, came_back)`` after it.
    most_needed : float
        Bytes that this rank was estimated to need on the way, beside those of the body as it is.
    kept_cycle : Cycle or None
        The preconditioner's, of the intact body, which a switch does not change.
    """

    caches: Sequence[Path]
    known: dict[str, Any]
    words: tuple[Note, Any]
    observers: list[Any]
    kept_cycle: Cycle | None = None
    most_needed: float = 0.0

    def build(self, share: Share, again: bool = False) -> None:
        """Make the equations of a share of the body, where bonds are elsewhere ``again``. Collective."""
        without = ("own_energy",) if again else ()  # it is told of the first body
        self.model = build_model(self.scene, share, self.comm, self.caches, without)
        # the whole body goes here, and the surface that only bonds of a region to be found are still compared with
        self.share = replace(share, boundaries=None, surface=share.surface if share.found else np.empty((0, 4, 3)))
        self.case = make_load_case(self.scene, self.share, self.model)

    def assemble(self) -> None:
        """Make what works on the equations, for the state as it is. Collective."""
        scene, share, model = self.scene, self.share, self.model
        self.forces = Forces(model, self.state.bounds, **self.known)
        self.failure = make_failure(scene, share, model)
        self.gauges = make_gauges(scene, share, model)
        self.probe_reader = ProbeReader(scene, share, model)
        self.region_watch = RegionWatch.of(self) if share.found else None
        self.solver: EquilibriumSolver | None = None
        self._evaluated = False

    def let_go(self, comes_back: bool = False) -> None:
        """Let go of all that hangs on where bonds are, before it is made anew.

        Parameters
        ----------
        comes_back : bool
            With bonds where they are now: what was read off the body holds.
        """
        for observer in self.observers:
            observer.let_go(comes_back)
        forces = self.forces
        self.kept_cycle = self.solver.preconditioner.cycle if self.solver else None
        self.known = {"evaluations": forces.evaluations, "swept": forces.swept, "seconds": forces.seconds}
        self.model = self.case = self.forces = self.failure = self.solver = None
        self.gauges = self.probe_reader = self.region_watch = None
        del forces  # else the model stays until the pages were given back
        give_back()  # what the solver's loops took

    def weigh_stretches(self, setting: np.ndarray, breaking: np.ndarray) -> None:
        """Count stretches by weights of single bonds: for studies of criteria, which the program's own are not.

        For brittle bonds on one rank, in linear kinematics and regions that are drawn, with ``stepping.kind = "steps"``
        or ``"events"``; before the first bond breaks.

        Parameters
        ----------
        setting, breaking : float64, shape (n_bonds,), dimension 1
            What the stretches of the bonds of `bonds` are multiplied by before they are compared with the critical
            one: to find the load of the next break, and to break. A load is found by the first, and all bonds break
            there that do by the second.

        Raises
        ------
        ValueError
        """
        bonds, failure = self.bonds(), self.failure
        brittle = type(failure) is Failure and not failure.count
        if not brittle or self.model.finite or self.comm.size > 1 or self.scene.is_adaptive:
            raise ValueError(
                "weights are for brittle bonds that may break and are whole, in linear kinematics, on one rank, in "
                "regions that are drawn"
            )
        if self.scene.stepping.kind == "ramp":
            raise ValueError('weights are for stepping.kind = "steps" or "events": ramps break bonds in their sweep')
        if not np.shape(setting) == np.shape(breaking) == (len(bonds.points),):
            raise ValueError(f"there are {len(bonds.points):,} bonds: give as many weights of both kinds")
        self.failure = WeightedFailure.of(failure, self.model.points, bonds.points, setting, breaking)

    def prepare_solver(self, note: Note | None = None, stop_requests: Any = None) -> EquilibriumSolver:
        """Set up the scene's solver for the loads as they are; ``note`` is called with remarks for the user."""
        self.words = note or self.words[0], stop_requests or self.words[1]
        if self.kept_cycle is None:
            solver = make_solver(self.scene, self.share, self.forces, self.case, *self.words)
        else:
            kept = make_preconditioner(self.share, self.model, self.case, self.forces.bounds, self.kept_cycle)
            solver = EquilibriumSolver(self.forces, self.case, self.scene.solver, kept, *self.words)
        if self.region_watch:
            solver = replace(solver, look_at_region=self.region_watch.look)
        self.solver, self.kept_cycle = solver, None  # of other supports it would not be the same
        return solver
