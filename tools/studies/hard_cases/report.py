"""docs/hard_cases.md from the stored results of the hard cases."""

from __future__ import annotations

from typing import Any

from hard_suite import FAMILIES
from hard_table import CASES

HEAD = """# Hard cases

Twenty families of bodies and loads that break programs of this kind, each one solved within the stated error or refused
by name, with the reason and the remedy. `tools/hard_cases` runs all of them on one and two ranks (family 18: on one to
eight) and writes this page; the decks with their comments are in `jobs/hard`, the table of variants in
`tools/hard_table.py`. Short forms are default tests (`tests/verification/test_hard_cases.py`).

* **Expected**: a closed form, a statement of theory, or the direct solution of the same equations by another program
  (`tools/hard_reference.py`: one sparse matrix, a direct solver, bonds one by one). Errors are relative to the largest
  displacement unless the row says otherwise; displacement fields are kept in single precision, so errors below 1e-7 are
  not seen.
* **Verdict**: *solved*, or *refused* with exit code 64 (the deck) or 74 (no equilibrium) and the words that are quoted.
  Every row has the same bits on all its numbers of ranks, finite numbers only, no traceback, and ends within its time
  limit.
* Evaluations are sweeps over all bonds and elements; seconds are those of the whole run on one rank, start of Python
  included.
"""


def report(results: dict[str, dict[str, Any]]) -> str:
    """The page."""
    verdicts = [result["verdict"] for result in results.values()]
    counts = {verdict: verdicts.count(verdict) for verdict in ("solved", "refused", "FAILED")}
    missing = len(CASES) - len(results)
    lines = [HEAD, f"{counts['solved']} cases solved, {counts['refused']} refused by name, {counts['FAILED']} failed"]
    lines[-1] += f", {missing} not run." if missing else "."
    for family, hard in FAMILIES.items():
        lines += ["", f"## {family}. {hard[0].upper()}{hard[1:]}", ""]
        lines += ["| case | expected | got | error | evaluations | seconds | verdict |", "|" + 7 * "---|"]
        for case in CASES:
            if case.family == family and case.name in results:
                lines.append(_row(case, results[case.name]))
    return "\n".join(lines) + "\n"


def _row(case, result: dict[str, Any]) -> str:
    error = "-" if result["error"] is None else f"{result['error']:.1e}"
    evaluations = "-" if result["evaluations"] is None else f"{result['evaluations']:,}"
    got = " ".join(result["got"].replace("|", "/").split())
    got = got if len(got) <= 330 else got[:327] + "..."
    seconds = result["seconds"][str(result["ranks"][0])]
    ranks = "" if result["ranks"] == [1, 2] else f" ({result['ranks'][0]} to {result['ranks'][-1]} ranks)"
    cells = (case.name + ranks, case.expected, got, error, evaluations, f"{seconds:.1f}", result["verdict"])
    return "| " + " | ".join(cells) + " |"
