"""The exit codes of ``pdfem``, which batch scripts read, and the words for them in result files."""

EXIT_FINISHED = 0
#: A bad deck, command line or launcher.
EXIT_USAGE = 64
#: No checkpoint that can be used.
EXIT_NO_CHECKPOINT = 65
EXIT_INTERNAL_ERROR = 70
#: Results cannot be written.
EXIT_NOT_WRITTEN = 73
EXIT_NOT_CONVERGED = 74
#: Stopped with a checkpoint.
EXIT_STOPPED = 75
#: Ctrl-C while a command waits for an answer; 128 and the signal's number, as shells have it.
EXIT_INTERRUPTED = 130

#: The ``status`` in a run's summary.json.
RUN_STATUS = {
    EXIT_FINISHED: "finished",
    EXIT_NOT_WRITTEN: "stopped without a checkpoint",
    EXIT_NOT_CONVERGED: "not converged",
    EXIT_STOPPED: "stopped",
}
#: The ``status`` in study.csv of a member that ended otherwise than finished.
MEMBER_STATUS = {
    EXIT_USAGE: "refused",
    EXIT_NO_CHECKPOINT: "bad checkpoint",
    EXIT_INTERNAL_ERROR: "internal error",
    EXIT_NOT_WRITTEN: "not written",
    EXIT_NOT_CONVERGED: "not converged",
    EXIT_STOPPED: "stopped",
}
