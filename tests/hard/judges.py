"""How the outcome of a hard case is judged: what came out, how far from what was expected, and whether that holds."""

from __future__ import annotations

import math
from collections.abc import Callable

import numpy as np
from hard.suite import Finding, Judge, Outcome, last_words

from pdfem_mpi.deck.scene import Scene
from support import direct_solution as reference


def _solved(outcome: Outcome) -> Finding | None:
    """None where a run finished and every number of it is finite."""
    if outcome.exit_code:
        return Finding(f"exit code {outcome.exit_code}: {last_words(outcome.said)}", None, False)
    numbers = [value for row in outcome.history for value in row.values() if isinstance(value, float)]
    if not all(math.isfinite(value) for value in numbers):
        return Finding("numbers that are not finite", None, False)
    return None


def refused(code: int, *words: str) -> Judge:
    """Refused with this exit code and all of these words."""

    def judge(case, scene, outcome, others):
        missing = [word for word in words if word not in outcome.said]
        clean = "Traceback" not in outcome.said
        lines = [line for line in outcome.said.splitlines() if all(word in line for word in words)] or [outcome.said]
        return Finding(
            f"exit code {outcome.exit_code}: {last_words(lines[-1])}",
            None,
            outcome.exit_code == code and not missing and clean,
        )

    return judge


def compared(measure: Callable[[Scene, Outcome, dict], tuple[str, float]], tolerance: float) -> Judge:
    """Solved, and ``measure`` gives (what came out, an error) with an error of at most ``tolerance``."""

    def judge(case, scene, outcome, others):
        failed = _solved(outcome)
        if failed:
            return failed
        got, error = measure(scene, outcome, others)
        return Finding(got, error, bool(error <= tolerance))

    return judge


def _largest(difference: np.ndarray, of: np.ndarray) -> float:
    return float(np.abs(difference).max() / np.abs(of).max())


def _fields(scene: Scene, outcome: Outcome):
    """Positions and displacements of what the scene has: points, then nodes."""
    body = reference.make_body(scene)
    nodes = body.discretization.mesh.nodes[body.discretization.node_row >= 0]
    pairs = [(body.x, outcome.points), (nodes, outcome.nodes)]
    found = [(x, u) for x, u in pairs if len(x)]
    return np.concatenate([x for x, _ in found]), np.concatenate([u for _, u in found])


def uniform_tension(strain: float, tolerance: float, poissons_ratio: float = 0.25) -> Judge:
    """Uniform tension along x, up to a rigid motion; the error is relative to the largest displacement."""

    def measure(scene, outcome, others):
        x, u = _fields(scene, outcome)
        exact = strain * x * np.array([1.0, -poissons_ratio, -poissons_ratio])
        exact = reference.without_rigid_motion(x, exact)
        error = _largest(reference.without_rigid_motion(x, u) - exact, exact)
        return f"strain {strain:g} everywhere", error

    return compared(measure, tolerance)


def direct_solution(tolerance: float) -> Judge:
    """The displacements of `support.direct_solution`; the error is relative to the largest one."""

    def measure(scene, outcome, others):
        points, nodes = reference.solve(scene)
        exact = np.concatenate([u for u in (points, nodes) if u is not None])
        x, u = _fields(scene, outcome)
        exact = exact * outcome.history[-1]["load_factor"]
        if not scene.supports or scene.supports[0].set == "CORNER":
            exact, u = reference.without_rigid_motion(x, exact), reference.without_rigid_motion(x, u)
        return f"largest displacement {np.abs(u).max():.6g}", _largest(u - exact, exact)

    return compared(measure, tolerance)


def finite_equilibrium(tolerance: float) -> Judge:
    """The residual force, by `support.direct_solution`, of the points that are free, over the reaction."""

    def measure(scene, outcome, others):
        body = reference.make_body(scene)
        force = reference.finite_forces(body, outcome.points.astype(float))
        held = ~np.isnan(reference.prescribed(body))
        reaction = np.abs(force[held[:, 0] & (body.x[:, 0] > body.x[:, 0].mean()), 0].sum())
        return f"reaction {reaction:.6g}", float(np.linalg.norm(force[~held]) / reaction)

    return compared(measure, tolerance)


def modulus(tolerance: float) -> Judge:
    """Young's modulus that the bar probe finds, over that of the material."""

    def measure(scene, outcome, others):
        ratios = [v for name, v in outcome.summary["probes"].items() if name.startswith("modulus_ratio")]
        return f"E / E0 = {ratios[0]:.6f}", abs(ratios[0] - 1.0)

    return compared(measure, tolerance)


