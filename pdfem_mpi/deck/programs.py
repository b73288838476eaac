"""How the load grows and what finds equilibrium: deck tables ``[stepping]`` and ``[solver]``."""

from __future__ import annotations

import itertools
from typing import Annotated, Any, Literal

from pydantic import BeforeValidator, Field

from pdfem_mpi.deck.amplitudes import amplitude_problems, between, through_nothing
from pdfem_mpi.deck.table import Problem, Table, key, show


class Solver(Table):
    """How equilibrium is found (sec. 3.3); deck table ``[solver]``.

    Attributes
    ----------
    kind : "cg" or "adr"
        Preconditioned conjugate gradients (default), in about twenty evaluations; or adaptive dynamic relaxation, eqs
        (31)-(35), as in the paper. With ``stepping.kind = "ramp"``, which is relaxation, the default is "adr".
    tolerance : float, above 0 and below 1, dimension 1
        Residual relative to the external force, or to the reactions where there is none.
    max_evaluations : int, >= 1
        Force evaluations of one load step before the run ends as not converged.
    """

    kind: Literal["adr", "cg"] = key("cg")
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
    tooth_ratio : float or None, above 1 to 2, dimension 1
        Ratio of two stretches at which a bond that softens loses stiffness, one to the next. None (default): 1.25.
    """

    kind: Literal["steps"] = key("steps")
    load_factors: tuple[float, ...] = key((1.0,), min_length=1, dimension="1")
    times: tuple[float, ...] | None = key(None, min_length=1, dimension="1")
    increments: int | None = key(None, ge=1)
    tooth_ratio: float | None = key(None, gt=1, le=2, dimension="1")

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
        Rise of the load factor at each iteration.
    end_load_factor : float, > 0, dimension 1
        The run ends at this load factor.
    end_reaction : float, 0 to below 1, dimension 1
        The run ends when the reaction has fallen below this fraction of its peak.
    report_every : int, >= 1
        Iterations between two rows of the history, which are frames of the fields as well.
    tooth_ratio : float or None, above 1 to 2, dimension 1
        Ratio of two stretches at which a bond that softens loses stiffness, one to the next. None (default): 1.25.
    """

    kind: Literal["ramp"]
    increment: float = key(gt=0, dimension="1", remedy="Give the rise of the load factor an iteration, e.g. 1.0e-6.")
    end_load_factor: float = key(1.0, gt=0, dimension="1")
    end_reaction: float = key(0.05, ge=0, lt=1, dimension="1")
    report_every: int = key(1000, ge=1)
    tooth_ratio: float | None = key(None, gt=1, le=2, dimension="1")

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
        Bonds within this fraction of their critical stretch break together with the first. 1e-2 by default where bonds
        soften.
    inner_iterations : int, >= 1
        Sweeps of relaxation between two batches of breaks in an avalanche, fewer where the residual gets to 1e-4. Where
        bonds soften, 4 by default, and fewer where the residual falls to 0.3 of what it is.
    arrest_tolerance : float, above 0 and below 1, dimension 1
        Relative residual above which no state counts as stable; one below it does when a tenfold smaller residual
        moves neither the load of the next break nor a bond to its limit (`stepping.arrest`).
    end_load_factor : float or None, > 0, dimension 1
        The run ends here; None (default): no such limit.
    end_reaction : float, above 0 and below 1, dimension 1
        The run ends when the reaction at held load has fallen below this fraction of the peak.
    end_opening : float or None, > 0, dimension length
        Under opening control, the run ends at this opening; None (default): no such limit.
    control : "load", "energy" or "opening"
        "load": broken bonds unload the body at a held load, until none is left to break. "energy": after each batch
        the load is scaled so that the next bond is about to break, which follows snap-backs. "opening": after each
        batch the load is scaled so that the next bond is about to break, or so that the opening is the largest so far
        where it would be less: the opening never shrinks, as in a laboratory that controls it.
    opening : str or None
        Under opening control, the name of a probe of kind "opening".
    report_every : int, >= 1
        Batches between two rows of the history within an avalanche. Where bonds soften, the arrest of an avalanche of
        fewer has no row.
    tooth_ratio : float or None, above 1 to 2, dimension 1
        Ratio of two stretches at which a bond that softens loses stiffness, one to the next. None (default): 1.25.
    times, load_factors : floats or None, dimension 1
        A way of the load over a pseudo-time, straight from (0, 0) through these: up, down and to the other side. The
        run ends at the last; None (default): the load rises as long as it takes.
    """

    kind: Literal["events"]
    eta: float = key(1.0e-3, ge=1e-6, lt=0.5, dimension="1")
    inner_iterations: int = key(8, ge=1)
    arrest_tolerance: float = key(1.0e-3, gt=0, lt=1, dimension="1")
    end_load_factor: float | None = key(None, gt=0, dimension="1")
    end_reaction: float = key(0.05, gt=0, lt=1, dimension="1")
    end_opening: float | None = key(None, gt=0, dimension="length")
    control: Literal["load", "energy", "opening"] = key("load")
    opening: str | None = key(None)
    report_every: int = key(10, ge=1)
    tooth_ratio: float | None = key(None, gt=1, le=2, dimension="1")
    times: tuple[float, ...] | None = key(None, min_length=1, dimension="1")
    load_factors: tuple[float, ...] | None = key(None, min_length=1, dimension="1")

    @property
    def legs(self) -> list[tuple[float, float, bool]]:
        """Ends of the straight parts of the way: time, load factor, and whether it is one of the deck's.

        A part from one side to the other is divided at 0.
        """
        return through_nothing(self.times, self.load_factors)

    def problems(self) -> list[Problem]:
        """What belongs together: an opening and its control, times and load factors."""
        return [*self._problems_of_opening(), *self._problems_of_times()]

    def _problems_of_times(self) -> list[Problem]:
        """Times with load factors, where the load alone says how the program goes on and ends."""
        if self.times is None and self.load_factors is None:
            return []
        if self.times is None or self.load_factors is None:
            missing = "times" if self.times is None else "load_factors"
            return [Problem(missing, "is missing: events take both times and load_factors, or neither. Add it.")]
        problems = amplitude_problems(self.times, self.load_factors)
        if self.end_load_factor is not None:
            text = f"= {show(self.end_load_factor)} ends a load that rises, and times say how it goes. Keep one."
            problems.append(Problem("end_load_factor", text))
        if self.control != "load":
            text = f'= {show(self.control)} scales the load, and times prescribe it. Use "load".'
            problems.append(Problem("control", text))
        return problems

    def _problems_of_opening(self) -> list[Problem]:
        """An opening where it is controlled, and only there."""
        if self.control == "opening":
            remedy = 'Give opening = "NAME", the name of a probe with kind = "opening".'
            return [] if self.opening else [Problem("control", f'= "opening" needs to know which. {remedy}')]
        return [
            Problem(name, f'= {show(getattr(self, name))} goes with control = "opening". Set that, or remove it.')
            for name in ("opening", "end_opening")
            if getattr(self, name) is not None
        ]

    @property
    def n_steps(self) -> int | None:
        """How many rows there will be is not known beforehand."""
        return None


def _steps_by_default(value: Any) -> Any:
    return {"kind": "steps", **value} if isinstance(value, dict) else value


def with_solver(data: Any) -> Any:
    """The tables of a scene; where a ramp names no solver, it is relaxation, which is the only one."""
    if not isinstance(data, dict):
        return data
    stepping, solver = data.get("stepping"), data.get("solver", {})
    kind = stepping.get("kind") if isinstance(stepping, dict) else getattr(stepping, "kind", None)
    if kind != "ramp":
        return data
    if isinstance(solver, Solver) and "kind" not in solver.model_fields_set:
        return data | {"solver": solver.model_copy(update={"kind": "adr"})}
    if isinstance(solver, dict) and "kind" not in solver:
        return data | {"solver": {"kind": "adr", **solver}}
    return data


Stepping = Annotated[Steps | Ramp | Events, Field(discriminator="kind"), BeforeValidator(_steps_by_default)]
