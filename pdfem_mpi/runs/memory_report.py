"""What a run holds in memory, part by part, and what it left out because the scene does not need it.

Bytes are counted from the arrays that are there (`held`), at the end of the run; vectors that a solver holds while it
works are counted on the way. Reasons come from the scene: a part without a byte has one, a part with some has none.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.programs import Ramp, Steps
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import LoadCase
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.state import State
from pdfem_mpi.parallel.comm import sum_integers
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.runs.array_bytes import Count
from pdfem_mpi.runs.checkpoints import CheckpointWriter
from pdfem_mpi.runs.memory_estimate import Need, show_bytes
from pdfem_mpi.solvers.convergence import Progress
from pdfem_mpi.solvers.equilibrium import EquilibriumSolver
from pdfem_mpi.system.process_memory import MemoryWatch

#: All parts, in the order in which they are counted: what two of them share belongs to the first.
PARTS = (
    "mesh", "share_of_the_rank", "exchange", "mirror_images", "points", "bond_rows",
    "bond_strengths", "bond_lengths", "dilatations", "bond_counts", "fitted_factors", "damage_weights", "nodes",
    "elements", "overlap", "masses", "loads_and_supports", "state", "force_tables", "break_check", "break_records",
    "broken_bonds", "intact_elements", "coarse_grid", "preconditioner_blocks", "checkpoint_copy", "output",
    "solver_vectors",
)  # fmt: skip
#: The same bytes on every rank count: each cell, node or bond is on one rank. Others have ghosts, rows that depend on
#: which rank computes a bond, or stand on every rank, like the matrix of elements of one shape.
SHARED_OUT = ("damage_weights", "overlap", "masses", "state")


def features_of(scene: Scene) -> frozenset[str]:
    """What a scene has, in the words of `kernels.warm_up.NEEDED_BY`."""
    bonds, settings = scene.has_peridynamics, scene.peridynamics
    cg = scene.has_cycle
    has = {
        "bonds": bonds,
        scene.kinematics: bonds,
        "failing": bonds and scene.can_fail,
        "softening": bonds and scene.softens,
        "correction": bonds and settings.surface_correction in ("appendix_a", "virial"),
        "fitted": bonds and settings.surface_correction == "fitted",
        "noise": settings.stiffness_noise > 0.0,
        "cracks": bool(scene.cracks) or getattr(scene.mesh, "doubled_nodes", "") == "crack",
        "gaps": bonds and scene.mesh.may_have_hollows,
        "damage": scene.output.has_damage,
        "adaptive": scene.is_adaptive,
        "stresses": bonds and bool(scene.output.mechanical),
        "mirrors": bool(scene.mesh.symmetry),
        "overlap": scene.is_coupled,
        "cg": cg,
        "adr": scene.solver.kind == "adr" or isinstance(scene.stepping, Ramp),
        "volumetric": bonds and scene.has_volumetric_part,
        "elements": (scene.has_finite_elements and scene.kinematics == "linear") or cg,  # cg: those of the intact body
        "turning": scene.has_finite_elements and scene.kinematics == "finite",
    }
    return frozenset(feature for feature, there in has.items() if there)


class Watched:
    """What solvers hold while they work, beside the run's own arrays.

    Parameters
    ----------
    forces : Forces
    held
        More of the run's own.
    """

    def __init__(self, forces: Forces, *held: Any):
        self.kinds: dict[type, int] = {}
        self.swept = forces.swept
        self._own = Count()
        self._own.bytes_of(forces, *held)

    def observe(self, progress: Progress) -> None:
        """Count what a solver holds, once for each kind of solver."""
        kind = type(progress.work[0]) if progress.work else None
        if kind is not None and kind not in self.kinds:
            self.kinds[kind] = self._own.copy().bytes_of(*progress.work)

    @property
    def bytes(self) -> int:
        """Of the solver that holds most: they work one after the other."""
        return max(self.kinds.values(), default=0)


def count_parts(
    share: Share,
    model: Model,
    case: LoadCase,
    state: State,
    forces: Forces,
    failure: Failure | None,
    solve: EquilibriumSolver,
    checkpoints: CheckpointWriter,
    output: Any,
) -> dict[str, int]:
    """Bytes of this rank's arrays by part; ``output`` is whatever a run keeps for its result files."""
    preconditioner, count = solve.preconditioner, Count()
    things = dict(_things(share, model, case, state, forces, failure, preconditioner, checkpoints, output))
    counted = {name: count.bytes_of(*things.get(name, ())) for name in PARTS}
    if model.bonds:  # strengths and lengths alternate in one array
        counted["bond_lengths"] = int(counted["bond_strengths"] * model.bonds.share_of_lengths)
        counted["bond_strengths"] -= counted["bond_lengths"]
    return counted