def probe(name: str, value: float, tolerance: float) -> Judge:
    """A probe's result; the error is relative to the expected value."""

    def measure(scene, outcome, others):
        found = outcome.summary["probes"][name]
        return f"{name.replace('_', ' ')} {found:.6g}", abs(found / value - 1.0)

    return compared(measure, tolerance)


def same_as_other(tolerance: float, length: float = 1.0, force: float = 1.0) -> Judge:
    """Probes, number of rows and last row (load, displacement, reaction, broken bonds) of the case `against`, in other
    units.
    """

    def measure(scene, outcome, others):
        other = others["against"]
        here, there = (
            np.array([v for v in o.summary["probes"].values() if isinstance(v, list)]) for o in (outcome, other)
        )
        errors = [_largest(here - length * there, length * there)] if here.size else []
        last, then = outcome.history[-1], other.history[-1]
        units = {"load_factor": 1.0, "displacement": length, "reaction": force, "broken_bonds": 1.0}
        for name, unit in units.items():
            if then.get(name):
                errors.append(abs(last[name] / (unit * then[name]) - 1.0))
        errors.append(float(len(outcome.history) != len(other.history)))
        return f"largest difference {max(errors):.1e}", max(errors)

    return compared(measure, tolerance)


def broken(ledger: float | None = 1e-9, **limits: float) -> Judge:
    """Failure with a ledger that closes (None: of a program without one); bonds must break.

    ``limits`` such as crack_x_max=10.0 hold for every row.
    With ``mirror`` = X the broken bonds are mirror images about x = X after every row, and an even number.
    """
    mirror = limits.pop("mirror", None)

    def measure(scene, outcome, others):
        rows = [row for row in outcome.history if row.get("broken_bonds")]
        errors = [] if rows else [np.inf]
        if ledger is not None:
            known = [row.get("ledger_error") for row in outcome.history]
            errors += [np.inf if error is None else abs(error) / ledger for error in known]
        for name, limit in limits.items():
            side = 1.0 if name.endswith("max") else -1.0
            errors += [2.0 for row in rows if side * (row[name] - limit) > 1e-9]
        if mirror is not None:
            errors += [abs(row["crack_x_min"] + row["crack_x_max"] - 2.0 * mirror) / 1e-9 for row in rows]
            errors += [2.0 for row in rows if row["broken_bonds"] % 2]
        last = outcome.history[-1]
        where = f", x from {last['crack_x_min']:.4g} to {last['crack_x_max']:.4g}" if last.get("broken_bonds") else ""
        got = f"{last['event']} at load factor {last['load_factor']:.6g}, {int(last['broken_bonds']):,} bonds broken"
        return got + where, max(errors, default=0.0) * (ledger or 1.0)

    return compared(measure, ledger or 1.0)


def softened(ledger: float = 1e-9, mirror: float | None = None) -> Judge:
    """Bonds softened, with a ledger that closes; bonds are gone, mirror images about x = ``mirror``, if it is given."""

    def measure(scene, outcome, others):
        last = outcome.history[-1]
        errors = [0.0 if last["softened_bonds"] + last["broken_bonds"] > 0 else np.inf]
        errors += [abs(row["ledger_error"]) / ledger for row in outcome.history]
        if mirror is not None:
            gone = [row for row in outcome.history if row["broken_bonds"]]
            errors.append(0.0 if gone else np.inf)
            errors += [abs(row["crack_x_min"] + row["crack_x_max"] - 2.0 * mirror) / 1e-9 for row in gone]
        counts = f"{int(last['broken_bonds']):,} bonds gone, {int(last['softened_bonds']):,} softened"
        return f"{last['event']} at load factor {last['load_factor']:.6g}, {counts}", max(errors) * ledger

    return compared(measure, ledger)


def snaps_back(ledger: float = 1e-9) -> Judge:
    """Past its peak load the displacement falls, too, by a twentieth at least."""

    def measure(scene, outcome, others):
        rows = [row for row in outcome.history if row["event"] == "critical"]
        peak = max(range(len(rows)), key=lambda k: rows[k]["reaction"])
        least = min(row["displacement"] for row in rows[peak:])
        errors = [abs(row["ledger_error"]) / ledger for row in outcome.history]
        errors.append(0.0 if least < 0.95 * rows[peak]["displacement"] else np.inf)
        text = f"peak at {rows[peak]['displacement']:.4g}, then back to {least:.4g}"
        return text, max(errors) * ledger

    return compared(measure, ledger)


