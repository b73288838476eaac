"""Bodies with corners and refined cells broken by several rules and corrections: docs/failure.md.

A refined hole, a square notch and two holes, each coarse, with cells of half the edge at the same internal length, and
with half the internal length as well. Each case leaves a file in runs/criterion_study/; one of the same settings is
kept. ``--full`` adds the largest references. A case without a result is marked in its table.
"""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import islice
from typing import Any

import numpy as np

from pdfem_mpi import Simulation
from tools.studies.failure_criterion.bodies import BODIES, STRETCH, THICKNESS, make_scene, weights
from tools.studies.series import DOCS, RUNS, Results, fill, parser_of, table

RESULTS = Results(RUNS / "criterion_study")
FIGURE = DOCS / "figures" / "failure_criterion.svg"
VERSION = 1  # counts up when cases mean something else
BULK = 27.0 * np.sqrt(np.pi) / 16.0 * (2.0 / 3.0) * 0.971457  # G_c / (E l s_0^2) of the bulk, cutoff 2.5 l
RULES = ("all", "g>=0.1", "g>=0.5", "0.3<=g<=3", "r>=0.5", "r>=0.5 and g>=0.1", "depth", "capped", "energy")
PROGRAMS_OWN = "r>=0.5"  # what `Failure.nearest` does
CORRECTIONS = ("none", "appendix_a", "virial", "fitted")
PLATES = ("hole", "notch", "two holes")


@dataclass(frozen=True)
class Case:
    """One body, mesh, internal length, correction and rule; ``only_first``: to the first break and no further."""

    body: str
    h: float
    length: float
    correction: str
    rule: str = "all"
    only_first: bool = False
    full: bool = False

    @property
    def name(self) -> str:
        """Of its file."""
        parts = (self.body, f"{self.h:g}", f"{self.length:g}", self.correction, self.rule)
        return "-".join(parts).replace(" ", "_").replace(">=", "_").replace("<=", "_")

    @property
    def mirrored(self) -> bool:
        """Whether only a part of the body is computed: fitted factors need all of it."""
        return self.correction != "fitted"


STRIPS = tuple(
    Case("strip", h, length, correction, only_first=True)
    for h, length in ((1.0, 1.0), (0.5, 0.5), (0.5, 1.0))
    for correction in CORRECTIONS
    if correction != "fitted" or length == h
)
MODELS = tuple(Case(body, 1.0, 1.0, correction) for body in PLATES for correction in CORRECTIONS)
REFINED = tuple(
    Case(body, 0.5, length, correction, full=body == "two holes" or (correction == "fitted" and body != "hole"))
    for body in PLATES
    for length, correction in ((0.5, "virial"), (1.0, "virial"), (0.5, "fitted"))
)
FINEST = tuple(
    Case(body, 0.25, length, "virial", only_first=True, full=length == 1.0)
    for body, length in (("hole", 0.25), ("notch", 0.25), ("hole", 1.0))
)
#: All rules at the hole; elsewhere those that made a difference there.
RULED = tuple(Case("hole", 1.0, 1.0, "fitted", rule) for rule in RULES if rule != "all")
RULED += (Case("notch", 1.0, 1.0, "fitted", "r>=0.5"), Case("two holes", 1.0, 1.0, "fitted", "r>=0.5", only_first=True))
RULED += tuple(Case(body, 1.0, 1.0, "fitted", "energy", full=body == "two holes") for body in PLATES[1:])
RULED += (Case("hole", 0.5, 0.5, "fitted", "r>=0.5", only_first=True),)
CASES = STRIPS + MODELS + REFINED + FINEST + RULED


def identity(case: Case) -> dict[str, Any]:
    """What a result depends on."""
    return {"version": VERSION, "case": asdict(case) | {"full": False}}


def read(case: Case) -> dict | None:
    """What a case gave; None where it has not run with these settings."""
    return RESULTS.read(case.name, identity(case))


