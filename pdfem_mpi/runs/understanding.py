"""What `pdfem check` understood of a deck: each region, load, support and crack with its size and place, what moves
freely, when bonds break, and what the run will take.

The load case is made as a run makes it, so that what a run refuses is refused here. Bonds are searched and cut, but not
corrected: corrections take most of a set-up, and refuse nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from time import perf_counter
from typing import Any

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.programs import Ramp, Steps
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import LoadCase, make_load_case
from pdfem_mpi.model.model import Model, build_model
from pdfem_mpi.model.motions import name_motion
from pdfem_mpi.model.parts import describe_unsupported, positions
from pdfem_mpi.model.resultants import resultant_of
from pdfem_mpi.model.state import new_state
from pdfem_mpi.parallel.comm import largest, sum_integers
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.runs.failure_notes import criteria
from pdfem_mpi.runs.memory_estimate import show_bytes
from pdfem_mpi.runs.notes import describe_taken
from pdfem_mpi.runs.sanity import doubts

#: Evaluations of an equilibrium by conjugate gradients to 1e-6 (docs/overview.md), with Newton's method where finite.
CG_EVALUATIONS = {"linear": 20, "finite": 60}
#: Evaluations of relaxation for a cell of the body's length, to 1e-6 (docs/overview.md).
ADR_EVALUATIONS = 8
#: Components of a resultant below this part of the largest are round-off.
ROUND_OFF = 1e-12
#: Evaluations whose mean tells the speed.
TIMED = 2


@dataclass(frozen=True)
class Understood:
    """The equations of a scene without corrections, and its loads.

    Attributes
    ----------
    model : Model
    case : LoadCase
    failure : Failure or None
    seconds : float
        Of one evaluation of the slowest rank.
    """

    model: Model
    case: LoadCase
    failure: Failure | None
    seconds: float


def understand(scene: Scene, share: Share, comm) -> Understood:
    """Make what a run would make, but for corrections and solver. Collective.

    Raises
    ------
    SceneError
        For all that a run would refuse.
    """
    model = build_model(without_corrections(scene), share, comm)
    case = make_load_case(scene, share, model)
    failure = make_failure(scene, share, model)
    state = new_state(model)
    forces, residual = Forces(model, state.bounds), np.empty_like(state.u)
    forces.evaluate_surely(state.u, case.external, residual)  # tables are filled
    began = perf_counter()
    for _ in range(TIMED):
        forces.evaluate_surely(state.u, case.external, residual)
    seconds = (perf_counter() - began) / TIMED
    return Understood(model, case, failure, float(largest(comm, np.array([seconds]))[0]))


def without_corrections(scene: Scene) -> Scene:
    """The scene with the bonds as they are found, and without weights of damage."""
    settings = scene.peridynamics.model_copy(update={"surface_correction": "none", "stiffness_noise": 0.0})
    output = scene.output.model_copy(update={"fields": bool(scene.output.fields), "damage": False})
    return scene.model_copy(update={"peridynamics": settings, "output": output})


def describe(scene: Scene, share: Share, found: Understood) -> Iterator[tuple[str, str]]:
    """Rows of the table of `pdfem check`. Collective."""
    yield from _regions(scene, share)
    yield from _loads(scene, share)
    yield from _supports(scene, share, found)
    yield from _restraints(scene, share, found.model)
    for index, (crack, cut) in enumerate(zip(scene.cracks, found.model.cut, strict=False)):
        corners = _corners_within(share, crack)
        what = f"cuts {cut:,} bonds" if cut else "cuts no bond: it does not pass through peridynamic cells"
        yield f"cracks.{index}", f"{what}; {_box(corners.min(axis=0), corners.max(axis=0), scene.units.length)}"
    yield "free motions", _free_motions(scene, share, found.case)
    if not np.isnan(found.case.taken).all():
        yield "loads on supports", describe_taken(found.case.taken * share.units.force, scene.units.force)
    yield from _limits(scene, share, found.model)
    told = list(doubts(scene, share, criteria(scene, share, found.model)))
    yield from ((f"doubt {k}", text) for k, text in enumerate(told, start=1))
    yield from _time(scene, share, found)
    yield "disk, about", _disk(scene, share, found.model)


def _corners_within(share: Share, crack: Any) -> np.ndarray:
    """Corners of a crack as the deck has them, or as far as the body reaches; (n, 3), the deck's units."""
    if isinstance(crack, Crack):
        return np.array(crack.polygon)
    low, high = (corner * share.units.length + share.units.origin for corner in (share.lower, share.upper))
    return np.clip(np.array(crack.corners(low.tolist(), high.tolist())), low, high)


