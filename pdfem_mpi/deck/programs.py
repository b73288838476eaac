"""How the load grows and what finds equilibrium: deck tables ``[stepping]`` and ``[solver]``."""

from __future__ import annotations

import itertools
from collections.abc import Sequence
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from pdfem_mpi.deck.amplitudes import amplitude_problems, between
from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.materials import Interface, Material, all_materials
from pdfem_mpi.deck.regions import Region, has_model
from pdfem_mpi.deck.table import Problem, Table, key, show


class Solver(Table):
    """How equilibrium is found (sec. 3.3); deck table ``[solver]``.

    Attributes
    ----------
    kind : "adr" or "cg"
        Adaptive dynamic relaxation, eqs (31)-(35), as in the paper; or preconditioned conjugate gradients.
    tolerance : float, above 0 and below 1, dimension 1
        Residual relative to the external force, or to the reactions where there is none.
    max_evaluations : int, >= 1
        Force evaluations of one load step before the run ends as not converged.
    """

    kind: Literal["adr", "cg"] = key("adr")
    tolerance: float = key(1.0e-6, gt=0, lt=1, dimension="1")
    max_evaluations: int = key(200_000, ge=1)


class Steps(Table):
    """Equilibrium at given load factors; deck table ``[stepping]`` with ``kind = "steps"``, which may be left out.

    Where bonds can break, those beyond their critical stretch break at each load until none is.

    Attributes
    ----------
    load_factors : floats, dimension 1
        Equilibrium is found at each; strictly rising from 0 (or strictly falling from 0) unless there are times.
    times : floats or None, dimension 1
        A pseudo-time for each load factor, strictly rising from 0: factors may then rise, fall and change their sign.
    increments : int or None, >= 1
        Equilibria on the straight line from one time to the next; None (default): one.
    """

    kind: Literal["steps"] = key("steps")
    load_factors: tuple[float, ...] = key((1.0,), min_length=1, dimension="1")
    times: tuple[float, ...] | None = key(None, min_length=1, dimension="1")
    increments: int | None = key(None, ge=1)

    @property
    def schedule(self) -> list[tuple[float | None, float]]:
        """Time and load factor of each equilibrium."""
        if self.times is None:
            return [(None, factor) for factor in self.load_factors]
        return list(between(self.times, self.load_factors, self.increments or 1))

    def problems(self) -> list[Problem]:
        """Load factors strictly monotone from 0, or times that rise."""
        if self.times is not None:
            return amplitude_problems(self.times, self.load_factors)
        if self.increments is not None:
            text = f"= {self.increments} divides the time from one load factor to the next, and there are no times."
            return [Problem("increments", f"{text} Give times.")]
        factors = (0.0, *self.load_factors)
        sign = 1.0 if factors[1] > 0.0 else -1.0
        for before, after in itertools.pairwise(factors):
            if not sign * after > sign * before:
                word = "different from" if before == 0.0 else "above" if sign > 0 else "below"
                return [
                    Problem(
                        "load_factors",
                        f"= {show(self.load_factors)} has {show(after)} after {show(before)}, but must "
                        f"strictly rise (or fall) from 0. Use a number {word} {show(before)}, or give times for a load "
                        "that comes and goes.",
                    )
                ]
        return []

    @property
    def n_steps(self) -> int | None:
        """How many rows there will be."""
        return len(self.schedule)


class Ramp(Table):
    """The paper's load program (sec. 4.2): the load rises at each relaxation iteration; ``kind = "ramp"``.

    Attributes
    ----------
    increment : float, > 0, dimension 1
        Of the load factor, an iteration.
    end_load_factor : float, > 0, dimension 1
        The run ends here,
    end_reaction : float, 0 to below 1, dimension 1
        or when the reaction has fallen below this fraction of its peak.
    report_every : int, >= 1
        Iterations between two rows of the history, which are frames of the fields as well.
    """

    kind: Literal["ramp"]
    increment: float = key(gt=0, dimension="1", remedy="Give the rise of the load factor an iteration, e.g. 1.0e-6.")
    end_load_factor: float = key(1.0, gt=0, dimension="1")
    end_reaction: float = key(0.05, ge=0, lt=1, dimension="1")
    report_every: int = key(1000, ge=1)

    def problems(self) -> list[Problem]:
        """A ramp of at least one iteration."""
        if self.increment <= self.end_load_factor:
            return []
        return [
            Problem(
                "increment",
                f"= {show(self.increment)} is above end_load_factor = {show(self.end_load_factor)}: a ramp without an "
                "iteration. Use a smaller increment.",
            )
        ]

    @property
    def n_steps(self) -> int | None:
        """How many rows there will be is not known beforehand."""
        return None