def run(case: Case) -> dict:
    """Break the body; loads are stresses in the gross section over ``E s_0``, energies those over the ligament's."""
    began = time.process_time()
    meshes = RESULTS.folder / "meshes"
    meshes.mkdir(parents=True, exist_ok=True)
    scene = make_scene(case.body, case.h, case.length, case.correction, case.mirrored, meshes)
    simulation = Simulation(scene, caches=(RESULTS.folder / "fits",))
    simulation.failure.nearest = 0.5 * case.h / case.length if case.rule == PROGRAMS_OWN else 0.0
    bonds, fitted = simulation.bonds(), simulation.model.body_fit
    fit = fitted.fit if fitted else None
    known = {"bonds": len(bonds.points), "fit_residual": fit.residual if fit else None}
    known["largest_factor"] = fit.largest_factor if fit else None
    if case.body == "strip":
        known["fracture_energy"] = own_fracture_energy(case, bonds)
    else:
        if case.rule not in ("all", PROGRAMS_OWN):
            simulation.weigh_stretches(*weights(case.rule, simulation, case.h))
        simulation.prepare_solver(print)
        rows = list(islice(simulation.steps(), 1 if case.only_first else None))
        known |= history(case, simulation, bonds, rows)
    known["seconds"] = time.process_time() - began
    RESULTS.write(case.name, identity(case), known)
    return known


def history(case: Case, simulation: Simulation, bonds, rows) -> dict:
    """First break, peak over stable states and their energies, from the rows of a run; ``bonds`` before it."""
    planes, (_, width, ligament, _) = simulation.scene.mesh.symmetry, BODIES[case.body]
    parts = 2 ** len(planes)
    section = width * THICKNESS / 2 ** sum(face[0] in "yz" for face in planes)
    to_stress = 1.0 / section / STRETCH
    to_energy = parts / (BULK * case.length * STRETCH**2 * ligament * THICKNESS)
    stable = [row for row in rows if row["event"] == "critical"]
    top = max(stable, key=lambda row: row["reaction"])
    known = {"first": stable[0]["reaction"] * to_stress}
    if case.only_first:
        return known
    first = np.flatnonzero((bonds.points == simulation.broken_bonds()[0]).all(axis=1))[0]
    middle = bonds.start[first] + 0.5 * bonds.vector[first]
    if case.h == 1.0:  # the finer bodies' runs end when half of the load is lost
        last = rows[-1]
        known |= {"broken": parts * last["broken_bonds"], "energy": last["dissipated_energy"] * to_energy}
    return known | {
        "peak": top["reaction"] * to_stress,
        "stable_states": len(stable),
        "broken_at_peak": parts * top["broken_bonds"],
        "energy_at_peak": top["dissipated_energy"] * to_energy,
        "place": np.abs(middle).round(2).tolist(),
        "ledger": max(abs(row["ledger_error"]) for row in rows if row["ledger_error"] is not None),
    }


def own_fracture_energy(case: Case, bonds) -> float:
    """Energy of the bonds across ``x = 0`` at the critical stretch over the bulk's ``G_c``, away from the edges."""
    start, stop = bonds.start, bonds.start + bonds.vector
    across = start[:, 0] * stop[:, 0] < 0.0
    y = start[across, 1] - start[across, 0] / bonds.vector[across, 0] * bonds.vector[across, 1]
    half = BODIES["strip"][1] / 2.0 - 2.6 * case.length
    energy = 0.5 * bonds.stiffness[across][np.abs(y) < half].sum()
    height = THICKNESS / (2.0 if case.mirrored else 1.0)
    return float(energy / (2.0 * half * height * case.length) / BULK)


def number(known: dict | None, key: str, form: str = ".3f") -> str:
    """For a table."""
    return "not run here" if known is None else "-" if known.get(key) is None else format(known[key], form)


HEAD = ("first break / E s_0", "its place", "peak / E s_0", "broken at the peak", "broken in all")
HEAD += ("energy of the cracks",)


