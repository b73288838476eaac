"""One start of `tools/benchmarks/bench`: times, sizes and ceilings on the ranks it was started on.

``mpirun -n RANKS python -m tools.benchmarks.measuring FILE`` runs it. Times are minima over repetitions: of process CPU
time, which other programs on the machine disturb least, and of wall time, between barriers. Rates are of CPU time on
one rank unless they say wall. docs/performance.md explains every number.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from time import perf_counter, process_time

import numpy as np

from pdfem_mpi.body.cutting import share_of
from pdfem_mpi.deck.meshes import FileMesh
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.toml import parse_deck
from pdfem_mpi.kernels import bond_response, bond_sweeps, linear_elements
from pdfem_mpi.kernels.exact_sums import SIZE, add_products, carry
from pdfem_mpi.kernels.relaxation import add_damping_sums, advance
from pdfem_mpi.kernels.rounding import pattern_for
from pdfem_mpi.kernels.simd import W
from pdfem_mpi.model.breaking import make_failure
from pdfem_mpi.model.forces import Forces
from pdfem_mpi.model.loads import make_load_case
from pdfem_mpi.model.model import Model, build_model
from pdfem_mpi.model.state import new_state
from pdfem_mpi.parallel.comm import largest, sum_integers, world
from pdfem_mpi.peridynamics.bond_forces import NOTHING_FAILS, pages
from pdfem_mpi.peridynamics.bonds import total_bonds
from pdfem_mpi.peridynamics.failure import Failure
from pdfem_mpi.runs.prepare import warm_up
from pdfem_mpi.system import launcher as launch
from pdfem_mpi.system.heap import large_arrays_apart
from pdfem_mpi.system.process_memory import footprint, forget_peak
from tools.benchmarks import ceilings

#: Cells of the paper's plate region, 30 million bonds, and of the case for quick looks, 2.4 million.
PLATE, SMALL = (80, 60, 4), (24, 8, 8)
PAPER_CUTOFF = 2.5
#: Bonds beyond this stretch would break: none does, at the strains of `_displacements`.
CRITICAL_STRETCH = 0.04
STRAIN = 1e-3
#: Seconds each timing repeats for, and the fewest repetitions.
SECONDS, REPETITIONS = 4.0, 5
MOST_REPETITIONS = 2000

# What the rooflines count, by hand from the kernels: a fused multiply-add is two operations, comparisons and integer
# additions are none. A row is four slots; bytes are those read from memory, once for each row or element.
ROW_BYTES, ROW_FLOPS = 4 + 32, 4 * 32
LINEAR_ROW_BYTES, LINEAR_ROW_FLOPS = 4 + 16, 4 * 18
SHARED_BYTES, SHARED_FLOPS = 32 + 8, 21 * 21 * 2 + 21 * 3
GENERAL_BYTES, GENERAL_FLOPS = 32 + 16 + 640, 8 * 363 + 21

DECK = """
[mesh]
kind = "box"
lower = [0.0, 0.0, 0.0]
upper = [{0}.0, {1}.0, {2}.0]
spacing = 1.0

[material]
youngs_modulus = 1.0
poissons_ratio = 0.25
{failure}

[[regions]]
name = "body"
model = "{model}"

