"""Exit codes of the program, and what they mean."""

EXIT_FINISHED = 0
EXIT_USAGE = 64
EXIT_NO_CHECKPOINT = 65
EXIT_INTERNAL_ERROR = 70
EXIT_NOT_WRITTEN = 73
EXIT_NOT_CONVERGED = 74
EXIT_STOPPED = 75

#: What summary.json calls the codes with which a run ends.
STATUS = {
    EXIT_FINISHED: "finished",
    EXIT_NOT_WRITTEN: "stopped without a checkpoint",
    EXIT_NOT_CONVERGED: "not converged",
    EXIT_STOPPED: "stopped",
}