def follows_opening(name: str, fall: float, ledger: float) -> Judge:
    """An opening that never shrinks, a load that falls below a part of the first, and a ledger that closes."""

    def measure(scene, outcome, others):
        opening = np.array([row[f"{name}.opening"] for row in outcome.history])
        load = np.array([row["load_factor"] for row in outcome.history])
        errors = [abs(row["ledger_error"]) for row in outcome.history]
        errors += [np.inf] if (np.diff(opening) < -1e-9 * opening[:-1]).any() or load.min() > fall * load[0] else []
        lowest, count = load.min() / load[0], int(outcome.history[-1]["broken_bonds"])
        return f"lowest load {lowest:.3g} of the first break's, {count:,} bonds broken", max(errors)

    return compared(measure, ledger)


def adds_up(tolerance: float, shift: float, left: str, right: str) -> Judge:
    """Forces along y of two rollers that carry a load of 1, each half of it within ``shift``."""

    def measure(scene, outcome, others):
        a, b = (outcome.history[-1][f"{name}.force_y"] for name in (left, right))
        return f"forces {a:.6g} and {b:.6g}", abs(a + b - 1.0) if abs(a - b) <= shift else math.inf

    return compared(measure, tolerance)


def same_reactions(tolerance: float) -> Judge:
    """Rows, broken bonds and reactions at each are those of the case `against`, whose loads are others."""

    def measure(scene, outcome, others):
        here, there = outcome.history, others["against"].history
        same = [row["broken_bonds"] for row in here] == [row["broken_bonds"] for row in there]
        errors = [abs(a["reaction"] / b["reaction"] - 1.0) for a, b in zip(here, there, strict=False)]
        return f"{len(here)} rows, {int(here[-1]['broken_bonds']):,} bonds broken", max(errors) if same else math.inf

    return compared(measure, tolerance)


def nothing_moves() -> Judge:
    """No displacement at all."""

    def measure(scene, outcome, others):
        size = max(float(np.abs(u).max()) for u in (outcome.points, outcome.nodes) if u is not None)
        return f"largest displacement {size:g}", size

    return compared(measure, 0.0)


def completed() -> Judge:
    """Solved, whatever the numbers, as long as they are finite."""
    return compared(lambda scene, outcome, others: ("solved", 0.0), 0.0)


def counted_bonds(tolerance: float) -> Judge:
    """All bonds between two regions that move apart, and no others, broke at once; error of their energy."""

    def measure(scene, outcome, others):
        body = reference.make_body(scene)
        i, j, k = reference.bonds(body)
        across = body.discretization.region[body.cell[i]] != body.discretization.region[body.cell[j]]
        moves = np.array([[s.x, s.y, s.z] for s in scene.supports])[body.discretization.region[body.cell]]
        xi, eta = (body.x[j] - body.x[i])[across], (moves[j] - moves[i])[across]
        r = np.linalg.norm(xi, axis=1)
        stretch = (xi * eta).sum(axis=1) / r**2
        energy = float((0.5 * k[across] * r * stretch**2).sum())
        (row,) = outcome.history
        exact = row["broken_bonds"] == across.sum() == (stretch > scene.material.critical_stretch).sum()
        error = abs(row["dissipated_energy"] / energy - 1.0) if exact else math.inf
        return f"{int(row['broken_bonds']):,} of {across.sum():,} bonds", error

    return compared(measure, tolerance)


def numbers(tolerance: float, *names: str) -> Judge:
    """Each named number of a check of `hard.rotations` is at most ``tolerance``."""

    def measure(scene, outcome, others):
        found = {name: outcome.summary[name] for name in names}
        return ", ".join(f"{name.replace('_', ' ')} {value:.2g}" for name, value in found.items()), max(found.values())

    return compared(measure, tolerance)


def says(judge: Judge, *words: str) -> Judge:
    """What ``judge`` says, and these words were told."""

    def both(case, scene, outcome, others):
        finding = judge(case, scene, outcome, others)
        missing = [word for word in words if word not in outcome.said]
        told = f"; told: {words[0]}" if not missing else f"; not told: {missing[0]}"
        return Finding(finding.got + told, finding.error, finding.holds and not missing)

    return both