[[supports]]
face = "x-"
x = 0.0
y = 0.0
z = 0.0
"""
BONDS_DECK = """
[peridynamics]
kinematics = "{kinematics}"
surface_correction = "{correction}"
cutoff_radius = {cutoff}
"""


def case_of(scene: Scene | None, small: bool) -> dict:
    """What is measured: a box of unit cells with the sizes of a deck, of the plate, or of the small case."""
    if scene is None:
        return {"title": "small" if small else "plate", "cells": SMALL if small else PLATE, "cutoff": PAPER_CUTOFF}
    if isinstance(scene.mesh, FileMesh):
        raise ValueError("--deck: its mesh is a file, and only the sizes of a box can be taken. Give another deck.")
    spacing = scene.mesh.spacing
    cutoff = scene.peridynamics.lengths(spacing)[1] / spacing if scene.has_peridynamics else PAPER_CUTOFF
    return {"title": scene.title, "cells": scene.mesh.n_cells, "cutoff": cutoff}


def make_scene(case: dict, model: str, kinematics: str = "finite", correction: str = "none") -> Scene:
    """The scene of a case, all of it in one description."""
    bonds = model == "peridynamics"
    failure = f"critical_stretch = {CRITICAL_STRETCH}" if bonds and kinematics == "finite" else ""
    text = DECK.format(*case["cells"], model=model, failure=failure)
    if bonds:
        text += BONDS_DECK.format(kinematics=kinematics, correction=correction, cutoff=case["cutoff"])
    return parse_deck(text, "bench")


# --- one start of the command --------------------------------------------------------------------------------


@dataclass(frozen=True)
class Seconds:
    """The least of many repetitions, of the slowest rank: CPU seconds and wall seconds."""

    cpu: float
    wall: float


def best(comm, *actions: Callable[[], object], seconds: float = SECONDS) -> list[Seconds]:
    """Time actions in turn, again and again, each repetition started by all ranks together. Collective."""
    times: list[np.ndarray] = []
    repetitions = 1
    while len(times) < repetitions:
        row = np.empty((len(actions), 2))
        for k, action in enumerate(actions):
            comm.Barrier()
            wall, cpu = perf_counter(), process_time()
            action()
            row[k] = process_time() - cpu, perf_counter() - wall
        times.append(row)
        if len(times) == 1:
            slowest = float(largest(comm, np.array([row[:, 1].sum()]))[0])
            repetitions = int(min(max(seconds / slowest, REPETITIONS), MOST_REPETITIONS))
    least = largest(comm, np.array(times[1:])).min(axis=0)
    return [Seconds(*row.tolist()) for row in least]


def measure(case: dict, comm, small: bool, seconds: float) -> dict:
    """All numbers of one start, as nested dictionaries; equal on all ranks. Collective."""
    ceilings.compile_kernels()
    warm_up(comm)
    result = {"ranks": comm.size} | _measure_finite(case, comm, seconds)
    result["pd_linear"] = _measure_linear(case, comm, seconds)
    result["fe"], result["fe_general"] = _measure_elements(case, comm, seconds)
    result["machine"] = _measure_machine(comm, 2**20 if small else 2**23, seconds)
    return result


def _displacements(model: Model) -> np.ndarray:
    """A smooth field with strains up to `STRAIN`."""
    points, nodes = model.points, model.nodes
    x = model.unknowns.of_points(points.x) if points else nodes.x[: nodes.n_owned].reshape(-1)
    return 0.5 * STRAIN * (x + np.sin(x))


def _ready(forces: Forces, bound: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Displacements, no loads, and a force, after evaluations that have fitted the bounds of the sums."""
    u = _displacements(forces.model)
    nothing, force = np.zeros(len(u)), np.empty_like(u)  # no page of nothing is written
    setattr(forces.bounds, bound, 2.0**-40)
    forces.evaluate_surely(u, nothing, force)
    return u, nothing, force


