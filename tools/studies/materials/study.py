"""Bonds of any Poisson's ratio beside exact fields: a table of docs/materials.md.

``tests/verification/test_exact_fields.py`` measures and judges; this runs its tests, the slow ones too (minutes),
and fills the page from what they tell. The report stays in runs/materials/; with ``--report`` the page is made from it.
"""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

from tools.studies.series import DOCS, RUNS, fill, parser_of, properties_of, run_tests, table

REPORT = RUNS / "materials" / "tests.xml"
KEY, TESTS = "materials", "tests/verification/test_exact_fields.py"
PAGE = DOCS / "materials.md"


def by(rows: Iterable[dict[str, Any]], *keys: str) -> dict[tuple, dict[str, Any]]:
    """Rows by some of their columns."""
    return {tuple(row[key] for key in keys): row for row in rows}


def of_ratios(found: dict[str, list[dict[str, Any]]]) -> list[str]:
    """What breaks first: one column for each Poisson's ratio."""
    holes, bars = by(found["hole"], "nu"), by(found["strength"], "nu", "width")
    ratios = sorted({row["nu"] for row in found["strength"]})
    rows = [["largest stretch at a hole, over that of the exact field"]]
    rows[0] += [f"{holes[(nu,)]['ratio']:.3f}" if (nu,) in holes else "-" for nu in ratios]
    for width in sorted({row["width"] for row in found["strength"]}):
        row = [f"strength of a bar of {width} x {width} cells, over `E s_0`"]
        rows.append(row + [f"{bars[nu, width]['ratio']:.3f}" for nu in ratios])
    return table(["nu", *(f"{nu:g}" for nu in ratios)], rows)


def main(words: list[str]) -> int:
    """Run the tests, fill the page; the tests' exit code."""
    options = parser_of(__doc__).parse_args(words)
    arguments = [TESTS, *(["-k", options.only] if options.only else [])]
    if options.dry_run:
        return run_tests(REPORT, *arguments, "--collect-only")
    code = 0 if options.report else run_tests(REPORT, *arguments)
    found: dict[str, list[dict[str, Any]]] = {}
    for _, told in properties_of(REPORT, KEY):
        found.setdefault(told["table"], []).append(told)
    if options.report or not options.only:
        fill(PAGE, {"ratios": of_ratios(found)})
        print(f"filled the tables of {PAGE.name}")
    return code
