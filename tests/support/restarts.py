"""What the tests of restarts share: runs that are stopped at chosen points, and all that must come out the same."""

from __future__ import annotations

import csv
import json
import os
import signal
import time
from pathlib import Path

import h5py
import numpy as np

from pdfem_mpi.deck.loads import Support
from pdfem_mpi.deck.materials import Material
from pdfem_mpi.deck.outputs import Checkpoint, Output
from pdfem_mpi.deck.peridynamics import Crack
from pdfem_mpi.deck.programs import Events, Ramp, Steps
from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.toml import write_deck
from pdfem_mpi.parallel.comm import mpi
from pdfem_mpi.results.checkpoint_files import list_checkpoints
from pdfem_mpi.runs.restart_point import Refused, RunOptions
from pdfem_mpi.runs.run import run
from support.bodies import YOUNGS_MODULUS, make_scene
from support.reporters import Listener

FACTORS = (0.25, 0.5, 1.0)


def relaxed(**tables):
    """A coupled bar of finite kinematics, relaxed at three loads: some 230 safe points."""
    tables = {"stepping": Steps(load_factors=FACTORS), "output": Output(figures=False)} | tables
    return make_scene((9, 3, 2), 4, kinematics="finite", correction="none", tolerance=1e-3, **tables)


def often(**tables):
    """The same with a checkpoint every 20 iterations: 10 of them."""
    return relaxed(checkpoint=Checkpoint(iterations=20), **tables)


def failing(program, kinematics="linear", nu=0.25, **tables):
    """A coupled strip with an edge crack, pulled until bonds break: by events, a ramp, or steps."""
    edge = ((5.0, -1.0, -1.0), (5.0, 1.01, -1.0), (5.0, 1.01, 2.0), (5.0, -1.0, 2.0))
    stepping = {
        "events": Events(kind="events", eta=1e-2, inner_iterations=4, report_every=5, end_reaction=0.5),
        "ramp": Ramp(kind="ramp", increment=1.0 / 300.0, report_every=40),
        "steps": Steps(load_factors=(0.25, 0.5)),
    }[program]
    scene = make_scene(
        (7, 3, 1),
        2,
        kinematics=kinematics,
        correction="none",
        loads=(),
        supports=(Support(face="x-", x=0.0, y=0.0, z=0.0), Support(face="x+", layers=1, x=0.25)),
        solver="adr" if program == "ramp" else "cg",
        cracks=(Crack(polygon=edge),),
        output=Output(figures=False, damage=True),
        **tables,
    )
    breaking = Material(youngs_modulus=YOUNGS_MODULUS, poissons_ratio=nu, critical_stretch=0.02)
    return Scene.model_validate({**dict(scene), "material": breaking, "stepping": stepping})


class StopAt:
    """Requests of a signal that comes just before the n-th safe point, to one rank."""

    def __init__(self, n, here=True):
        self.n, self.here, self.asked = n, here, 0
        self.setting_up, self.clean_up = True, []

    def stop_in_set_up(self):
        """Safe points are counted from the first step."""
        return 0

    @property
    def stop(self):
        """Whether the signal has come."""
        self.asked += 1
        return self.here and self.asked >= self.n


def go(scene, comm, out, overwrite=False, reporter=None, **ways):
    """Run in this process, as `pdfem run` does, and return the exit code. Collective."""
    reporter = reporter or Listener()
    try:
        return run(scene, comm, Path(out), write_deck(scene), overwrite, reporter, RunOptions(**ways))
    except Refused as error:
        reporter.line(str(error))
        return error.code


def alone(scene, out, overwrite=False, reporter=None, **ways):
    """`go` on this rank alone."""
    return go(scene, mpi().COMM_SELF, out, overwrite, reporter, **ways)


def in_child(action, kill_after=None, **environment):
    """Do something in a child process, which may be killed after some seconds; return its exit code."""
    child = os.fork()
    if child == 0:
        code = 1
        try:
            os.environ.update(environment)
            code = action() or 0
        finally:
            os._exit(code)
    if kill_after is not None:
        time.sleep(kill_after)
        os.kill(child, signal.SIGKILL)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def outcome(out):
    """All of a finished run that must not depend on where it was stopped: rows, frames, tables, numbers."""
    out = Path(out)
    summary = json.loads((out / "summary.json").read_text(encoding="utf-8"))
    with (out / "history.csv").open(newline="", encoding="utf-8") as file:
        rows = [line[:-1] for line in csv.reader(file)]  # the last column is wall time
    found = {
        "history": rows,
        "fields": summary["fields_sha256"],
        "solve": summary["solve"],
        "balance": summary["balance"],
        "probes": summary["probes"],
    }
    for name in ("points.vtkhdf", "elements.vtkhdf", "body.vtkhdf"):
        if (out / name).exists():
            found[name] = arrays(out / name)
    _, last = list_checkpoints(out / "checkpoints")[0]
    found["checkpoint"] = {name: data for name, data in arrays(last).items() if name != "header"}
    return found


def arrays(path):
    """Bytes of every dataset in a file."""
    found = {}

    def visit(name, item):
        if isinstance(item, h5py.Dataset):
            found[name] = (item.shape, np.asarray(item[()]).tobytes())

    with h5py.File(path, "r") as file:
        file.visititems(visit)
        if "VTKHDF" in file:
            found["frames"] = int(file["VTKHDF/Steps"].attrs["NSteps"])
    return found


def differing(found, expected):
    """Names of what differs between two outcomes."""
    names = []
    for key in found.keys() | expected.keys():
        a, b = found.get(key), expected.get(key)
        if a != b and isinstance(a, dict) and isinstance(b, dict):
            names += [f"{key}: {part}" for part in a.keys() | b.keys() if a.get(part) != b.get(part)]
        elif a != b:
            names.append(key)
    return names