def _regions(scene: Scene, share: Share) -> Iterator[tuple[str, str]]:
    for index, region in enumerate(scene.regions):
        cells = (share.region == index) & share.is_owned
        count, with_points = _counts(share, cells, cells & share.has_points)
        words = [region.model.replace("_", " "), f"{count:,} cells"]
        words += [f"{8 * with_points:,} points"] if with_points else []
        words += [f"material {region.material}"] if scene.materials else []
        words += ["bonds never break"] if scene.can_fail and region.may_fail is False else []
        yield f"region {region.name}", f"{', '.join(words)}; {_box_of(share, cells, None, scene)}"


def _loads(scene: Scene, share: Share) -> Iterator[tuple[str, str]]:
    unit = f" {scene.units.force}" if scene.units.force else ""
    for index, load in enumerate(scene.loads):
        force, cells, nodes = resultant_of(scene, share, index)
        force = np.where(np.abs(force) < ROUND_OFF * np.abs(force).max(), 0.0, force) * share.units.force
        n_cells, n_nodes = _counts(share, cells, nodes)
        places = [f"{n_cells:,} cells"] if n_cells else []
        places += [f"{n_nodes:,} nodes"] if n_nodes else []
        total = ", ".join(f"{value:.6g}" for value in force)
        text = f"{load.kind.replace('_', ' ')} of ({total}){unit} in all on {' and '.join(places) or 'nothing'}"
        yield f"loads.{index}", f"{text}; {_box_of(share, cells, nodes, scene)}"


def _supports(scene: Scene, share: Share, found: Understood) -> Iterator[tuple[str, str]]:
    unit = f" {scene.units.length}" if scene.units.length else ""
    for index, support in enumerate(scene.supports):
        counts = sum_integers(share.comm, np.array([len(held) for held in found.case.held[index]]))
        amounts = []
        for axis, count in zip("xyz", counts.tolist(), strict=True):
            amount = support.amounts["xyz".index(axis)]
            if amount is not None or count:
                number = isinstance(amount, int | float)
                told = f" = {amount:.6g}{unit}" if number else f" = {amount}" if amount is not None else ""
                amounts.append(f"{axis}{told} at {count:,} points and nodes")
        cells = np.zeros(len(share.mesh.cells), bool)
        cells[share.selections.supports[index].cells] = True
        place = f"in cells {_box_of(share, cells & share.is_owned, None, scene)}"
        if place.endswith("nowhere"):  # narrower than cells
            place = _at(scene, found.model, np.concatenate(found.case.held[index])).partition("; ")[2]
        yield f"supports.{index}", f"{', '.join(amounts)}; {place}"


def _restraints(scene: Scene, share: Share, model: Model) -> Iterator[tuple[str, str]]:
    """Springs with their stiffness, and ties, each with its places."""
    force, length = scene.units.force, scene.units.length
    unit = f" {force}/{length}" if force and length else ""
    for index, spring in enumerate(scene.springs):
        places = np.concatenate([places for places, _ in model.springs.tables[3 * index : 3 * index + 3]])
        stiffness = ", ".join(f"{k:.6g}" for k in spring.stiffness)
        yield f"springs.{index}", f"stiffness ({stiffness}){unit} in all {_at(scene, model, places)}"
    groups = model.ties.groups if model.ties else ()
    for index, tie in enumerate(scene.ties):
        places = np.concatenate([group.index for group in groups if group.table == index])
        yield f"ties.{index}", f"one displacement along {', '.join(tie.along)} {_at(scene, model, places)}"


def _at(scene: Scene, model: Model, index: np.ndarray) -> str:
    """How many points and nodes some unknowns belong to, and the box around them. Collective."""
    chosen = np.zeros(model.n_unknowns, bool)
    chosen[index] = True
    rows = model.unknowns.rows(chosen).any(axis=1)
    (count,) = sum_integers(model.comm, np.array([np.count_nonzero(rows)])).tolist()
    x = positions(model)[rows] * model.units.length + model.units.origin
    ends = [(-x).max(axis=0), x.max(axis=0)] if len(x) else [np.full(3, -np.inf)] * 2
    low, high = largest(model.comm, np.concatenate(ends)).reshape(2, 3)
    return f"at {count:,} points and nodes; {_box(-low, high, scene.units.length)}"


def _free_motions(scene: Scene, share: Share, case: LoadCase) -> str:
    if case.parts.count > 1:
        loose = describe_unsupported(case.parts, case.unsupported)
        return f"the body is in {case.parts.count:,} parts" + (f"; {'; '.join(loose)}" if loose else ", all held")
    if not len(case.free_motions):
        return "none: supports hold the body"
    names = {name_motion(motion) for motion in case.free_motions}
    kinds = ("translation along", "rotation about")
    axes = {kind: [axis for axis in "xyz" if f"the {kind} {axis}" in names] for kind in kinds}
    words = " and ".join(f"{kind} {', '.join(found)}" for kind, found in axes.items() if found)
    return f"{len(case.free_motions)}, {words}: no support holds them, and loads are in balance along them"


