"""How far a run is, in words: peak, end, crack, time left; and lines no wider than a terminal."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any


class Outlook:
    """Follows the rows of a run.

    Parameters
    ----------
    scene : Scene or None
        What is known of its end; None: nothing.
    """

    def __init__(self, scene: Any = None):
        self.stepping = getattr(scene, "stepping", None)
        self.unit = scene.units.length if scene else ""
        self.peak = 0.0
        self.began: tuple[float, float] | None = None  # time and share of the first row

    def parts(self, columns: dict[str, Any]) -> list[str]:
        """What is worth telling of a row beside its own numbers."""
        parts = []
        self.peak = max(self.peak, columns["reaction"])
        if columns["reaction"] < 0.995 * self.peak:
            parts.append(f"{100.0 * columns['reaction'] / self.peak:.0f} % of peak")
        if length := crack_length(columns):
            parts.append(f"crack {length:.3g}{' ' + self.unit if self.unit else ''}")
        if (share := self.share(columns)) is not None:
            parts.append(f"{100.0 * share:.0f} % done")
            if left := self.left(share):
                parts.append(f"~{left} left")
        return parts

    def share(self, columns: dict[str, Any]) -> float | None:
        """Share of the load program that is done, 0 to 1; None where its end is not known beforehand."""
        if self.stepping is None:
            return None
        if getattr(self.stepping, "n_steps", None):
            return min(columns["step"] / self.stepping.n_steps, 1.0)
        end = getattr(self.stepping, "end_load_factor", None)
        return None if end is None else min(abs(columns["load_factor"]) / end, 1.0)

    def left(self, share: float) -> str:
        """Time left at the mean speed since the first row; empty where it cannot be told."""
        now = time.monotonic()
        if self.began is None:
            self.began = now, share
            return ""
        seconds, gained = now - self.began[0], share - self.began[1]
        if gained <= 0.0 or seconds <= 0.0 or share >= 1.0:
            return ""
        return clock(seconds * (1.0 - share) / gained)


def crack_length(columns: dict[str, Any]) -> float | None:
    """Longest side of the box around the broken bonds; None where none broke."""
    ends = [(columns.get(f"crack_{axis}_min"), columns.get(f"crack_{axis}_max")) for axis in "xyz"]
    return None if None in ends[0] else max(high - low for low, high in ends)


def clock(seconds: float) -> str:
    """A time as mm:ss or h:mm:ss."""
    minutes, second = divmod(round(seconds), 60)
    hours, minute = divmod(minutes, 60)
    return f"{hours}:{minute:02}:{second:02}" if hours else f"{minute:02}:{second:02}"


def fitted(parts: Sequence[str], room: int | None) -> str:
    """Parts of a line with two blanks between them: as many, from the first, as there is room for."""
    text = "  ".join(parts)
    while room is not None and len(text) > room and len(parts) > 1:
        parts = parts[:-1]
        text = "  ".join(parts)
    return text if room is None else text[: max(room, 0)]
