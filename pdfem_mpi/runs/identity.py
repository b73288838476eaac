"""What makes a run the same run: the keys of its scene and its mesh, and which of them may change on the way."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping
from typing import Any

from pdfem_mpi.body.lattice_planes import energy_of_planes
from pdfem_mpi.body.share import Share
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import leaves, show

#: Keys that say nothing about the states a run goes through. A name stands for its table's keys too.
FREE = ("title", "units", "probes", "output", "checkpoint")
KINEMATICS = "peridynamics.kinematics"
#: Stand for elements in finite kinematics. Beside bonds they were linear once, whatever the deck said: such a run may
#: go on, and the log says so.
ELEMENTS, ELEMENTS_BESIDE_BONDS = "elements, their kinematics", "elements beside bonds, their kinematics"
#: Keys that may change from a checkpoint on; the log says so, since results are then not those of one deck.
MAY_CHANGE = (
    "solver.tolerance", "solver.max_evaluations", "stepping.end_load_factor", "stepping.end_reaction",
    "stepping.end_opening", "stepping.report_every", ELEMENTS_BESIDE_BONDS,
)  # fmt: skip
#: What follows where a checkpoint was written with the earlier default of regions of elements.
HELD_NOW = (
    "since bonds between two points of the overlap no longer break unless the deck says so: set {key} = true to go on "
    "as before, or begin anew"
)
#: Stand for laws of bonds that became others without a change of the deck: what softening bonds make up for, and that
#: bonds end at the surface of bodies that may have hollows. What is said where a checkpoint has none of it.
PLANES, INSIDE = "energy of planes", "bonds inside of the body"
BECAME = {
    PLANES: "since bonds that soften make up for what planes of the lattice take, by another law than the checkpoint's",
    INSIDE: "since bonds that leave the body are cut, and the checkpoint may have such bonds",
}
ANEW = "begin anew with --overwrite or in another folder, or go on with --force as the program is now"
#: Tables, keys and defaults that came later than the first checkpoints: they say what these mean.
NEWER_DEFAULTS = (
    ("mesh", "remove", []),
    ("mesh", "doubled_nodes", "refuse"),
    ("cracks", "kind", "polygon"),
    ("supports", "of", "cells"),
    ("loads", "constant", False),
    ("", "springs", []),
    ("", "ties", []),
    ("regions", "always_elements", False),
    ("", "adaptive", None),
)
#: Where the load goes: what was done already must stay.
LOAD_FACTORS, TIMES = "stepping.load_factors", "stepping.times"
#: Stands for the mesh itself among the keys.
MESH = "mesh, its nodes and cells"
#: Stands for what a file of temperatures holds.
HEAT = "temperature, the content of its file"


def identity(scene: Scene, share: Share) -> dict[str, Any]:
    """Every key of the scene by its dotted path, as JSON knows it, and a digest of the mesh and its regions."""
    keys: dict[str, Any] = dict(leaves(json.loads(scene.model_dump_json())))
    keys[KINEMATICS] = keys[KINEMATICS] or "finite"  # as checkpoints had it when that was the default
    if scene.has_finite_elements and scene.kinematics == "finite":
        keys[ELEMENTS_BESIDE_BONDS if scene.has_peridynamics else ELEMENTS] = "finite"
    if share.softening_cells is not None:
        keys[PLANES] = energy_of_planes(scene, share)
    if share.cutoff and scene.mesh.may_have_hollows:
        keys[INSIDE] = True
    keys |= _may_fail(scene, share)
    keys = {key: value for key, value in keys.items() if not _is_newer_default(key, value) and not _is_label(key)}
    keys[MESH] = share.body_sha256
    if scene.temperature is not None and scene.temperature.file is not None:
        keys[HEAT] = _digest(scene.temperature.file)
    return keys


def _digest(path: str) -> str | None:
    """Digest of a file's content; None where it cannot be read, which the load case refuses by name."""
    try:
        with open(path, "rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except OSError:
        return None


def sha256(keys: Mapping[str, Any]) -> str:
    """Digest of the keys that define the scene: equal for runs that may continue each other."""
    defining = {key: value for key, value in keys.items() if not _is(key, FREE + MAY_CHANGE + (LOAD_FACTORS, TIMES))}
    return hashlib.sha256(json.dumps(defining, sort_keys=True).encode()).hexdigest()


def differences(then: Mapping[str, Any], now: Mapping[str, Any], steps_done: int) -> tuple[list[str], list[str]]:
    """Compare the keys of a checkpoint with those of a deck.

    Parameters
    ----------
    then, now : dict
        From `identity`.
    steps_done : int
        Load factors reached already.

    Returns
    -------
    refused : list of str
        What makes it another run: key and both values.
    allowed : list of str
        Changes that may be made.
    """
    refused, allowed = [], []
    done = -(-steps_done // (now.get("stepping.increments") or 1))
    for key in dict.fromkeys((*then, *now)):
        a, b = then.get(key), now.get(key)
        if a == b or _is(key, FREE):
            continue
        values = "differs" if key in (MESH, HEAT) else f"was {_show(then, key)}, the deck has {_show(now, key)}"
        if _held_now(key, a, b):
            values += f", {HELD_NOW.format(key=key)}"
        elif key in BECAME and a is None:
            values += f", {BECAME[key]}: {ANEW}"
        if _is(key, MAY_CHANGE) or (key in (LOAD_FACTORS, TIMES) and a and b and a[:done] == b[:done]):
            allowed.append(f"{key} {values}")
        else:
            refused.append(f"{key} {values}")
    return refused, allowed


def free_changes(then: Mapping[str, Any], now: Mapping[str, Any]) -> list[str]:
    """Changes of labels and of what is measured and drawn: they end no run, but a deck may have changed by mistake."""
    keys = (key for key in then if key in now and _is(key, FREE) and not _is(key, ("checkpoint",)))
    return [f"{key} was {_show(then, key)}, the deck has {_show(now, key)}" for key in keys if then[key] != now[key]]


def _may_fail(scene: Scene, share: Share) -> dict[str, bool]:
    """What a region leaves open, as checkpoints had it when the default was true, where it means the same.

    It differs in a region of elements with an overlap whose bonds have a limit: true lets them break.
    """
    overlap = set(share.overlap_regions.tolist()) if scene.can_fail else set()
    return {
        f"regions.{index}.may_fail": True
        for index, region in enumerate(scene.regions)
        if region.may_fail is None and (region.model != "finite_elements" or index not in overlap)
    }


def _is_newer_default(key: str, value: Any) -> bool:
    """Whether a key says by its default what checkpoints without the key mean."""
    table, _, name = key.rpartition(".")
    return (table.split(".")[0], name, value) in NEWER_DEFAULTS


def _is_label(key: str) -> bool:
    """Whether a key is the name of a load, support, spring or tie, which calls columns and nothing else."""
    return key.endswith(".name") and key.startswith(("loads.", "supports.", "springs.", "ties."))


def _held_now(key: str, then: Any, now: Any) -> bool:
    return key.startswith("regions.") and key.endswith(".may_fail") and then is True and now is None


def _is(key: str, names: tuple[str, ...]) -> bool:
    return any(key == name or key.startswith(f"{name}.") for name in names)


def _show(keys: Mapping[str, Any], key: str) -> str:
    return show(keys[key]) if key in keys and keys[key] is not None else "nothing"