def _limits(scene: Scene, share: Share, model: Model) -> Iterator[tuple[str, str]]:
    """When bonds break, and how large the zone is in which they do."""
    force, unit = scene.units.force, scene.units.length
    per_area = f" {force}/{unit}^2" if force and unit else ""
    per_length = f" {force}/{unit}" if force and unit else ""
    length = f" {unit}" if unit else ""
    tables = {"default": scene.material, **scene.materials}
    for name, criterion in criteria(scene, share, model).items():
        zone = tables[name].youngs_modulus * criterion.fracture_energy_bulk / criterion.strength**2
        yield (
            f"failure of {name}" if len(tables) > 1 else "failure",
            f"critical stretch {criterion.critical_stretch:.4g}, strength E s_0 = {criterion.strength:.4g}{per_area}, "
            f"fracture energy {criterion.fracture_energy_bulk:.4g}{per_length} in the bulk; process zone E G_c / "
            f"(E s_0)^2 = {zone:.4g}{length}, internal length {share.units.length:.4g}{length}, cells "
            f"{share.typical_edge * share.units.length:.4g}{length}",
        )


def _time(scene: Scene, share: Share, found: Understood) -> Iterator[tuple[str, str]]:
    """Evaluations and seconds that are known beforehand; this rank's speed is measured."""
    each, speed = evaluations(scene, share), found.seconds
    one = f"an evaluation takes {speed:.2g} s here"
    if isinstance(scene.stepping, Ramp):
        count = scene.stepping.end_load_factor / scene.stepping.increment
        yield "time, about", f"at most {count:,.0f} evaluations, {_duration(count * speed)} and set-up; {one}"
    elif isinstance(scene.stepping, Steps) and not found.failure:
        count = each * scene.stepping.n_steps
        yield "time, about", f"{count:,} evaluations, {_duration(count * speed)} and set-up; {one}"
    else:
        told = f"{each:,} evaluations for the first equilibrium, {_duration(each * speed)} and set-up"
        yield "time, about", f"{told}; what breaks decides the rest, tens of evaluations for each break; {one}"


def evaluations(scene: Scene, share: Share) -> int:
    """Evaluations that one equilibrium takes, about."""
    if scene.solver.kind == "cg":
        return CG_EVALUATIONS[scene.kinematics]
    sides = (share.upper - share.lower) / share.typical_edge
    return int(ADR_EVALUATIONS * sides.max())


def _disk(scene: Scene, share: Share, model: Model) -> str:
    """Bytes of a frame of the fields and of a checkpoint."""
    points, nodes = 8 * share.counts.point_cells, share.counts.nodes
    frame = 0
    if scene.output.fields:
        on_body = 12 * share.counts.mesh_nodes + 4 * share.counts.cells
        frame = 12 * (points + nodes) + 4 * points * scene.output.has_damage
        frame += on_body if points and scene.output.body else 0
    vectors = 1 if scene.solver.kind == "cg" else 4
    checkpoint = 24 * vectors * (points + nodes)
    rows = scene.stepping.n_steps
    frames = f"{_size(frame)} a frame of the fields" + (f", {rows} rows" if rows and rows > 1 else "")
    return f"{frames}; {_size(checkpoint)} a checkpoint and 16 bytes a broken bond, {scene.checkpoint.keep} kept"


def _size(n_bytes: float) -> str:
    return show_bytes(n_bytes) if n_bytes >= 2e6 else f"{n_bytes / 1e3:.0f} kB"


def _duration(seconds: float) -> str:
    if seconds < 100.0:
        return f"{seconds:.2g} s"
    return f"{seconds / 60.0:.0f} min" if seconds < 6000.0 else f"{seconds / 3600.0:.1f} h"


def _counts(share: Share, *chosen: np.ndarray) -> list[int]:
    """How many are chosen on all ranks. Collective."""
    return sum_integers(share.comm, np.array([np.count_nonzero(mask) for mask in chosen])).tolist()


def _box_of(share: Share, cells: np.ndarray, nodes: np.ndarray | None, scene: Scene) -> str:
    """The box around cells and nodes of all ranks, in the deck's units. Collective."""
    mesh = share.mesh
    chosen = np.zeros(len(mesh.nodes), bool) if nodes is None else nodes.copy()
    chosen[mesh.cells[cells]] = True
    places = mesh.nodes[chosen]
    beyond = np.full(3, -np.inf)
    ends = [(-places).max(axis=0), places.max(axis=0)] if len(places) else [beyond, beyond]
    low, high = largest(share.comm, np.concatenate(ends)).reshape(2, 3)
    return _box(-low, high, scene.units.length) if np.isfinite(low).all() else "nowhere"


def _box(low: np.ndarray, high: np.ndarray, unit: str) -> str:
    ends = (f"{axis} {a:.6g} to {b:.6g}" if a < b else f"{axis} {a:.6g}"
            for axis, a, b in zip("xyz", low + 0.0, high + 0.0, strict=True))  # fmt: skip
    return ", ".join(ends) + (f" {unit}" if unit else "")
