"""The page and the figure of ``tools/studies/study speed_vs_error``: errors, Pareto front, recommendations, tables.

A *result* is what ``tools/studies/study speed_vs_error`` keeps of a run; a *case* its settings. Nothing is run here.
"""

import math
import platform
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tools.studies.speed_vs_error.cases import COUPLED, FLOOR, MODES, mode
from tools.studies.speed_vs_error.drawing import draw

BAR_END = 5.0e-3  # exact displacement of the bar's end face: strain 1e-3 over half its 10 in
LEVELS = (5.0, 3.0, 1.0, 0.1)  # percent
SCATTER = 0.1  # of the times of one case
GAIN = 0.01  # what a dearer case on the front must take off the error
BUSY_CORES = 0.2  # others' share of the processor above which a time is marked
MODELS = {
    "fe": "elements",
    "pd": "peridynamics",
    "paper": "coupled, reading B",
    "paper_a": "coupled, reading A",
}


@dataclass(frozen=True)
class Row:
    """A case with what the page says about it; errors in percent, None where unknown."""

    case: object
    result: dict
    error: float | None
    hole_error: float | None
    solver_error: float | None

    @property
    def sweeps(self) -> int:
        """Evaluations of all forces."""
        return self.result["sweeps"]

    @property
    def share(self) -> float:
        """Part of the ranks' wall time in which they had the processor: 1 but where other work used more than a little.

        What idle cores could not take of the others' use was taken from the ranks.
        """
        others, ranks = self.result["cores_used_by_others"], self.result["ranks"]
        if others <= BUSY_CORES:
            return 1.0
        return 1.0 - max(0.0, others - (self.result.get("cores", ranks) - ranks)) / ranks

    @property
    def solve(self) -> float:
        """Core-seconds of the solve."""
        return self.share * self.result["solve_core_seconds"]

    @property
    def total(self) -> float:
        """Core-seconds of set-up and solve."""
        return self.share * self.result["setup_core_seconds"] + self.solve


def pareto_front(costs, errors, gain=0.0) -> list[int]:
    """Return the indices of the points that no other beats in both numbers, cheapest first.

    Of points that are equal in both, the first stays. A point whose error or cost is None or NaN is never on it. With a
    ``gain``, a dearer point must lower the error by more than this part of it: times scatter.
    """
    known = [
        i
        for i, pair in enumerate(zip(costs, errors, strict=True))
        if all(value is not None and not math.isnan(value) for value in pair)
    ]
    front: list[int] = []
    for i in sorted(known, key=lambda i: (costs[i], errors[i], i)):
        if not front or errors[i] < (1.0 - gain) * errors[front[-1]]:
            front.append(i)
    return front


def front_of(rows) -> list[Row]:
    """Return the rows on the front of those with bonds, cheapest first; errors below ``FLOOR`` count as that."""
    rows = [row for row in rows if row.case.model != "fe"]
    errors = [None if row.error is None else max(row.error, FLOOR) for row in rows]
    return [rows[i] for i in pareto_front([row.total for row in rows], errors, GAIN)]


def table(header, rows) -> str:
    """Return a Markdown table; cells are texts, None is an empty place."""
    for row in rows:
        if len(row) != len(header):
            raise ValueError(f"a row of {len(row)} cells under {len(header)} headings: {row}")
    lines = [header, ["---"] * len(header), *rows]
    return "".join(
        "| " + " | ".join("-" if cell is None else str(cell).replace("|", "\\|") for cell in line) + " |\n"
        for line in lines
    )


def cheapest(rows, level):
    """Return the cheapest row whose error is at most a level, or None.

    Of rows within ``SCATTER`` of the cheapest, the one with the smallest error (to two digits) and the fewest sweeps.
    """
    reached = [row for row in rows if row.error is not None and row.error <= level]
    if not reached:
        return None
    limit = (1.0 + SCATTER) * min(row.total for row in reached)
    return min((row for row in reached if row.total <= limit), key=lambda row: (float(f"{row.error:.1e}"), row.sweeps))


