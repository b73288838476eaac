"""The end of a start: last files, summary.json, and the tables that a person sees."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from itertools import chain
from pathlib import Path
from time import perf_counter
from typing import TYPE_CHECKING, Any

from pdfem_mpi.measure.fields import fields_sha256
from pdfem_mpi.parallel.comm import dealt_on_node, on_root
from pdfem_mpi.results.ownership import SUMMARY
from pdfem_mpi.results.summary_file import sealed, write_summary
from pdfem_mpi.runs.failure_outcome import crack_in_a_mirror
from pdfem_mpi.runs.march import March
from pdfem_mpi.runs.memory_report import count_parts, describe_memory, left_out, table_of
from pdfem_mpi.runs.notes import Findings, ending
from pdfem_mpi.runs.region_notes import describe_staying
from pdfem_mpi.runs.restart_point import RestartPoint
from pdfem_mpi.runs.sanity import look_back
from pdfem_mpi.runs.stopwatch import phase
from pdfem_mpi.runs.summary import end_table, make_summary
from pdfem_mpi.runs.switching import count_bonds
from pdfem_mpi.system.exit_codes import EXIT_FINISHED, EXIT_STOPPED
from pdfem_mpi.system.process_memory import MemoryWatch

if TYPE_CHECKING:
    from pdfem_mpi.runs.run import Run


def finish(
    run: Run, march: March, start: RestartPoint, findings: Findings, sizes: dict[str, int], watch: MemoryWatch
) -> int:
    """Write what belongs to the end of a start, and report it; returns the exit code. Collective.

    Parameters
    ----------
    march : March
        After its end.
    start : RestartPoint
    findings : Findings
    sizes : dict
        Of the body, as of `prepare.count_sizes`.
    watch : MemoryWatch
        Of the process since before the simulation was made.
    """
    memory = describe_arrays(march, watch)
    if run.scene.is_adaptive:
        count_bonds(march.simulation)
    comm, simulation, ended, seconds = run.comm, march.simulation, march.ended, run.seconds
    seconds["solve"], seconds["output"] = march.seconds, march.seconds_of_output
    phases = {name: round(value, 6) for name, value in simulation.forces.seconds.items()}
    bonds = comm.gather(simulation.model.bonds.count if simulation.model.bonds else 0)
    for text in look_back(simulation, march.first_break):
        run.reporter.line(text)
    if ended.fields is not None:
        run.outputs.measure(ended.fields, simulation.state.load_factor)
    with phase(seconds, "output"):
        if ended.code != EXIT_STOPPED:  # a run that is asked to stop should stop soon
            on_root(comm, lambda: run.outputs.close())
    for line in describe_staying(simulation):
        run.reporter.line(line)
    for line in crack_in_a_mirror(run.scene, simulation.share, simulation.failure):
        run.reporter.line(line)
    seconds["total"] = perf_counter() - run.started
    summary = None
    if comm.rank == 0:
        run.claimed.starts.end(seconds["total"], ended.code, ended.did_nothing, start.notes)
        facts = {
            "deck_text": run.deck_text,
            "fields_sha256": fields_sha256(ended.fields) if ended.fields else ended.digest,
            "counts": sizes,
            "bonds_per_rank": bonds,
            "evaluations": simulation.forces.evaluations,
            "seconds": seconds | {"evaluation_phases_rank_0": phases},
            "seconds_of_all_starts": run.claimed.starts.seconds_before + seconds["total"],
            "memory": memory,
        }
        summary = make_summary(run.scene, march, findings, facts)
    if ended.code == EXIT_FINISHED:
        on_root(comm, lambda: remove_stacks(run.out))
    write_end(run, summary, draws=ended.code != EXIT_STOPPED)
    if comm.rank == 0:
        run.reporter.table(run.scene.title or run.out.name, end_table(summary, run.scene))
        run.reporter.table("memory: what was allocated, and what was left out", table_of(summary))
        run.reporter.line(f"pdfem: {ending(ended.code, ended.reason, run.out)}")
    return ended.code


def write_end(run: Run, summary: dict[str, Any] | None, draws: bool) -> None:
    """Write summary.json, draw the figures, which read it, and write it again with their digests. Collective.

    Parameters
    ----------
    summary : dict
        On rank 0.
    """

    def write() -> None:
        write_summary(run.claimed.written.new(SUMMARY), sealed(summary, run.out))

    on_root(run.comm, write)
    if not draws:
        return
    began = perf_counter()
    drawings = run.outputs.drawings() if run.comm.rank == 0 else []
    for text in chain(*dealt_on_node(run.comm, drawings)):
        run.reporter.line(f"warning: {text}")
    if run.comm.rank == 0:
        drawn = perf_counter() - began
        for name in ("output", "total"):
            summary["seconds"][name] += drawn
        summary["seconds_of_all_starts"] += drawn
    on_root(run.comm, write)


def describe_arrays(march: March, watch: MemoryWatch) -> dict[str, Any]:
    """What was allocated, and what was left out. Collective."""
    simulation = march.simulation
    arrays = count_parts(*simulation.parts, march.checkpoints, march.arrays)
    reasons = left_out(simulation.scene, simulation.share, simulation.failure, simulation.comm.size)
    need = replace(simulation.need, bytes=max(simulation.need.bytes, simulation.most_needed))
    return describe_memory(simulation.comm, arrays, march.watched, reasons, need, watch)


def remove_stacks(folder: Path) -> None:
    """Remove the stacks that earlier starts left where they hung: they say nothing of a run that finished."""
    for path in folder.glob("run.r*.hang"):
        with suppress(OSError):
            path.unlink()
