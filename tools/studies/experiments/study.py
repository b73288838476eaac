"""Published experiments, run at two cell sizes and two internal lengths, and numerical references: docs/experiments.md.

Each run has a folder in runs/experiments/. ``--fine`` adds fine cells of paths, and of tests at half of the thickness;
``--only`` chooses by name. The page lists the rows that were not run; with ``--keep`` those of its rows stay whose runs
are not here.
"""

from __future__ import annotations

import resource
from collections.abc import Sequence

from tools.studies.experiments.cases import EXPERIMENTS, FOLDER, PATHS, SLICE, Case, Experiment, cases
from tools.studies.experiments.curves import Curve, inside, path_distance, read_curve, read_measured, read_path, rms
from tools.studies.experiments.drawing import draw_loads, label_of
from tools.studies.experiments.overview import off, overview_table
from tools.studies.experiments.peers import PANEL, Outcome, panel_table
from tools.studies.experiments.references import Reference, references
from tools.studies.series import DOCS, Results, fill, kept, parser_of, run_deck, summary_of, table

DOCUMENT = DOCS / "experiments.md"
FIGURES = DOCS / "figures" / "experiments"
#: So many cells of a row tell it from others.
KEYS = {"tests": 2, "panel": 2, "paths": 2, "references": 1}
#: What every run cost: processor seconds with start-up, and memory.
COSTS = Results(FOLDER / "costs")


def run(case: Case | Reference) -> None:
    """Run a case, and keep what it cost."""
    before = resource.getrusage(resource.RUSAGE_CHILDREN)
    deck, settings = (
        (case.deck, case.settings) if isinstance(case, Reference) else (case.experiment.name, case.overrides())
    )
    done = run_deck(f"experiments/{deck}.toml", settings, case.folder, "--overwrite", check=False)
    if done.returncode:
        print(f"{case.name} gave no result:\n{done.stdout[-500:]}{done.stderr[-500:]}", flush=True)
        return
    after = resource.getrusage(resource.RUSAGE_CHILDREN)
    seconds = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    COSTS.write(case.name, None, {"processor_seconds": seconds})


def row_of(case: Case) -> list[str] | None:
    """One row of the table of tests; None without a run."""
    curve, experiment = read_curve(case), case.experiment
    if curve is None:
        return None
    measured = read_measured(experiment.measured)
    peak, at = curve.peak
    seconds = cost_of(case)
    told, error, fit = compared(curve, experiment, measured)
    work = f"{curve.work / (energy_of(case) * experiment.ligament * experiment.thickness):.2f}"
    fit, work = ("", "") if case.short else (fit, work)
    return [
        experiment.title, words_of(case), told, f"{peak:,.0f} at {at:.3g}",
        error, fit, work, f"{seconds:,.0f}" if seconds else "", f"{memory_of(case):.0f}",
    ]  # fmt: skip


def words_of(case: Case) -> str:
    """The model of a case."""
    words = f"cells {case.spacing:.3g}, l {case.internal:.3g}, {case.body}"
    return words + (f", {case.material}" if case.material else "")


def cost_of(case: Case | Reference) -> float:
    """Processor seconds of a run, 0 where they were not kept."""
    return (COSTS.read(case.name) or {}).get("processor_seconds", 0.0)


def memory_of(case: Case) -> float:
    """Peak memory of a run, MiB."""
    return max(summary_of(case.folder)["memory"]["peak_bytes_per_rank"]) / 2**20


def outcome_of(words: str, case: Case) -> Outcome | None:
    """A run as a row beside other programs; None without one."""
    curve = read_curve(case)
    if curve is None:
        return None
    return Outcome(words, case.internal, case.spacing, *curve.peak, cost_of(case), memory_of(case))


def energy_of(case: Case) -> float:
    """Fracture energy of the material of a case."""
    sets = case.experiment.sets.get(case.material, {})
    return float(sets.get("material.fracture_energy", case.experiment.energy))


def compared(curve: Curve, experiment: Experiment, measured) -> tuple[str, str, str]:
    """Measured peak, the error of ours, and how well the whole curve fits, in words."""
    if measured is None:
        return "missing", "", ""
    at, *loads = measured.values()
    if len(loads) == 2:
        # the mean specimen lies in the middle of the band
        k = max(range(len(at)), key=lambda i: loads[0][i] + loads[1][i])
        good, whole = inside(curve, measured)
        told = f"{max(loads[0]):,.0f} to {max(loads[1]):,.0f} at {at[k]:.3g}"
        return told, off(curve, measured), f"{good} of {whole} inside"
    k = int(loads[0].argmax())
    difference, last = rms(curve, measured)
    told = f"{loads[0][k]:,.0f} at {at[k]:.3g}"
    return told, off(curve, measured), f"{100.0 * difference:.1f} % to {last:.2g}"


