"""The members of a study: one deck with several values of some keys, each validated before any of them runs."""

from __future__ import annotations

import hashlib
import itertools
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import DeckError
from pdfem_mpi.deck.toml import parse_deck, read_text, write_deck

MAX_MEMBERS = 1000  # a product of values typed by mistake
MAX_NAME = 100  # characters of a member's folder


class StudyError(Exception):
    """A study that cannot be made; ``messages`` holds all problems as plain sentences."""

    def __init__(self, messages: Sequence[str]):
        self.messages = list(messages)
        super().__init__("\n".join(self.messages))


@dataclass(frozen=True)
class Axis:
    """One ``--vary``: keys that change together, and for each value of the axis one text for each key."""

    keys: tuple[str, ...]
    values: tuple[tuple[str, ...], ...]


@dataclass(frozen=True)
class Member:
    """One run of a study: what it overrides, and the complete scene that follows.

    Attributes
    ----------
    values : tuple of (key, text)
        In the order of the axes.
    scene : Scene
    text : str
        The complete deck, as the run writes it into its folder.
    """

    values: tuple[tuple[str, str], ...]
    scene: Scene
    text: str

    @property
    def overrides(self) -> list[str]:
        """Its values as ``--set`` takes them."""
        return [f"{key}={value}" for key, value in self.values]

    @property
    def label(self) -> str:
        """Its values in one line."""
        return " ".join(self.overrides)

    @property
    def name(self) -> str:
        """Of its folder: the values, or a shortened form that is still its own."""
        plain = "+".join(self.overrides)
        safe = re.sub(r"[^A-Za-z0-9_.=+-]+", "_", plain)
        if safe != plain or len(safe) > MAX_NAME:
            safe = f"{safe[:MAX_NAME]}-{hashlib.sha256(plain.encode()).hexdigest()[:8]}"
        return safe

    @property
    def sha256(self) -> str:
        """Hash of the complete deck, as in the summary of its run."""
        return hashlib.sha256(self.text.encode()).hexdigest()


def parse_axes(texts: Sequence[str]) -> list[Axis]:
    """Split ``key=value1,value2`` and, for keys that change together, ``key1:key2=a1:b1,a2:b2``.

    Raises
    ------
    StudyError
        With all problems.
    """
    axes, problems = [], []
    for text in texts:
        left, equals, right = text.partition("=")
        keys = tuple(key.strip() for key in left.split(":"))
        values = tuple(tuple(_split(value, ":")) for value in _split(right, ","))
        if not equals or not all(keys) or not all(all(value) for value in values):
            problems.append(
                f"--vary {text}: must read key=value1,value2, for example mesh.spacing=0.1,0.05; keys that change "
                "together read key1:key2=a1:b1,a2:b2."
            )
            continue
        if uneven := [value for value in values if len(value) != len(keys)]:
            problems.append(
                f"--vary {text}: {':'.join(uneven[0])} has {len(uneven[0])} values for {len(keys)} keys. Separate the "
                "values of one member by : and members by a comma."
            )
        axes.append(Axis(keys, values))
    seen: set[str] = set()
    for key in (key for axis in axes for key in axis.keys):
        if key in seen:
            problems.append(f"--vary {key}: this key is varied twice. Give all of its values in one --vary.")
        seen.add(key)
    if problems:
        raise StudyError(problems)
    return axes


def _split(text: str, separator: str) -> list[str]:
    """Split outside of brackets and quotes; parts without surrounding blanks."""
    parts, depth, quote = [""], 0, ""
    for character in text:
        if quote:
            quote = "" if character == quote else quote
        elif character in "\"'":
            quote = character
        elif character in "[{":
            depth += 1
        elif character in "]}":
            depth -= 1
        if character == separator and not depth and not quote:
            parts.append("")
        else:
            parts[-1] += character
    return [part.strip() for part in parts]


def make_members(deck: Path, axes: Sequence[Axis], overrides: Sequence[str] = ()) -> list[Member]:
    """Validate the deck of every member before any of them runs.

    Returns
    -------
    list of Member
        All combinations, the last axis fastest.

    Raises
    ------
    DeckError
        The deck cannot be read.
    StudyError
        With the problems of all members, each sentence once.
    """
    count = 1
    for axis in axes:
        count *= len(axis.values)
    if count > MAX_MEMBERS:
        raise StudyError([f"--vary makes {count:,} members, and {MAX_MEMBERS:,} are the most. Give fewer values."])
    base = read_text(deck)
    varied = {key for axis in axes for key in axis.keys}
    problems = [
        f"--set {text}: --vary changes this key too. Leave one of them away."
        for text in overrides
        if text.partition("=")[0].strip() in varied
    ]
    members: list[Member] = []
    for chosen in itertools.product(*(axis.values for axis in axes)):
        values = tuple(
            pair for axis, value in zip(axes, chosen, strict=True) for pair in zip(axis.keys, value, strict=True)
        )
        try:
            scene = parse_deck(base, str(deck), [*overrides, *(f"{key}={value}" for key, value in values)])
        except DeckError as error:
            problems += [f"{message} (member {' '.join(map('='.join, values))})" for message in error.messages]
            continue
        members.append(Member(values, scene, write_deck(scene)))
    known: dict[str, Member] = {}
    for member in members:
        if member.sha256 in known:
            problems.append(
                f"members {known[member.sha256].label} and {member.label} are the same deck. Leave one of them away."
            )
        known.setdefault(member.sha256, member)
    if problems:
        raise StudyError(problems)
    return members
