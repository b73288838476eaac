"""run.log: what a run said, with the time of day; lines of later starts follow those of earlier ones."""

import contextlib
from datetime import datetime
from pathlib import Path


class RunLog:
    """A text file that grows by lines; a disk that takes none does not stop the run.

    Parameters
    ----------
    path : str or Path
    """

    def __init__(self, path: str | Path):
        self.path = Path(path)

    def line(self, text: str) -> None:
        """Write one line."""
        stamp = datetime.now().isoformat(sep=" ", timespec="seconds")
        with contextlib.suppress(OSError), self.path.open("a", encoding="utf-8", errors="backslashreplace") as file:
            file.write(f"{stamp}  {text}\n")