def displacements(body, probes) -> np.ndarray:
    """What errors are measured on, free of rigid motion; float64, dimension length.

    Bar: the end of the bar as the bar probe sees it. Plate: end and top of the hole, by symmetry at rest about the
    middle.
    """
    if body == "bar":
        return np.array([probes["end_displacement"]])
    return np.array([probes["right_end"][0], probes["top_of_hole"][1]])


def make_row(case, results, reference) -> Row | None:
    """Return the errors of a case, or None where it has no result or did not converge.

    The error is that of the converged case plus what the solver left: a body that is too soft, relaxed by half, would
    else be right by accident.
    """
    result = results.get(case)
    if result is None or result["status"] != "finished":
        return None
    u = displacements(case.body, result["probes"])
    best, solver = u, None
    if case != case.converged and case.converged in results:
        best = displacements(case.body, results[case.converged]["probes"])
        scale = BAR_END if case.body == "bar" else float(np.linalg.norm(best))
        solver = 100.0 * float(np.linalg.norm(u - best)) / scale
    error = hole = None
    if case.body == "bar":
        bias = result["probes"]["end_error_percent"] - 100.0 * float(u[0] - best[0]) / BAR_END
        error = abs(bias) + (solver or 0.0)
    elif reference in results:
        exact = displacements("plate", results[reference]["probes"])
        error = 100.0 * float(np.linalg.norm(best - exact) / np.linalg.norm(exact)) + (solver or 0.0)
        hole = 100.0 * abs(best[1] - exact[1]) / abs(exact[1])
    return Row(case, result, error, hole, solver)


def enough(rows, level, solver):
    """Return the loosest tolerance that, like all tighter ones, leaves at most a tenth of a level, or None."""
    loosest = None
    known = [row for row in rows if row.solver_error is not None and row.case.solver == solver]
    for tolerance in sorted({row.case.tolerance for row in known}):
        if any(row.solver_error > level / 10 for row in known if row.case.tolerance == tolerance):
            break
        loosest = tolerance
    return loosest


def may_break(case) -> bool:
    """Whether the program lets bonds of this case break: fitted factors of free signs are refused."""
    return case.model != "fe" and mode(case) != "fitted"


NEEDS = {
    "bonds everywhere": lambda case: case.model == "pd" and may_break(case),
    "bonds in a part": lambda case: case.model in COUPLED and may_break(case),
    "bonds that never break": lambda case: case.model != "fe" and not may_break(case),
    "elements only": lambda case: case.model == "fe",
}


def settings(case) -> str:
    """Return a case in words, without what is the default."""
    exact = case.model in COUPLED and case.correction == "fitted"
    words = ["coupled, exact" if exact else MODELS[case.model], f"spacing {case.spacing:g}"]
    for field, label in (("internal_length", "l/Delta"), ("cutoff", "r_c/l")):
        if case.differs(field):
            words.append(f"{label} {getattr(case, field)}")
    if MODES[mode(case)][0]:
        words.append(MODES[mode(case)][0])
    if case.fit == "found":
        words.append("fit found")
    if case.interface is not None:
        words.append(f"peridynamics {region(case)}")
    if case.differs("kinematics"):
        words.append("finite kinematics")
    return ", ".join([*words, f"{case.solver} to {power(case.tolerance)}"])


def region(case) -> str:
    """Return where the peridynamic region of a coupled case is."""
    if case.body == "bar":
        return f"x > {case.interface or 0.0:g}"
    return f"|x| < {2.0 if case.interface is None else case.interface:g}"


def power(value) -> str:
    """Return 1e-6 rather than 1e-06."""
    return f"{value:.0e}".replace("e-0", "e-")


def percent(value) -> str | None:
    """Return an error with two or three digits."""
    if value is None:
        return None
    return f"{value:.2f}" if value >= 0.1 else f"{value:.1e}".replace("e-0", "e-")


