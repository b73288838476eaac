"""What a load program tells at a step or an event: loads, reactions, balances, energies."""

from __future__ import annotations

import math
from dataclasses import dataclass
from time import perf_counter

import numpy as np

from pdfem_mpi.measure.strains import Deformation, measure_elements
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import LoadCase
from pdfem_mpi.model.motions import rigid_modes
from pdfem_mpi.model.restraints import internal_forces
from pdfem_mpi.model.state import State
from pdfem_mpi.parallel.comm import largest
from pdfem_mpi.parallel.sums import exact_dots
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.solvers.convergence import Convergence, NotConverged

#: The load factor at which it is seen how prescribed displacements begin.
BEGINNING = 2.0**-10
#: Cosine of the angle between displacements from which on they count as along each other: of a turn by up to 120
#: degrees with its beginning.
ALONG = 0.5


@dataclass(frozen=True)
class Report:
    """One row of the history, model units.

    Attributes
    ----------
    step : int
        From 1.
    event : str
        ``"step"``; of a ramp ``"ramp"`` and ``"end"``; of events ``"critical"`` (in equilibrium, the next bond is about
        to break), ``"batch"`` (within an avalanche), ``"arrest"`` (in equilibrium again), ``"turn"`` (where the way of
        the load turns), ``"switch"`` (elements were turned into bonds) and ``"end"``.
    load_factor : float
    displacement : float, dimension length
        Largest prescribed displacement or, under forces alone, their work over ``case.load``. Negative where the load
        factor is or, of formulas of it, against the way in which they begin.
    reaction : float, dimension force
        Largest resultant of a support that moves (else of a support) or, without supports, the load.
    resultant : float64, shape (3,), dimension force
        Sum of the forces of all supports and springs; mirror planes are none.
    of_supports : float64, shape (n_supports, 3), dimension force
        Force of each support on the body.
    convergence : Convergence
    force_balance, moment_balance : float, dimension 1
        Net internal force and moment, relative to the sums of their magnitudes. Of a part between mirror planes those
        components that the planes do not carry; the others vanish for the whole body.
    broken, new_broken : int
        Bonds broken so far, and since the row before.
    stored, dissipated, work, released : float or None, dimension force length
        Strain energy, energy of bonds when they broke, work of loads and supports, energy that relaxation took out.
    extent : float64, shape (2, 3) or None, dimension length
        Bounding box of the midpoints of broken bonds.
    elements : Deformation or None
        Of elements in finite kinematics.
    time : float or None
        Pseudo-time of a program that has one.
    seconds : float
        Since the row before.
    softened : int or None
        Bonds that have softened and are not gone; None where none can.
    of_springs : float64, shape (n_springs, 3), dimension force, or None
        Force of each table of springs on the body.
    switched : float or None, dimension force length
        Strain energy that vanished where elements were turned into bonds; None where none are.
    """

    step: int
    event: str
    load_factor: float
    displacement: float
    reaction: float
    resultant: np.ndarray
    of_supports: np.ndarray
    convergence: Convergence
    force_balance: float
    moment_balance: float
    broken: int
    new_broken: int
    stored: float | None
    dissipated: float | None
    work: float | None
    released: float | None
    extent: np.ndarray | None
    elements: Deformation | None
    time: float | None
    seconds: float
    softened: int | None = None
    of_springs: np.ndarray | None = None
    switched: float | None = None

    @property
    def ledger_error(self) -> float | None:
        """``W - U - D - X`` over ``W``, where ``X`` is counted by itself; less ``S``, where elements were turned."""
        if self.work is None or self.released is None or self.stored is None:
            return None
        difference = self.work - self.stored - self.dissipated - self.released - (self.switched or 0.0)
        return difference / self.work if self.work else difference