def table_of(chosen: Sequence[Case]) -> list[str]:
    """All tests with a run."""
    head = [
        "test", "model", "measured peak / N at / mm", "ours", "error", "rms of the curve, or points in the band",
        "work / G_f A", "processor s", "MiB",
    ]  # fmt: skip
    order = {name: k for k, name in enumerate(EXPERIMENTS)}
    ranked = sorted(chosen, key=lambda case: order[case.experiment.name])
    return table(head, [row for case in ranked if case.experiment not in PATHS and (row := row_of(case)) is not None])


def paths_table(chosen: Sequence[Case]) -> list[str]:
    """Distances of paths from the measured one."""
    rows = []
    for case in chosen:
        if case.experiment not in PATHS or read_curve(case) is None or (path := read_path(case)) is None:
            continue
        measured = read_measured(case.experiment.measured)
        far = "missing" if measured is None else f"{path_distance(path, measured):.1f}"
        rows.append([case.experiment.title, words_of(case), far, f"{cost_of(case):,.0f}"])
    return table(["path", "model", "largest distance from the measured path / mm", "processor s"], rows)


def against(load: float, low: float, high: float) -> tuple[str, str]:
    """An answer, and what a load is beside it, in words."""
    if low == high:
        return f"{low:.4g}", f"{100.0 * (load / low - 1.0):+.1f} %"
    return f"{low:.4g} to {high:.4g}" if low else f"below {high:.4g}", "within" if low <= load <= high else "outside"


def references_table() -> list[str]:
    """Bodies whose failing load a formula or a bound knows."""
    rows = []
    for one in references():
        if (load := one.load()) is None:
            continue
        answer, error = against(load, *one.answer)
        rows.append([
            f"`{one.deck}.toml`, {one.words}", f"{answer} {one.unit} ({one.told})", f"{load:.4g}", error,
            f"{cost:,.0f}" if (cost := cost_of(one)) else "",
        ])  # fmt: skip
    return table(["reference", "answer", "ours", "error", "processor s"], rows)


def left_table(everything: Sequence[Case], told: str) -> list[str]:
    """The rows of the study that were not run, by experiment; ``told`` are the lines of the other tables."""
    missing: dict[str, list[str]] = {}
    for case in everything:
        if f"| {case.experiment.title} | {words_of(case)} |" not in told:
            words = label_of(case, ("half", "slice")) + (", peak only" if case.short else "")
            missing.setdefault(case.experiment.title, []).append(words)
    for one in references():
        if f"| `{one.deck}.toml`, {one.words} |" not in told:
            missing.setdefault(f"`{one.deck}.toml`", []).append(one.words)
    return table(["test", "not run"], [[title, "; ".join(words)] for title, words in missing.items()])


def draw(experiment: Experiment, chosen: Sequence[Case]) -> None:
    """The figure of one experiment."""
    mine = [case for case in chosen if case.experiment is experiment and not case.short]
    done = {case: curve for case in mine if (curve := read_curve(case))}
    if not done:
        return
    bodies = sorted({case.body for case in done})
    labels = {case: label_of(case, bodies) for case in done}
    paths = {labels[case]: path for case in done if experiment.path and (path := read_path(case)) is not None}
    measured = read_measured(experiment.measured)
    traced = measured if experiment in PATHS else None
    draw_loads(
        FIGURES / f"{experiment.name}.svg",
        experiment,
        {labels[case]: curve for case, curve in done.items()},
        None if experiment in PATHS else measured,
        paths,
        traced,
    )


def main(arguments: Sequence[str]) -> int:
    """Run what is left, fill the tables and draw the figures."""
    parser = parser_of(
        __doc__,
        fine="fine cells of paths, and of tests at half of the thickness, too",
        keep="keep rows and figures whose runs are not here",
    )
    options = parser.parse_args(arguments)
    everything = cases(fine=True)
    for case in [*cases(options.fine), *references()]:
        if options.only not in case.name or summary_of(case.folder).get("exit_code") == 0:
            continue
        print(case.name, flush=True)
        if not (options.dry_run or options.report):
            run(case)
    if options.dry_run:
        return 0
    tables = {"tests": table_of(everything), "paths": paths_table(everything), "references": references_table()}
    if (measured := read_measured(PANEL.measured)) is not None:
        _, load = measured.values()
        tables["panel"] = panel_table(float(load.max()), outcome_of)
    if options.keep:
        tables = {name: kept(lines, DOCUMENT, name, KEYS[name]) for name, lines in tables.items()}
    told = "\n".join(line for lines in tables.values() for line in lines)
    if not (options.keep and any(read_curve(case) is None for case in cases(fine=False))):
        tables["overview"] = overview_table(read_curve)
    fill(DOCUMENT, tables | {"left": left_table(everything, told)})
    for experiment in EXPERIMENTS.values():
        if not (options.keep and any(read_curve(case) is None for case in whole_curves(experiment))):
            draw(experiment, everything)
    return 0


def whole_curves(experiment: Experiment) -> list[Case]:
    """The runs that a figure must have to be drawn anew beside kept ones."""
    return [
        case for case in cases(fine=False) if case.experiment is experiment and case.body == SLICE and not case.short
    ]
