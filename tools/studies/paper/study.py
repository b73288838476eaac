"""The cases of the paper's figures: docs/paper.md, with claim, paper's value, ours, exact, remark, and the figures.

Without options the cases are coarse (a minute on two cores) and everything goes to runs/figures/coarse/. With
``--full`` they have the paper's size, docs/paper.md and docs/figures/paper_*.png are written. What is told of small
bodies is measured by a test of ``tests/paper``, whose report stays beside the runs.
"""

from __future__ import annotations

import os
import time
from pathlib import Path
from typing import Any

from tools.studies.members import run_series
from tools.studies.paper.bar_table import bar_table
from tools.studies.paper.cases import make_series
from tools.studies.paper.report import unfinished, write_report
from tools.studies.series import DOCS, INTERRUPTED, RUNS, parser_of, properties_of, run_tests

TESTS = "tests/paper/test_numbers_of_the_document.py"
INCOMPLETE = 70


def measured_by_tests(size: str, folder: Path, again: bool) -> dict[str, Any]:
    """What the test of this size told; it is run where there is no report, or ``again``."""
    report = folder / "small_bodies.xml"
    if again or not report.exists():
        run_tests(report, TESTS, "-k", size, "-m", "slow or not slow")
    return next((told for passed, told in properties_of(report, f"paper, {size}") if passed), {})


def main(words: list[str]) -> int:
    """Run what is left, and write the document."""
    parser = parser_of(__doc__, full="the paper's size; writes into docs/ when all is there")
    parser.add_argument("--ranks", type=int, default=2, help="ranks of each run")
    parser.add_argument("--again", action="store_true", help="measure the small bodies again")
    parser.add_argument(
        "--bar", nargs="*", metavar="KEY=VALUE", help="print the table of docs/paper_bar.md instead, keys set"
    )
    options = parser.parse_args(words)
    if options.bar is not None:
        print("\n".join(bar_table([f"--set={pair}" for pair in options.bar])))
        return 0
    started, spent = time.perf_counter(), os.times()
    size = "full" if options.full else "coarse"
    runs, series, code = RUNS / "figures" / size, make_series(options.full), 0
    for item in series:
        if options.only in item.name and not options.report:
            code = run_series(item, runs / item.name, options.ranks, options.dry_run) or code
            if code == INTERRUPTED:
                return code
    if options.dry_run:
        return 0
    measured = measured_by_tests(size, runs, options.again and not options.report)
    missing = unfinished(series, runs) + ([] if measured else ["the small bodies were not measured"])
    for what in missing:
        print(f"paper: {what}")
    # a document with holes does not replace a complete one
    into_docs = options.full and not missing
    text, figures = (DOCS, DOCS / "figures") if into_docs else (runs, runs / "figures")
    write_report(text / "paper.md", figures, series, runs, measured, options.full)
    now = os.times()
    cpu = sum(getattr(now, n) - getattr(spent, n) for n in ("user", "system", "children_user", "children_system"))
    print(f"wrote {text / 'paper.md'} ({time.perf_counter() - started:.0f} s, {cpu:.0f} core-seconds)")
    return code or (INCOMPLETE if missing else 0)
