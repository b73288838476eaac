"""The bar and the plate in many settings, run and timed: docs/speed_vs_error.md and its figure.

Each finished case is a file in runs/speed_vs_error/ and is not run again unless its deck, the number of ranks or the
program's version changed. Run it on an idle machine; cases that shared it are marked. Kernels and fits of bond factors
are kept in runs/speed_vs_error/cache, not in the user's cache: a case whose fit counts starts without any, one whose
fit is "found" runs a second time where there was none.
"""

from __future__ import annotations

import hashlib
import os
import sys
import tempfile
import time
from dataclasses import asdict
from pathlib import Path

import psutil

from pdfem_mpi import __version__, read_deck, write_deck
from tools.studies.series import DOCS, JOBS, RUNS, Results, parser_of, run_deck, summary_of
from tools.studies.speed_vs_error.cases import DECKS, Case, make_series, reference_case
from tools.studies.speed_vs_error.report import write_report

RESULTS = Results(RUNS / "speed_vs_error")
#: Lines of a run that hold one of these are kept.
NOTES = ("broke down", "Going on with", "no positive bond factors", "the fit of the bond factors", "unstable")


def identity(case, ranks):
    """What a stored result depends on: the whole deck, defaults included, the version, the ranks and the fit."""
    deck = write_deck(read_deck(JOBS / DECKS[case.body, case.model], case.overrides))
    return hashlib.sha256(f"{__version__}\n{ranks}\n{case.fit}\n{deck}".encode()).hexdigest()


def run_case(case, ranks):
    """Run a case and return what is kept of it."""
    cache = RESULTS.folder / "cache"
    if case.correction == "fitted" and case.fit == "fresh":
        forget_fits(cache)
    result = run_once(case, ranks, cache)
    if case.fit == "found" and not found_fit(result):
        result = run_once(case, ranks, cache)
    if case.correction == "fitted" and found_fit(result) != (case.fit == "found"):
        sys.exit(f"speed_vs_error: {case.name}: the fit is not {case.fit}. Does {cache} keep what is written?")
    return result


def forget_fits(cache):
    """Remove the fits of bond factors from a cache, and leave its kernels."""
    for path in cache.glob("bond_factors-*.npz"):
        path.unlink()


def found_fit(result):
    """Whether a run took its bond factors from an earlier one."""
    return bool(result["fit"] and result["fit"]["reused"])


def run_once(case, ranks, cache):
    """Run a case with kernels and fits in a cache."""
    cache.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory() as folder:
        out = Path(folder) / "run"
        deck = DECKS[case.body, case.model]
        before, own, start = psutil.cpu_times(), os.times(), time.perf_counter()
        done = run_deck(deck, case.overrides, out, "-n", str(ranks), check=False, NUMBA_CACHE_DIR=str(cache))
        after, spent, seconds = psutil.cpu_times(), os.times(), time.perf_counter() - start
        busy = sum(
            getattr(after, name, 0.0) - getattr(before, name, 0.0) for name in ("user", "system", "nice", "steal")
        )
        own = sum(getattr(spent, n) - getattr(own, n) for n in ("user", "system", "children_user", "children_system"))
        summary = summary_of(out)
        if not summary:
            sys.exit(f"speed_vs_error: {case.name} failed.\n{' '.join(done.args)}\n{done.stdout}{done.stderr}")
    return {
        "case": asdict(case),
        "status": summary["status"],
        "reason": summary["reason"],
        "notes": [line for line in done.stdout.splitlines() if any(words in line for words in NOTES)],
        "sweeps": summary["solve"]["evaluations"],
        "relative_residual": summary["solve"]["relative_residual"],
        "fit": summary["surface_correction"]["fit"],
        "setup_core_seconds": ranks * summary["seconds"]["setup"],
        "solve_core_seconds": ranks * summary["seconds"]["solve"],
        "counts": summary["counts"],
        "probes": summary["probes"],
        "cores": os.cpu_count(),
        "cores_used_by_others": max(0.0, busy - own) / seconds,
    }


def of_earlier_build(folder, case, ranks):
    """Return what an earlier build left of a case, marked, or None: what does not depend on the build still holds.

    The case is compared by its settings, as far as there were such, and not by the deck.
    """
    result = Results(folder).read(case.name)
    if result is None:
        return None
    known = all(asdict(case)[name] == value for name, value in result["case"].items())
    return result | {"earlier_build": True} if known and result["ranks"] == ranks else None


def main(words: list[str]) -> int:
    """Run what is left, and write the page and its figure."""
    parser = parser_of(__doc__, quick="spacings of 0.1 and more; writes into runs/ only")
    parser.add_argument("--ranks", type=int, default=2)
    parser.add_argument("--earlier", type=Path, metavar="FOLDER", help="runs of an earlier build, for cases not run")
    parser.add_argument("--busy", type=float, metavar="CORES", help="repeat cases during which others used more cores")
    options = parser.parse_args(words)
    series, reference = make_series(options.quick), reference_case(options.quick)
    wanted = {reference: None}
    for title, cases in series.items():
        wanted |= dict.fromkeys(case.converged for case in cases if "tolerance" in title) | dict.fromkeys(cases)
    # last what compares tolerances, and of it what takes longest
    wanted = sorted(wanted, key=lambda case: (case.solver == "adr", case.tolerance != Case.tolerance))
    results = {}
    for number, case in enumerate(wanted, 1):
        result = result_of(case, f"{number}/{len(wanted)}", options)
        if result is None and options.earlier:
            result = of_earlier_build(options.earlier, case, options.ranks)
        if result is not None:
            results[case] = result
    if not options.dry_run:
        folder = RESULTS.folder / "quick" if options.quick else DOCS
        write_report(folder, series, reference, results, options.ranks)
        print(f"wrote {folder / 'speed_vs_error.md'} from {len(results)} of {len(wanted)} cases")
    return 0


def result_of(case, label, options):
    """The result of a case, run where it is wanted and missing, or was disturbed; None where there is none."""
    key = identity(case, options.ranks)
    result = RESULTS.read(case.name, key)
    again = result and options.busy is not None and result["cores_used_by_others"] > options.busy
    if not (result is None or again) or options.only not in case.name or options.report:
        return result
    print(f"{label} {case.name}", end="\n" if options.dry_run else "", flush=True)
    if options.dry_run:
        return result
    new = {"identity": key, "ranks": options.ranks} | run_case(case, options.ranks)
    if not again or new["cores_used_by_others"] < result["cores_used_by_others"]:
        result = new
        RESULTS.write(case.name, key, result)
    print(f"  {result['sweeps']} sweeps, {result['solve_core_seconds']:.2f} core-seconds", flush=True)
    return result