@dataclass
class Reporter:
    """Makes the rows of one run.

    Attributes
    ----------
    forces : Forces
    case : LoadCase
    failure : Failure or None
    gauge : LoadCase
        Whose loads the displacement is conjugate to: ``case`` with all its loads.
    """

    forces: Forces
    case: LoadCase
    failure: Failure | None

    def __post_init__(self):
        self.gauge = self.case

    def report(
        self,
        state: State,
        event: str,
        convergence: Convergence,
        work: float | None = None,
        released: float | None = None,
    ) -> Report:
        """Evaluate the state once more and describe it. Collective.

        Parameters
        ----------
        work, released : float, optional
            External work and energy taken out so far, where the program keeps these books.

        Raises
        ------
        NotConverged
            An element is turned inside out.
        """
        forces, case, failure = self.forces, self.case, self.failure
        elements = measure_elements(forces.model, state.u)
        if elements and elements.refusal:
            raise NotConverged(f"at load factor {state.load_factor:.6g} {elements.refusal}")
        forces.bounds.lower(largest(forces.model.comm, forces.met))  # digits for what is told
        internal = internal_forces(forces, state.u)
        resultants, force_balance, moment_balance = balance(forces, state, case, internal)
        springs = forces.model.springs
        of_springs = springs.resultants(forces.model.comm, state.u) if springs else None
        stored = forces.stored_energy(state.u) if failure else None
        broken = failure.count if failure else 0
        now = perf_counter()
        row = Report(
            step=state.step,
            event=event,
            load_factor=state.load_factor,
            displacement=displacement(forces, self.gauge, state),
            reaction=reaction(case, resultants, state.load_factor),
            resultant=resultants.sum(axis=0) + (0.0 if of_springs is None else of_springs.sum(axis=0)),
            of_supports=resultants,
            convergence=convergence,
            force_balance=force_balance,
            moment_balance=moment_balance,
            broken=broken,
            new_broken=broken - int(state.program.get("told_broken", 0)),
            stored=stored,
            dissipated=failure.dissipated if failure else None,
            work=work,
            released=released,
            extent=failure.extent if failure else None,
            elements=elements,
            time=state.program.get("time"),
            seconds=now - state.began,
            softened=getattr(failure, "soft", None),
            of_springs=of_springs,
            switched=state.program.get("switched"),
        )
        state.program["told_broken"], state.began = broken, now
        return row


def reaction(case: LoadCase, resultants: np.ndarray, load_factor: float) -> float:
    """The scalar that falls when the body fails (see `Report`); ``resultants`` of the supports, (n_supports, 3)."""
    sizes = [math.sqrt(x * x + y * y + z * z) for x, y, z in resultants.tolist()]
    moving = [size for size, moves in zip(sizes, case.moves, strict=True) if moves]
    if moving or not case.load:
        return max(moving or sizes, default=0.0)
    if case.lost:
        return 0.0
    return (abs(load_factor) if case.grows else 1.0) * case.load


def displacement(forces: Forces, case: LoadCase, state: State) -> float:
    """The displacement conjugate to `reaction` (see `Report`). Collective."""
    if case.following:
        size = largest(forces.model.comm, np.array([np.abs(state.u[case.fixed]).max(initial=0.0)]))[0]
        return math.copysign(float(size), _way(forces, case, state))
    if any(case.moves) or not case.load:
        return state.load_factor * case.reach
    (work,) = exact_dots(forces.model.comm, [(case.of_loads, state.u)])
    return float(work) / case.load


def _way(forces: Forces, case: LoadCase, state: State) -> float:
    """Negative where prescribed displacements are opposed to those with which formulas of the load factor begin.

    The load factor, where they are neither along them nor against them: after a large turn. Collective.
    """
    begun, rest = np.zeros_like(state.u), np.zeros_like(state.u)
    case.displace(begun, BEGINNING)
    case.displace(rest, 0.0)
    begun -= rest
    reached = np.where(case.fixed, state.u, 0.0)
    along, square, other = exact_dots(forces.model.comm, [(reached, begun), (reached, reached), (begun, begun)])
    size = ALONG * math.sqrt(square) * math.sqrt(other)
    return float(along) if abs(along) > size else state.load_factor


def support_resultants(forces: Forces, case: LoadCase, residual: np.ndarray) -> np.ndarray:
    """Forces with which each support acts on the body, shape (n_supports, 3). Collective.

    Parameters
    ----------
    residual : float64, shape (n_unknowns,)
        Of an evaluation; external forces do not act on supported unknowns.
    """
    pairs = []
    for places in case.held:
        pairs += [(-residual[place], np.ones(len(place))) for place in places]
    return exact_dots(forces.model.comm, pairs).reshape(-1, 3) if pairs else np.zeros((0, 3))


def balance(forces: Forces, state: State, case: LoadCase, internal: np.ndarray):
    """Resultants of the supports, and how well the internal forces sum to nothing. Collective."""
    model = forces.model
    finite = model.finite
    size = np.abs(internal)

    def pairs():
        for mode in rigid_modes(model, state.u if finite else None):
            yield internal, mode
            yield size, np.abs(mode)

    net, gross = exact_dots(model.comm, pairs()).reshape(6, 2).T
    net = np.where(model.mirrors.kept_motions, net, 0.0)

    def ratio(d):
        whole = float(gross[d].max())
        return float(np.abs(net[d]).max()) / whole if whole > 0.0 else 0.0

    held = internal if case.thermal is None else internal + state.load_factor * case.thermal.forces
    if model.springs:
        held = held.copy()
        model.springs.pull(state.u, held)
    return support_resultants(forces, case, held), ratio(slice(0, 3)), ratio(slice(3, 6))