def _measure_finite(case: dict, comm, seconds: float) -> dict:
    """Set-up with the surface correction, memory, evaluations with failure, sums and relaxation."""
    scene = make_scene(case, "peridynamics", "finite", "appendix_a")
    before = footprint().resident
    forget_peak()
    comm.Barrier()
    start = perf_counter()
    with large_arrays_apart():
        share = share_of(scene, comm)
        model = build_model(scene, share, comm)
        load_case = make_load_case(scene, share, model)
        state = new_state(model)
        forces, failure = Forces(model, state.bounds), make_failure(scene, share, model)
        comm.Barrier()
        set_up = float(largest(comm, np.array([perf_counter() - start]))[0])
        u, nothing, force = _ready(forces, "bond")
        now = footprint()
        after, peak = (int(n) for n in sum_integers(comm, np.array([now.resident - before, now.peak - before])))
    bonds, points = total_bonds(comm, model.bonds), 8 * share.counts.point_cells
    halo, rows_here = model.points.halo, sum(len(rows.offset) - 1 for rows in model.bonds.rows)
    n_rows, owned, ghosts = sum_integers(comm, np.array([rows_here, halo.n_owned, halo.n_ghost])).tolist()

    exchange = []

    def evaluate():
        before = forces.seconds["exchange"]
        begin = perf_counter()
        forces.evaluate(u, nothing, force, failure)
        exchange.append((perf_counter() - begin, forces.seconds["exchange"] - before))

    (whole,) = best(comm, evaluate, seconds=2 * seconds)
    slowest = largest(comm, np.array(exchange))  # of the ranks, repetition by repetition
    fastest = slowest[np.argmin(slowest[:, 0])]
    sweep, closed, plain = best(comm, *_finite_sweeps(forces, failure), seconds=2 * seconds)
    inverse_mass = np.where(load_case.fixed, 0.0, 1.0 / model.mass)
    scratch = [u.copy(), np.zeros_like(u), force.copy()]
    sums = np.zeros((4, SIZE), np.int64)

    def relax():
        add_damping_sums(*scratch[:2], force, scratch[2], inverse_mass, sums)
        for row in sums:
            carry(row)
        advance(*scratch[:2], force, scratch[2], inverse_mass, 0.5, False)

    digits = np.zeros(SIZE, np.int64)
    relaxation, exact, dot = best(
        comm, relax, lambda: add_products(u, force, digits), lambda: np.dot(u, force), seconds=seconds
    )
    return {
        "case": {
            "title": case["title"], "cells": list(case["cells"]), "cutoff": case["cutoff"], "points": points,
            "undirected_bonds": bonds, "rows": n_rows, "bonds_per_row": bonds / n_rows,
        },
        "pd": _rates(bonds, comm.size, whole, sweep)
        | {
            "closed_sweep_undirected_bonds_per_second_per_core": bonds / comm.size / closed.cpu,
            "plain_sums_sweep_undirected_bonds_per_second_per_core": bonds / comm.size / plain.cpu,
            "sweep_seconds_over_plain_sums": sweep.cpu / plain.cpu,
            "evaluation_seconds": whole.wall,
            "bytes_per_undirected_bond": peak / bonds,
            "resident_bytes_per_undirected_bond": after / bonds,
            "row_bytes_per_undirected_bond": ROW_BYTES * n_rows / bonds,
        },
        "setup": {"seconds": set_up, "peak_over_resident": peak / after},
        "relaxation": {"seconds": relaxation.cpu, "share_of_evaluation": relaxation.cpu / whole.cpu},
        "exact_sums": {
            "nanoseconds_per_product": 1e9 * exact.cpu / len(u),
            "plain_nanoseconds_per_product": 1e9 * dot.cpu / len(u),
        },
        "exchange": {
            "share_of_evaluation": float(fastest[1] / fastest[0]),
            "seconds": float(fastest[1]),
            "ghosts_per_owned_cell": ghosts / owned,
        },
    }  # fmt: skip


def _rates(count: int, ranks: int, whole: Seconds, sweep: Seconds) -> dict[str, float]:
    return {
        "undirected_bonds_per_second_per_core": count / ranks / whole.cpu,
        "wall_undirected_bonds_per_second_per_core": count / ranks / whole.wall,
        "sweep_undirected_bonds_per_second_per_core": count / ranks / sweep.cpu,
    }


def _finite_sweeps(forces: Forces, failure: Failure) -> Iterator[Callable[[], object]]:
    """The sweep with failure by series and in closed form, and with plain sums, each over all rows of this rank."""
    bonds = forces.model.bonds
    _, pattern = pattern_for(forces.bounds.bond * bonds.strongest)
    table = bond_response.constants(pattern)
    extremes = np.zeros(2)
    trigger, critical = failure.limits(finite=True, margin=0.0)

    def over_rows(sweep, *arguments):
        for rows in bonds.rows:
            sweep(0, len(rows.start) - 1, *rows.arrays, *arguments)

    exact = forces.of_bonds.S.reshape(-1), forces.of_bonds.SI.reshape(-1), table, extremes
    exact += failure.class_of, trigger, critical, *failure.records
    floats = forces.of_bonds.S.copy()
    floats[:, 6:9] = 0.0
    yield lambda: over_rows(bond_sweeps.add_forces_series_failing, *exact)
    yield lambda: over_rows(bond_sweeps.add_forces_closed_failing, *exact)
    yield lambda: over_rows(ceilings.add_forces_plain_sums, floats.reshape(-1), table, float(trigger[0]))


def _measure_linear(case: dict, comm, seconds: float) -> dict:
    scene = make_scene(case, "peridynamics", "linear")
    model = build_model(scene, share_of(scene, comm), comm)
    forces = Forces(model)
    u, nothing, force = _ready(forces, "bond")
    bonds = total_bonds(comm, model.bonds)
    constants = bond_response.constants(pattern_for(forces.bounds.bond * model.bonds.cutoff)[1])
    table = forces.of_bonds.S.reshape(-1), forces.of_bonds.SI.reshape(-1), constants, np.zeros(2)

    def sweep():
        for rows in model.bonds.rows:
            bond_sweeps.add_forces_linear(0, len(rows.start) - 1, *rows.arrays, *table, *NOTHING_FAILS)

    whole, alone = best(comm, lambda: forces.evaluate(u, nothing, force), sweep, seconds=2 * seconds)
    return _rates(bonds, comm.size, whole, alone)


