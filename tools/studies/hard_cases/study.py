"""The hard cases, run by their tests whole and on all their numbers of ranks: docs/hard_cases.md.

``tests/hard`` judges; this runs its tests on one rank, on two and, for what is meant for more, on eight, and makes the
page from what they tell. Reports stay in runs/hard_cases/; with ``--report`` the page is made from those.
"""

from __future__ import annotations

from typing import Any

from tools.studies.series import DOCS, RUNS, parser_of, properties_of, run_tests, table

FOLDER = RUNS / "hard_cases"
KEY = "hard case"
#: Numbers of ranks, and which of the tests run on them.
RANKS = {1: "", 2: "", 8: "18"}
LONGEST = 330  # characters of what came out

FAMILIES = {
    1: "an interface meets a free edge and a corner",
    2: "a crack runs into the overlap and into a region without damage",
    3: "two cracks become critical at the same load",
    4: "fragments: pieces cut loose, single points without bonds",
    5: "a plate one cell thick, thinner than the cutoff radius",
    6: "internal lengths of half a cell to three cells, cutoff radii of 1.5 to 3.5 of them",
    7: "stiffness contrast 1 : 1000, hard and soft inclusion",
    8: "cells jittered by 15 %, graded 1 : 20, sheared by 45 degrees, of aspect 1 : 10",
    9: "rigid rotation by 10 and 90 degrees, finite kinematics",
    10: "compression by 30 % and tension by 30 %",
    11: "every unit scaled by 1e-9 and 1e+9",
    12: "a body far from the origin, 1e6 times its size",
    13: "nearly mechanisms: a hinge of one cell, a body held at one node",
    14: "bending and torsion of slender bars, relaxation against conjugate gradients",
    15: "load steps of 1e-12 and of ten times the failure load",
    16: "a tolerance at round-off, no load at all",
    17: "the smallest regions, overlaps of one to five layers, one description enclosed by the other",
    18: "one to eight ranks, ranks that own one cell, only elements, only bonds",
    19: "a million broken bonds in one event",
    20: "supports that contradict each other, loads and supports at one place",
    21: "bonds that soften: snap-back, cracks that compete, loose pieces, a ratio of stretches near 1",
    22: "a notch taken out of a beam on rollers, which snaps back",
}

HEAD = """# Hard cases

Bodies and loads that break programs of this kind, in twenty-two families. Each case is solved within the error that
its row states, or refused with the reason and the remedy. Look here for a body like yours: the page says what to
expect, and its deck is a place to begin.

* **Decks** with comments are in `jobs/hard`; `tests/hard/cases.py` has the variants of each and the bound of its error.
* **Expected**: a closed form, a statement of theory, or the direct solution of the same equations by code of its own
  (`tests/support/direct_solution.py`: one sparse matrix, a direct solver, bonds one by one). *Ledger* is `ledger_error`
  of `history.csv`, the balance of work and energies over the work.
* **Error**: relative to the largest displacement, unless the row says otherwise. Displacement fields are kept in single
  precision, so errors of displacements below 1e-7 are not seen.
* **Evaluations** are sweeps over all bonds and elements. **Seconds** are processor time of the whole run on one rank,
  in a process that has loaded the kernels of earlier ones.
* **Verdict**: *solved*, or *refused* with exit code 64 (the deck) or 74 (no equilibrium) and the words that are quoted.
  Every row has only finite numbers, and the same bits on one and two ranks (family 18: on one to eight).

`tools/studies/study hard_cases` runs all cases and writes this page. `tests/hard` runs short forms of them, and the
whole ones with the slow tests.
"""


def collect() -> dict[str, dict[str, Any]]:
    """What the tests told of each whole case, by its name; a failed test makes the verdict FAILED."""
    found: dict[str, dict[str, Any]] = {}
    for passed, told in properties_of(FOLDER / "ranks-1.xml", KEY):
        found[told["case"]] = told | {"verdict": told["verdict"] if passed else "FAILED", "same": set()}
    for ranks in list(RANKS)[1:]:
        for passed, told in properties_of(FOLDER / f"ranks-{ranks}.xml", KEY):
            if told["case"] in found:
                case = found[told["case"]]
                case["same"].update(told["ranks"])
                if not passed:
                    case["verdict"] = "FAILED"
                    case["got"] += f"; other bits on {', '.join(map(str, told['differing']))} ranks"
    return dict(sorted(found.items(), key=lambda item: item[1]["number"]))


def page(found: dict[str, dict[str, Any]]) -> str:
    """The document."""
    verdicts = [case["verdict"] for case in found.values()]
    counts = {verdict: verdicts.count(verdict) for verdict in ("solved", "refused", "FAILED")}
    lines = [HEAD, f"{counts['solved']} cases solved, {counts['refused']} refused by name, {counts['FAILED']} failed."]
    missing = [name for name, case in found.items() if set(case["ranks"]) - case["same"]]
    if missing:
        lines[-1] += f" Not run on all numbers of ranks: {', '.join(missing)}."
    for family, hard in FAMILIES.items():
        rows = [row(case) for case in found.values() if case["family"] == family]
        lines += ["", f"## {family}. {hard[0].upper()}{hard[1:]}", ""]
        lines += table(["case", "expected", "got", "error", "evaluations", "seconds", "verdict"], rows)
    return "\n".join(lines) + "\n"


def row(case: dict[str, Any]) -> list[str]:
    """Cells of a case."""
    error = "-" if case["error"] is None else f"{case['error']:.1e}"
    evaluations = "-" if case["evaluations"] is None else f"{case['evaluations']:,}"
    got = " ".join(case["got"].replace("|", "/").split())
    got = got if len(got) <= LONGEST else got[: LONGEST - 3] + "..."
    ranks = "" if case["ranks"] == [1, 2] else f" ({case['ranks'][0]} to {case['ranks'][-1]} ranks)"
    return [case["case"] + ranks, case["expected"], got, error, evaluations, f"{case['seconds']:.1f}", case["verdict"]]


def main(words: list[str]) -> int:
    """Run the tests, write the page; 1 if a case failed."""
    options = parser_of(__doc__).parse_args(words)
    for ranks, text in RANKS.items():
        chosen = " and ".join(filter(None, (f"{text}:" if text else "", options.only)))
        arguments = ["tests/hard", "-m", "mpi" if ranks > 1 else "not mpi", *(["-k", chosen] if chosen else [])]
        if options.dry_run:
            arguments.append("--collect-only")
        if not options.report:
            run_tests(FOLDER / f"ranks-{ranks}.xml", *arguments, ranks=ranks)
    if options.dry_run:
        return 0
    found = collect()
    if options.report or not options.only:
        (DOCS / "hard_cases.md").write_text(page(found), encoding="utf-8")
        print(f"wrote docs/hard_cases.md from {len(found)} cases")
    failed = [name for name, case in found.items() if case["verdict"] == "FAILED"]
    print(f"{len(failed)} failed" + "".join(f"\n  {name}" for name in failed))
    return int(bool(failed))