def _things(
    share, model, case, state, forces, failure, preconditioner, checkpoints, output
) -> Iterator[tuple[str, tuple]]:
    points, bonds, nodes = model.points, model.bonds, model.nodes
    yield "mesh", (share.mesh,)
    yield "share_of_the_rank", (share, checkpoints.layout)
    halos = [part.halo for part in (points, nodes) if part]
    if points:
        if points.images:
            yield "mirror_images", (points.images, points.halo.factors)
            halos[0] = points.halo.halo
        yield "points", (points,)
        yield from bonds.storage().items()
        if bonds.volumetric:
            yield "dilatations", (bonds.volumetric, forces.of_bonds.q)
        yield "bond_counts", (bonds,)
    yield "exchange", tuple(halos)
    yield "fitted_factors", (model.body_fit,)
    yield "damage_weights", (model.intact_weights,)
    yield "nodes", (nodes, model.rollers)
    yield "elements", (model.elements,)
    yield "overlap", (model.overlap,)
    yield "masses", (model.mass,)
    yield "loads_and_supports", (case,)
    yield "state", (state,)
    yield "force_tables", tuple(value for name, value in vars(forces).items() if name != "last")  # the solver's
    if failure:
        yield "break_check", (failure.class_of, failure.stretch)
        yield "break_records", failure.records
        yield "broken_bonds", (failure.global_pairs, failure._fresh, failure._pairs, getattr(failure, "_teeth", None))
    if preconditioner:
        yield "intact_elements", (preconditioner.forces,)
        yield "coarse_grid", (preconditioner.grid,)
        yield "preconditioner_blocks", (preconditioner,)
    yield "checkpoint_copy", (checkpoints.good,)
    yield "output", (output,)


def describe_memory(
    comm, parts: dict[str, int], watched: Watched, reasons: dict[str, str], need: Need, watch: MemoryWatch
) -> dict[str, Any]:
    """The entry ``memory`` of the summary; empty except on rank 0. Collective.

    Parameters
    ----------
    parts : dict of int
        From `count_parts`.
    reasons : dict of str
        From `left_out`.
    need : Need
        What was estimated before anything was allocated.
    watch : MemoryWatch
        Of the process since then.
    """
    parts = parts | {"solver_vectors": watched.bytes}
    sums = sum_integers(comm, np.array([parts[name] for name in PARTS])).tolist()
    watch.look()
    start, peak = watch.start, watch.last.peak
    own = peak, start.resident, watch.private_peak, start.private, int(need.bytes), sum(parts.values())
    everybody = comm.gather(own)
    swept = comm.gather(watched.swept)
    if comm.rank > 0:
        return {}
    names = ("peak", "before_set_up", "private_peak", "private_before_set_up", "estimated", "array")
    return {
        **{f"{name}_bytes_per_rank": list(of) for name, of in zip(names, zip(*everybody, strict=True), strict=True)},
        "array_bytes": {name: size for name, size in zip(PARTS, sums, strict=True) if size},
        "left_out": {
            name: reasons.get(name, "nothing to hold") for name, size in zip(PARTS, sums, strict=True) if not size
        },
        "bond_kernels": sorted(set().union(*swept)),
    }


