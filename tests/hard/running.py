"""A hard case in this process, alone or on the ranks of a communicator: its outcome, and what is told of it."""

from __future__ import annotations

import json
import time
from unittest.mock import patch

from hard.rotations import run_check
from hard.suite import BAD_DECK, Outcome, deck_text, read_outcome, read_scene

from pdfem_mpi.deck.table import DeckError, SceneError
from pdfem_mpi.runs.run import run
from support.reporters import Listener


def outcome_of(case, comm, folder, short=False):
    """Run a case, or its short form; return its scene (None if refused) and its outcome. Collective.

    Results are those of rank 0; other ranks have the exit code and the words of a refusal.
    """
    listener = Listener()
    try:
        scene = read_scene(case, short)
        scene = scene.model_copy(update={"output": scene.output.model_copy(update={"figures": False})})
        if case.program != "run":
            run_check(case.program, scene, comm, folder)
            return scene, read_outcome(folder, 0, "") if comm.rank == 0 else Outcome(0, "")
        with patch("pdfem_mpi.runs.run.fit_folders", lambda out: (out,)):  # the user's cache knows earlier fits
            code = run(scene, comm, folder, deck_text(case), True, listener)
    except (DeckError, SceneError) as error:
        return None, Outcome(BAD_DECK, "\n".join(error.messages))
    said = "\n".join(listener.lines)
    return scene, read_outcome(folder, code, said) if comm.rank == 0 else Outcome(code, said)


def judged(case, comm, folder, others, short=False):
    """Run and judge a case on one rank: (finding, what the report of the hard cases tells of it)."""
    start = time.process_time()
    scene, outcome = outcome_of(case, comm, folder, short)
    seconds = time.process_time() - start
    finding = case.judge(case, scene, outcome, others)
    told = {
        "family": case.family,
        "case": case.name,
        "expected": case.expected,
        "got": finding.got,
        "error": finding.error,
        "evaluations": outcome.summary.get("solve", {}).get("evaluations"),
        "seconds": seconds,
        "verdict": "refused" if outcome.exit_code else "solved",
        "ranks": case.ranks,
    }
    return finding, told


def record(record_property, told):
    """Write what is told of a case into the report of the tests; only of whole cases."""
    record_property("hard case", json.dumps(told))