def seconds(value) -> str:
    """Return a time with two or three digits."""
    return f"{value:.2f}" if value < 10 else f"{value:.0f}"


def write_report(folder, series, reference, results, ranks) -> None:
    """Write ``speed_vs_error.md`` and ``figures/speed_vs_error.svg`` into a folder."""
    rows = {}
    for case in results:
        row = make_row(case, results, reference)
        if row is not None:
            rows[case] = row
    bodies = {
        body: [row for case, row in rows.items() if case.body == body and case != reference]
        for body in ("bar", "plate")
    }
    fronts = {body: front_of(row for row in of_body if row.case.fit == "fresh") for body, of_body in bodies.items()}
    with_found = {body: front_of(of_body) for body, of_body in bodies.items()}
    folder = Path(folder)
    (folder / "figures").mkdir(parents=True, exist_ok=True)
    draw(folder / "figures" / "speed_vs_error.svg", bodies, fronts, with_found)
    parts = [opening(results, ranks)]
    for body in bodies:
        parts += [recommendations(body, bodies[body]), front_table(body, fronts[body])]
    for title, cases in series.items():
        parts.append(series_table(title, cases, rows, results, fronts, with_found))
    path = folder / "speed_vs_error.md"
    path.with_suffix(".tmp").write_text("\n".join(parts))
    path.with_suffix(".tmp").replace(path)


def opening(results, ranks) -> str:
    """Return what the numbers are and where they come from."""
    busy = sum(result["cores_used_by_others"] > BUSY_CORES for result in results.values())
    idle = "Nothing else used the processor meanwhile."
    if busy:
        idle = f"""Other work used more than {BUSY_CORES} of a core in {busy} of the
runs; the share of the processor that it took is taken off their times, which are marked `~`."""
    earlier = sum(result.get("earlier_build", False) for result in results.values())
    if earlier:
        idle += f"""
{earlier} of the runs, marked `^`, are of an earlier build."""
    return f"""# Speed against error

Written by `tools/studies/study speed_vs_error`: {len(results)} runs of the decks of the paper's bar (section 4.1) and
plate with a hole (section 4.2) on {ranks} ranks, {processor()}. {idle}

![Error against core-seconds, and solver error against sweeps](figures/speed_vs_error.svg)

* **Error**, bar: of the end displacement against the exact one, in percent. Plate: of the displacements of the end and
  of the top of the hole together (root of the sum of squares), against finite elements at the finest spacing; "hole" is
  that of the hole alone. So the error holds what the model differs from classical elasticity (about 5 % where all is
  bonds with the correction of appendix A), what the cells are too coarse for, and what the solver left. The last is
  added to the others, never taken off: bonds that are too soft, relaxed by half, would else look right.
* **Solver error**: difference to the same case solved by `cg` to 1e-10, in percent. The tolerances recommended leave at
  most a tenth of the level in every case of the last table. They are for these displacements, which do the work of the
  loads: of it conjugate gradients leave about the square of the residual, of other numbers more. Where bonds may
  break, take 1e-4 or less.
* **Sweeps**: evaluations of all forces. **Core-seconds**: ranks times wall seconds, of the solve alone and of set-up
  and solve. Kernels are compiled before.
* **Modes**: bonds with the correction of appendix A, with none, with that of the virial stress, or with fitted factors
  of free signs or positive ones; fitted bonds are coupled exactly. "core-s all" of fitted factors holds the fit, but in
  rows named "fit found", where an earlier run had left it: another load case of the same body. Free signs are refused
  where bonds may break. Ends of fitted bonds are pulled by tractions, all others by the paper's body forces in the last
  layer of cells.
* Unless a row says otherwise: `cg` to 1e-6, linear kinematics, l = Delta, r_c = 2.5 l, correction of appendix A; in
  coupled cases bonds at x > 0 of the bar or |x| < 2 of the plate.
* **Front**: cases with bonds that no other case with bonds beats in both error and core-seconds, fits counted ("yes");
  "found" where a case is on it only if fits are found from before. Errors below {FLOOR:g} % count as that. Elements
  alone are cheaper, and cannot break. Where bonds go is not a free choice: wherever the body may break. The series over
  the region's size tell what a larger one costs.
* **float32**: bonds are always stored in float32 (K and 1/r0^2) and computed in float64; there is no other storage to
  compare with, so no series. The rounding changes forces by at most 5e-8 of the largest (`docs/performance.md`; a test
  holds it below 1e-7): about 1e-5 percent, below every error of a case with bonds. Both sides of a
  solver error share it.
"""