def describe(case: Case) -> list[str]:
    """Cells of a row of results."""
    known = read(case)
    keys = (("first", ".4f"), ("peak", ".4f"), ("broken_at_peak", ",d"), ("broken", ",d"), ("energy", ".2f"))
    columns = [number(known, key, form) for key, form in keys] if known else ["not run here"] + [""] * 4
    place = f"({', '.join(f'{c:g}' for c in known['place'])})" if known and "place" in known else ""
    return [columns[0], place, *columns[1:]]


def tables() -> dict[str, list[str]]:
    """Sections of the document, by their names."""
    models = [
        [body, f"{case.h:g}", f"{case.length:g}", case.correction, *describe(case)]
        for body in PLATES
        for case in MODELS + REFINED + FINEST
        if case.body == body
    ]
    rules = [
        [body, f"{case.h:g}", f"`{case.rule}`", *describe(case)]
        for body in PLATES
        for case in MODELS + RULED
        if case.body == body and case.correction == "fitted"
    ]
    strips = []
    for h, length in ((1.0, 1.0), (0.5, 1.0), (0.5, 0.5)):
        cases = [Case("strip", h, length, correction, only_first=True) for correction in CORRECTIONS]
        cells = [number(read(case), "fracture_energy") if case in STRIPS else "-" for case in cases]
        strips.append([f"{h:g}", f"{length:g}", f"{THICKNESS / length:g}", *cells])
    return {
        "models": table(["body", "h", "l", "correction", *HEAD], models),
        "rules": table(["body", "h, l", "rule", *HEAD], rules),
        "fracture energies": table(["h", "l", "thickness / l", *CORRECTIONS], strips),
    }


def draw() -> None:
    """First breaks and peaks of each plate over those with "virial", and the same of the references."""
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(1, 2, figsize=(8.6, 3.4), sharey=True, layout="constrained")
    shown = [(correction, "all", correction) for correction in CORRECTIONS]
    shown += [("fitted", PROGRAMS_OWN, "fitted, r >= h/2"), ("fitted", "energy", "fitted, energy")]
    for axis, key, title in zip(axes, ("first", "peak"), ("first break", "peak"), strict=True):
        for column, body in enumerate(PLATES):
            scale = read(Case(body, 1.0, 1.0, "virial"))
            for k, (correction, rule, label) in enumerate(shown):
                only_first = body == "two holes" and rule == PROGRAMS_OWN
                known = read(Case(body, 1.0, 1.0, correction, rule, only_first))
                if scale and known and key in known:
                    axis.bar(
                        column + 0.13 * (k - 2.5), known[key] / scale[key], 0.12, color=f"C{k}",
                        label=label if column == 0 else None,
                    )  # fmt: skip
            reference = read(Case(body, 0.5, 1.0, "virial"))
            if scale and reference:
                height = reference[key] / scale[key]
                label = "half the cells' edge, virial" if column == 0 else None
                axis.plot([column - 0.4, column + 0.4], [height, height], color="black", label=label)
        axis.set_xticks(range(len(PLATES)), PLATES)
        axis.set_title(f'{title}, over that with "virial"')
    figure.legend(*axes[0].get_legend_handles_labels(), loc="outside right center", fontsize=7)
    plt.rcParams["svg.hashsalt"] = "pdfem"
    figure.savefig(FIGURE, metadata={"Date": None})


def main(words: Sequence[str]) -> int:
    """Run what is left, and fill the tables."""
    options = parser_of(__doc__, full="the largest references too").parse_args(words)
    for case in CASES:
        if options.report or options.only not in case.name or (case.full and not options.full) or read(case):
            continue
        print(case.name, end=": ", flush=True)
        if options.dry_run:
            print()
            continue
        known = run(case)
        keys = ("first", "peak", "broken", "energy", "fracture_energy", "fit_residual", "largest_factor", "seconds")
        print(", ".join(f"{key} {number(known, key, '.4g')}" for key in keys if known.get(key) is not None), flush=True)
    if not options.dry_run:
        fill(DOCS / "failure.md", tables())
        draw()
    return 0