def _measure_elements(case: dict, comm, seconds: float) -> tuple[dict, dict]:
    """Elements of one shape, and of many: the same box with its nodes moved."""
    scene = make_scene(case, "finite_elements")
    regular = share_of(scene, comm)
    shift = np.random.default_rng(1).uniform(-0.1, 0.1, regular.nodes.shape)
    found = []
    for body in (regular, replace(regular, nodes=regular.nodes + shift)):
        model = build_model(scene, body, comm)
        forces = Forces(model)
        u, nothing, force = _ready(forces, "element")
        quantum, _ = pattern_for(model.elements.bound * forces.bounds.element)
        met, nodal = np.zeros(1), (forces.of_nodes.force, forces.of_nodes.u)

        def kernel(elements=model.elements, nodal=nodal, quantum=quantum, met=met):
            for part in elements.shared:
                numbers = part.connectivity, part.stiffness, part.scale
                linear_elements.add_shared_forces(*nodal, *numbers, quantum, met)
            if elements.general:
                part = elements.general
                numbers = part.connectivity, part.tables, part.lam, part.mu
                linear_elements.add_general_forces(*nodal, *numbers, quantum, met)

        def evaluate(forces=forces, u=u, nothing=nothing, force=force):
            forces.evaluate(u, nothing, force)

        alone, whole = best(comm, kernel, evaluate, seconds=seconds)
        share = body.counts.elements / comm.size
        found.append(
            {
                "elements_per_second_per_core": share / alone.cpu,
                "evaluation_elements_per_second_per_core": share / whole.cpu,
            }
        )
    return found[0], found[1]


def _measure_machine(comm, n: int, seconds: float) -> dict[str, float]:
    """Ceilings of one rank while all ranks measure: numbers a second from memory and caches, and operations.

    Parameters
    ----------
    n : int
        Numbers in an array; three times as many bytes as the last cache holds, unless the case is small.
    """
    a, b, c = (pages((n,)) for _ in range(3))
    for k, array in enumerate((a, b, c)):
        array[:] = 1.0 + k
    rng = np.random.default_rng(0)
    index = rng.integers(0, n - 3, 2**20).astype(np.uint32)
    near = rng.integers(0, 2**18, 2**20).astype(np.uint32)  # 2 MiB, as a rank's table of points
    turns, numbers = 2**18, np.array([0.5, 1.0])
    small, middle = a[: 2**11], a[: 2**15]  # 16 KiB and 256 KiB
    passes = 2**9, 2**5
    times = best(
        comm,
        lambda: ceilings.read_stream(a, 1),
        lambda: ceilings.triad(a, b, c, 3.0),
        lambda: ceilings.read_stream(small, passes[0]),
        lambda: ceilings.read_stream(middle, passes[1]),
        lambda: ceilings.multiply_add(turns, numbers),
        lambda: ceilings.gather(a, near),
        lambda: ceilings.gather(a, index),
        seconds=seconds,
    )
    stream, triad, first, second, flops, cached, random = (t.wall for t in times)
    return {
        "stream_read_bytes_per_second_per_core": 8 * n / stream,
        "stream_triad_bytes_per_second_per_core": 24 * n / triad,
        "l1_read_bytes_per_second_per_core": 8 * len(small) * passes[0] / first,
        "l2_read_bytes_per_second_per_core": 8 * len(middle) * passes[1] / second,
        "flops_per_second_per_core": 2 * W * ceilings.CHAINS * turns / flops,
        "gather_2_mib_triples_per_second_per_core": len(near) / cached,
        "gather_memory_triples_per_second_per_core": len(index) / random,
    }


def main() -> None:
    """The measuring start: read a case from the file named, measure, and write the numbers beside it. Collective."""
    launch.prepare_environment()
    file, comm = Path(sys.argv[1]), world()
    task = json.loads(file.read_text())
    result = measure(task["case"], comm, task["small"], task["seconds"])
    if comm.rank == 0:
        file.with_suffix(".result").write_text(json.dumps(result, allow_nan=False))


if __name__ == "__main__":
    main()