class Events(Table):
    """From break to break at exact loads; ``kind = "events"``.

    Attributes
    ----------
    eta : float, 1e-6 to below 0.5, dimension 1
        Bonds within this fraction of their critical stretch break together with the first.
    inner_iterations : int, >= 1
        Sweeps of relaxation between two batches of breaks in an avalanche, fewer where the residual gets to 1e-4.
    arrest_tolerance : float, above 0 and below 1, dimension 1
        Relative residual above which no state counts as stable; one below it does when a tenfold smaller residual
        moves neither the load of the next break nor a bond to its limit (`stepping.arrest`).
    end_load_factor : float or None, > 0, dimension 1
        The run ends here; None (default): no such limit.
    end_reaction : float, above 0 and below 1, dimension 1
        The run ends when the reaction at held load has fallen below this fraction of the peak.
    control : "load" or "energy"
        "load": broken bonds unload the body at a held load, until none is left to break. "energy": after each batch
        the load is scaled so that the next bond is about to break, which follows snap-backs.
    report_every : int, >= 1
        Batches between two rows of the history within an avalanche.
    """

    kind: Literal["events"]
    eta: float = key(1.0e-3, ge=1e-6, lt=0.5, dimension="1")
    inner_iterations: int = key(8, ge=1)
    arrest_tolerance: float = key(1.0e-3, gt=0, lt=1, dimension="1")
    end_load_factor: float | None = key(None, gt=0, dimension="1")
    end_reaction: float = key(0.05, gt=0, lt=1, dimension="1")
    control: Literal["load", "energy"] = key("load")
    report_every: int = key(10, ge=1)

    @property
    def n_steps(self) -> int | None:
        """How many rows there will be is not known beforehand."""
        return None


def _steps_by_default(value: Any) -> Any:
    return {"kind": "steps", **value} if isinstance(value, dict) else value


Stepping = Annotated[Steps | Ramp | Events, Field(discriminator="kind"), BeforeValidator(_steps_by_default)]


def check_failure(
    material: Material,
    materials: dict[str, Material],
    interfaces: Sequence[Interface],
    regions: Sequence[Region],
    stepping: Any,
) -> list[Problem]:
    """Failure needs bonds that may break, and a program that breaks them needs failure."""
    tables = all_materials(material, materials)
    if not has_model(regions, "peridynamics"):
        problems = [
            Problem(
                f"{where}.{'fracture_energy' if table.critical_stretch is None else 'critical_stretch'}",
                "breaks bonds, and no region has any. Remove it, or describe a region by peridynamics.",
            )
            for where, table in tables.values()
            if table.can_fail
        ]
        return problems or _needs_failure(stepping, "finite elements do not break. Describe a region by peridynamics.")
    bonded = [region for region in regions if region.model == "peridynamics"]
    breakable = any(tables[region.material][1].can_fail for region in bonded if region.material in tables)
    if not breakable and not any(interface.can_fail for interface in interfaces):
        return _needs_failure(
            stepping, "nothing says when bonds break. Give material.critical_stretch or material.fracture_energy."
        )
    if all(region.may_fail is False for region in bonded):
        return [
            Problem("regions", "with peridynamics all have may_fail = false: no bond can break. Let one of them fail.")
        ]
    return []


def _needs_failure(stepping: Any, reason: str) -> list[Problem]:
    if stepping.kind == "steps":
        return []
    return [Problem("stepping.kind", f"= {show(stepping.kind)} follows failure, and {reason}")]


def check_stepping_solver(stepping: Any, solver: Solver) -> list[Problem]:
    needed = {"ramp": "adr", "events": "cg"}.get(stepping.kind, solver.kind)
    if solver.kind == needed:
        return []
    return [
        Problem(
            "solver.kind",
            f"= {show(solver.kind)} does not go with stepping.kind = {show(stepping.kind)}, which "
            + ("is relaxation" if needed == "adr" else "needs a solver for equilibrium")
            + f'. Use "{needed}".',
        )
    ]


def check_something_loads(stepping: Any, loads: Sequence[Any], supports: Sequence[Support]) -> list[Problem]:
    """Failure needs a load: a force, or a support that moves."""
    amounts = [
        component
        for load in loads
        for vector in (getattr(load, "total", None), getattr(load, "density", None), getattr(load, "traction", None))
        for component in vector or ()
    ] + [component for support in supports for component in (support.x, support.y, support.z)]
    if stepping.kind == "steps" or any(amounts):
        return []
    return [
        Problem(
            "stepping.kind",
            f"= {show(stepping.kind)} raises the load until bonds break, and nothing loads the body. "
            "Add a table [[loads]], or a support that moves.",
        )
    ]
