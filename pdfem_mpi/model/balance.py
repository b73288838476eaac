"""Whether loads are in balance along the motions that nothing holds, and these motions taken out of displacements."""

from __future__ import annotations

import numpy as np

from pdfem_mpi.kernels.dense import product, solve
from pdfem_mpi.model.model import Model
from pdfem_mpi.model.motions import PAIRS, combine, modes_at, motion_names, name_motion, rigid_modes, symmetric
from pdfem_mpi.model.parts import (
    NAMED,
    Parts,
    UnsupportedPart,
    find_parts,
    find_unsupported,
    rows_within,
    sum_over_parts,
)
from pdfem_mpi.parallel.sums import exact_dots

#: Loads work on a free motion when this fraction of their absolute work is left over.
BALANCE_TOLERANCE = 1e-9
#: Forces and moments below this part of the largest, in model units, are told as 0.
ROUND_OFF = 1e-12


def find_unbalanced(
    model: Model, free: np.ndarray, parts: Parts, unsupported: tuple[UnsupportedPart, ...], external: np.ndarray
) -> list[str]:
    """Sentences about loads that work on a motion which nothing holds, of the body or of its parts. Collective.

    Parameters
    ----------
    free : float64, shape (n_modes, 6)
        Motions of the whole body that nothing holds, as of `motions.free_motions`.
    external : float64, shape (n_unknowns,), dimension force
        0 on fixed unknowns.
    """
    return _unbalanced_body(model, free, external) or _unbalanced_parts(model, parts, unsupported, external)


def _unbalanced_body(model: Model, free: np.ndarray, external: np.ndarray) -> list[str]:
    """A sentence, if the loads work on a motion of the whole body that nothing holds. Collective."""
    if not len(free):
        return []

    def works():
        for motion in free:
            mode = combine(model, motion)
            yield external, mode
            yield np.abs(external), np.abs(mode)

    net, gross = exact_dots(model.comm, works()).reshape(-1, 2).T
    if (np.abs(net) <= BALANCE_TOLERANCE * gross.max()).all():
        return []
    worst = int(np.argmax(np.abs(net)))
    force, moment = _show(model, exact_dots(model.comm, ((external, mode) for mode in rigid_modes(model))))
    return [
        f"loads are not in balance: their sum is a force of ({force}) and a moment of ({moment}) about the centre of "
        f"the body, and no support holds {name_motion(free[worst])}. Balance the loads, or add a table [[supports]]."
    ]


def _show(model: Model, resultants: np.ndarray) -> tuple[str, str]:
    """A force and a moment, shape (6,), in the deck's units."""
    units = model.units
    resultants = np.where(np.abs(resultants) < ROUND_OFF * np.abs(resultants).max(), 0.0, resultants)
    force, moment = resultants[:3] * units.force, resultants[3:] * units.force * units.length
    return ", ".join(f"{f:.6g}" for f in force), ", ".join(f"{m:.6g}" for m in moment)


def _unbalanced_parts(
    model: Model, parts: Parts, unsupported: tuple[UnsupportedPart, ...], external: np.ndarray
) -> list[str]:
    """A sentence for each unsupported part whose loads work on a motion that nothing holds. Collective."""
    messages = []
    for part, row, motion in _out_of_balance(model, parts, unsupported, external):
        total = np.where(np.abs(row[:6]) > BALANCE_TOLERANCE * row[6:], row[:6], 0.0)
        force, moment = _show(model, total)
        messages.append(
            f"loads are not in balance on a part of the body that hangs together with no other, {part.text}: they sum "
            f"to a force of ({force}) and a moment of ({moment}) about its middle, and no support holds "
            f"{motion_names(part.motions[[motion]])}. Support that part, balance its loads, or let the "
            "crack end inside the body."
        )
    left = len(messages) - NAMED
    return messages[:NAMED] + ([f"and {left} parts more of this kind."] if left > 0 else [])


def without_equilibrium(
    model: Model, fixed: np.ndarray, external: np.ndarray
) -> tuple[np.ndarray, list[UnsupportedPart]]:
    """Unknowns of the parts that hang together now and whose loads nothing balances, and those parts. Collective.

    Parameters
    ----------
    fixed : bool, shape (n_unknowns,)
    external : float64, shape (n_unknowns,), dimension force
        0 on fixed unknowns.

    Returns
    -------
    bool, shape (n_unknowns,)
    list of UnsupportedPart
    """
    parts = find_parts(model)
    wrong = [part for part, _, _ in _out_of_balance(model, parts, find_unsupported(model, parts, fixed), external)]
    rows = np.isin(parts.of, [part.part for part in wrong])
    rows = np.repeat(rows[:, None], 3, axis=1)
    return model.unknowns.join(rows), wrong


def _out_of_balance(model: Model, parts: Parts, unsupported: tuple[UnsupportedPart, ...], external: np.ndarray):
    """Unsupported parts with unbalanced loads; their forces, moments and the sums of magnitudes; their worst motion.

    Returns
    -------
    list of (UnsupportedPart, float64 of shape (12,), int)
    """
    if not unsupported:
        return []
    which, y = rows_within(model, parts, unsupported)
    force = model.unknowns.rows(external)
    modes = modes_at(y)
    terms = modes * force[which >= 0][:, None]
    table = np.zeros((len(which), 12))
    table[which >= 0] = np.concatenate([terms.sum(axis=2), np.abs(terms).sum(axis=2)], axis=1)
    sums = sum_over_parts(model.comm, Parts(np.maximum(which, 0), len(unsupported)), which >= 0, table)
    found = []
    for part, row in zip(unsupported, sums, strict=True):
        work = np.abs(product(part.motions, row[:6]))
        gross = product(np.abs(part.motions), row[6:])
        if (work > BALANCE_TOLERANCE * gross.max()).any():
            found.append((part, row, int(np.argmax(work))))
    return found


def remove_free_motion(
    model: Model, parts: Parts, unsupported: tuple[UnsupportedPart, ...], volume: np.ndarray, u: np.ndarray
) -> None:
    """Take its free motions out of each unsupported part: their means over the part's volume vanish. Collective.

    Parameters
    ----------
    volume, u : float64, shape (n_unknowns,), dimensions length^3 and length
        ``u`` is overwritten.
    """
    if not unsupported:
        return
    which, y = rows_within(model, parts, unsupported)
    inside = which >= 0
    weight, rows = model.unknowns.rows(volume)[inside, :1], model.unknowns.rows(u)
    modes = modes_at(y)
    table = np.zeros((len(which), 27))
    for column, (a, b) in enumerate(zip(*PAIRS, strict=True)):
        table[inside, column] = weight[:, 0] * (modes[:, a] * modes[:, b]).sum(axis=1)
    table[inside, 21:] = weight * (modes * rows[inside][:, None]).sum(axis=2)
    sums = sum_over_parts(model.comm, Parts(np.maximum(which, 0), len(unsupported)), inside, table)
    motion = np.zeros((len(unsupported), 6))
    for k, part in enumerate(unsupported):
        gram = symmetric(sums[k, :21])
        kept = product(product(part.motions, gram), part.motions.T)
        motion[k] = product(solve(kept, product(part.motions, sums[k, 21:])), part.motions)
    for mode in range(6):
        rows[inside] -= motion[which[inside], mode, None] * modes[:, mode]
    u[:] = model.unknowns.join(rows)
