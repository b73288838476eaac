"""Texts of a deck in figures: drawn as they are, and not taken for formulas; and figures that cannot be drawn."""

from collections.abc import Callable
from pathlib import Path

#: Characters of a title or name that a figure has room for.
MOST = 200


def as_it_is(text: str) -> str:
    """A text that matplotlib shows as it is: it would read what stands between two ``$`` as a formula, and may fail."""
    short = text if len(text) <= MOST else text[: MOST - 3] + "..."
    return short.replace("$", r"\$")


def attempt(draw: Callable[[], object], path: Path, warn: Callable[[str], None]) -> list[Path]:
    """Draw a figure, if that can be done: results are there without it, and no figure is worth the end of a run.

    Parameters
    ----------
    draw : callable
        Writes the figure to ``path``.
    warn : callable
        Hears why it was not drawn.

    Returns
    -------
    list of Path
        ``path``, or nothing.
    """
    try:
        draw()
        return [path]
    except Exception as error:  # matplotlib raises what its layout, fonts and parsers meet
        reason = " ".join(str(error).split())[:MOST] or "no reason given"
        warn(f"the figure {path.name} was not drawn ({type(error).__name__}: {reason})")
        return []