def processor() -> str:
    """Return the name of the processor, as far as the system tells."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
        return next(line.split(":")[1].strip() for line in lines if line.startswith("model name"))
    except (OSError, StopIteration):
        return platform.processor() or platform.machine()


def recommendations(body, rows) -> str:
    """Return one line for each error level."""
    lines = []
    for level in LEVELS:
        line = [f"**{level:g} %**"]
        for suits in NEEDS.values():
            chosen = [row for row in rows if suits(row.case) and row.case.fit == "fresh" and row.error is not None]
            row = cheapest(chosen, level)
            if row is not None:
                line.append(f"{settings(row.case)}: {percent(row.error)} %, {seconds(row.total)} core-s")
            else:
                best = min(chosen, key=lambda row: row.error, default=None)
                line.append(best and f"not reached; best {percent(best.error)} %, {settings(best.case)}")
        loosest = [(solver, enough(rows, level, solver)) for solver in ("cg", "adr")]
        line.append(", ".join(f"{solver} {power(tolerance)}" for solver, tolerance in loosest if tolerance))
        lines.append(line)
    return f"## {body.capitalize()}: what to use\n\n" + table(["error", *NEEDS, "tolerance"], lines)


def front_table(body, front) -> str:
    """Return the Pareto front of the cases with bonds."""
    rows = [[settings(r.case), *_costs(r), percent(r.error)] for r in front]
    heading = f"### Pareto front, cases with bonds ({body})\n\n"
    return heading + table(["case", "sweeps", "core-s solve", "core-s all", "error %"], rows)


def series_table(title, cases, rows, results, fronts, with_found) -> str:
    """Return the table of one series."""
    body = title.split(":")[0]
    plate, solver, correction = body == "plate", "tolerance" in title, "correction" in title
    header = ["case", "bonds", *(["fit's sweeps"] if correction else []), "sweeps", "core-s solve", "core-s all"]
    header += ["error %"]
    header += (["hole %"] if plate else []) + (["solver error %"] if solver else []) + ["front"]
    lines = []
    for case in dict.fromkeys(cases):
        row = rows.get(case)
        if row is None:
            reason = "not converged" if case in results else "not run"
            lines.append([settings(case), reason, *[None] * (len(header) - 2)])
            continue
        line = [settings(case), f"{row.result['counts']['undirected_bonds']:,}"]
        line += [fit_sweeps(row)] if correction else []
        line += [*_costs(row), percent(row.error)]
        line += ([percent(row.hole_error)] if plate else []) + ([percent(row.solver_error)] if solver else [])
        on_front = "**yes**" if row in fronts[body] else "found" if row in with_found[body] else ""
        lines.append([*line, on_front])
    notes = sorted({note for case in cases if case in rows for note in results[case]["notes"]})
    return f"## {title[0].upper()}{title[1:]}\n\n" + table(header, lines) + "".join(f"\nLog: {n}\n" for n in notes)


def fit_sweeps(row) -> str:
    """Return the sweeps of a fit that the row's time holds; empty without one."""
    if row.case.correction != "fitted":
        return ""
    return "0" if row.case.fit == "found" else f"{row.result['fit']['sweeps']:,}"


def _costs(row):
    mark = "~" if row.result["cores_used_by_others"] > BUSY_CORES else ""
    sweeps = f"{row.result['sweeps']:,}" + ("^" if row.result.get("earlier_build") else "")
    return [sweeps, mark + seconds(row.solve), mark + seconds(row.total)]