def table_of(summary: dict[str, Any]) -> list[tuple[str, str]]:
    """Rows for the table at the end: parts of at least a hundredth, the others together, and what was left out."""
    memory, bonds = summary["memory"], summary["counts"]["undirected_bonds"]
    sizes = memory["array_bytes"]

    def show(size: int) -> str:
        text = f"{size / 2**20:.1f} MiB" if size >= 2**20 else f"{size / 2**10:.1f} KiB"
        return text + (f", {size / bonds:.2f} B a bond" if bonds else "")

    whole = sum(sizes.values())
    large = sorted((name for name in sizes if 100 * sizes[name] >= whole), key=sizes.get, reverse=True)
    rows = [(name.replace("_", " "), show(sizes[name])) for name in large]
    rows.append(("other arrays", show(whole - sum(sizes[name] for name in large))))
    rows.append(("all arrays", show(whole)))
    start, estimated, peak, private_start, private_peak = (
        sum(memory[f"{name}_bytes_per_rank"])
        for name in ("before_set_up", "estimated", "peak", "private_before_set_up", "private_peak")
    )
    grown = show_bytes(private_peak - private_start)
    rows.append(("private peak above the start", f"{grown}, estimated {show_bytes(estimated)}"))
    rows.append(("resident peak above the start", f"{show_bytes(peak - start)}, pages that processes share included"))
    if memory["bond_kernels"]:
        rows.append(("bond kernels called", "; ".join(memory["bond_kernels"])))
    absent: dict[str, list[str]] = {}
    for name, reason in memory["left_out"].items():
        absent.setdefault(reason, []).append(name.replace("_", " "))
    return rows + [("left out", f"{', '.join(names)}: {reason}") for reason, names in absent.items()]


def left_out(scene: Scene, share: Share, failure: Failure | None, ranks: int) -> dict[str, str]:
    """Parts that the scene does not need, and the key or property of it that says so."""
    reasons: dict[str, str] = {}

    def because(reason: str, *parts: str) -> None:
        for part in parts:
            reasons.setdefault(part, reason)

    counts = share.counts
    if ranks == 1:
        because("one rank", "exchange")
    if not counts.point_cells:
        because(
            "no cell is peridynamic",
            "points", "bond_rows", "bond_strengths", "bond_lengths", "bond_counts", "damage_weights", "break_check",
            "break_records", "broken_bonds", "fitted_factors", "mirror_images", "dilatations",
        )  # fmt: skip
    if scene.kinematics == "linear":
        because('peridynamics.kinematics = "linear"', "bond_lengths")
    if scene.peridynamics.surface_correction != "fitted":
        because(f'peridynamics.surface_correction = "{scene.peridynamics.surface_correction}"', "fitted_factors")
    because("Poisson's ratio of the bonds is 1/4", "dilatations")
    if failure is None:
        limited = scene.can_fail
        reason = "no region may fail" if limited else "no critical_stretch and no fracture_energy in the deck"
        because(reason, "break_check", "break_records", "broken_bonds")
    elif not failure.count:
        because("no bond broke", "broken_bonds")
    if not scene.mesh.symmetry:
        because("mesh.symmetry is empty", "mirror_images")
    if not scene.output.has_damage:
        because("output.damage = false", "damage_weights")
    if not counts.node_cells:
        because("no cell is a finite element", "nodes", "elements", "overlap")
    if not counts.overlap_cells:
        because("no cell has both descriptions", "overlap")
    if not counts.elements:
        because("no cell is a finite element", "elements")
    if scene.is_adaptive:
        because('regions with model = "auto": relaxation makes its own', "masses")
    if scene.solver.kind != "cg":
        because(f'solver.kind = "{scene.solver.kind}"', "intact_elements", "coarse_grid", "preconditioner_blocks")
    if isinstance(scene.stepping, Steps) and scene.stepping.n_steps == 1:
        because("one load step: there is no earlier state to keep", "checkpoint_copy")
    if not (scene.output.fields or scene.probes):
        because("output.fields = false, and no probes", "output")
    return reasons
