"""Studies: one deck run with several values of some keys, into one folder with one table and one figure.

``runs/NAME/study.csv`` has a row for each member, ``runs/NAME/study.png`` draws it, and ``runs/NAME/members/`` holds
the run folders. The table is written anew after each member. A member that has finished is known by the hash of its
complete deck and is not run again: the same command goes on where a study stopped.
"""

from __future__ import annotations

import hashlib
import itertools
import json
import re
import signal
import subprocess
import sys
import tomllib
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from pdfem_mpi.deck.scene import Scene
from pdfem_mpi.deck.table import DeckError, show
from pdfem_mpi.deck.toml import dimension_of, parse_deck, read_text, write_deck
from pdfem_mpi.results.labels import attempt
from pdfem_mpi.results.ownership import refuse_study
from pdfem_mpi.results.study import Series, draw_study, write_table
from pdfem_mpi.system.exit_codes import EXIT_FINISHED, EXIT_INTERNAL_ERROR, EXIT_STOPPED, MEMBER_STATUS
from pdfem_mpi.system.plain_files import read_plain

MOST_BYTES = 1 << 24  # of a summary
MAX_MEMBERS = 1000  # a product of values typed by mistake
MAX_NAME = 100  # characters of a member's folder
# Of a summary: what tells nothing about the case, and the wall times, which go last
NOT_RESULTS = ("schema_version", "exit_code", "ranks", "versions")
WALL_TIMES = "seconds."


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


@dataclass
class Outcome:
    """What is known of a member: a status, an exit code once it ran, and the summary of a run that finished."""

    status: str = "waiting"
    exit_code: int | None = None
    reason: str = ""
    summary: dict[str, Any] = field(default_factory=dict)


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


def outcome_in(folder: Path, member: Member) -> Outcome:
    """What the folder of a member tells: waiting, or how its run ended, if that was a run of the same deck."""
    summary = _summary(folder)
    if not summary or summary.get("deck_sha256") != member.sha256:
        return Outcome()
    code = summary.get("exit_code")
    if code == EXIT_FINISHED:
        return Outcome("finished", code, "", summary)
    return Outcome(MEMBER_STATUS.get(code, "failed"), code, str(summary.get("reason") or ""), summary)


def changed_members(members: Sequence[Member], folder: Path) -> list[str]:
    """One sentence for each member whose folder holds a run of another deck."""
    sentences = []
    for member in members:
        place = folder / "members" / member.name
        summary = _summary(place)
        if summary and summary.get("deck_sha256") != member.sha256:
            sentences.append(
                f"{place}: was run with another deck{_differences(place / 'deck.toml', member.text)}. Use --overwrite "
                "to run it anew, or another folder with --out."
            )
    return sentences


def check_folder(folder: Path) -> None:
    """Refuse a folder with the files of others.

    Raises
    ------
    StudyError
    """
    if reason := refuse_study(folder):
        raise StudyError([reason])


def _summary(folder: Path) -> dict[str, Any]:
    try:
        summary = json.loads(read_plain(folder / "summary.json", MOST_BYTES))
    except (OSError, ValueError):
        return {}
    return summary if isinstance(summary, dict) else {}


def _differences(path: Path, text: str) -> str:
    """The first few keys in which a deck differs from another."""
    try:
        then = dict(_leaves(tomllib.loads(path.read_text(encoding="utf-8"))))
    except (OSError, ValueError):
        return ""
    now = dict(_leaves(tomllib.loads(text)))
    keys = [key for key in {**then, **now} if then.get(key) != now.get(key)]
    told = [f"{key} = {show(then.get(key, 'not there'))}, now {show(now.get(key, 'not there'))}" for key in keys[:3]]
    more = f", and {len(keys) - 3} more keys" if len(keys) > 3 else ""
    return f" ({'; '.join(told)}{more})" if told else ""


def _leaves(value: Any, path: str = "") -> Iterator[tuple[str, Any]]:
    """Dotted paths and values of nested tables and lists of tables; lists of numbers are values."""
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list) and value and isinstance(value[0], dict):
        items = enumerate(value)
    else:
        yield path, value
        return
    for key, item in items:
        yield from _leaves(item, f"{path}.{key}" if path else str(key))


Start = Callable[[Member, Path, bool], tuple[int, str]]


@dataclass
class Interruption:
    """A signal to the study: remembered, and passed on to the member that runs."""

    process: subprocess.Popen | None = None
    signal: int | None = None

    @contextmanager
    def listening(self) -> Iterator[None]:
        """Take SIGINT, SIGTERM and SIGUSR1 while members run."""

        def take(number, frame):
            self.signal = number
            if self.process is not None and self.process.poll() is None:
                # a member asked to stop writes what it can; an impatient person sends SIGTERM after SIGUSR1
                self.process.send_signal(signal.SIGUSR1 if number == signal.SIGUSR1 else signal.SIGTERM)

        before = {number: signal.signal(number, take) for number in (signal.SIGINT, signal.SIGTERM, signal.SIGUSR1)}
        try:
            yield
        finally:
            for number, handler in before.items():
                signal.signal(number, handler)


def starter(deck: Path, overrides: Sequence[str], ranks: int | None, interruption: Interruption) -> Start:
    """Return what starts a member as ``pdfem run`` in its own processes, its output in a file of its own."""

    def start(member: Member, folder: Path, overwrite: bool) -> tuple[int, str]:
        command = [sys.executable, "-m", "pdfem_mpi", "run", str(deck), "--out", str(folder)]
        command += [word for text in (*overrides, *member.overrides) for word in ("--set", text)]
        command += ["-n", str(ranks)] if ranks else []
        command += ["--overwrite"] if overwrite else []
        log = folder.parent.parent / "logs" / f"{folder.name}.log"
        log.parent.mkdir(parents=True, exist_ok=True)
        log.unlink(missing_ok=True)  # a link or a pipe of that name must not be written through
        with log.open("wb") as output:
            # of its own session: a terminal's Ctrl-C reaches it through the study, once
            process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.PIPE,
                start_new_session=True,
            )
            interruption.process = process
            errors = process.communicate()[1].decode("utf-8", "replace")
            interruption.process = None
            output.write(errors.encode())
        lines = [line for line in errors.splitlines() if line.strip()]
        return process.returncode, lines[-1].strip() if lines else ""

    return start


def follow(
    members: Sequence[Member],
    folder: Path,
    start: Start,
    tell: Callable[[str], None],
    interruption: Interruption,
    update: Callable[[list[Outcome]], None],
) -> list[Outcome]:
    """Run the members that have not finished, one after another; a failed member is told and the rest goes on.

    Parameters
    ----------
    start : callable
        ``(member, folder, overwrite) -> (exit code, last line of its errors)``.
    update : callable
        Called with all outcomes whenever one has changed, and once before the first.

    Returns
    -------
    list of Outcome
        In the order of the members.
    """
    places = [folder / "members" / member.name for member in members]
    outcomes = [outcome_in(place, member) for place, member in zip(places, members, strict=True)]
    update(outcomes)
    for number, (member, place) in enumerate(zip(members, places, strict=True)):
        position = f"{number + 1}/{len(members)} {member.label}"
        if outcomes[number].status == "finished":
            tell(f"{position}: finished before")
            continue
        if interruption.signal is not None:
            break
        # a member that was stopped goes on from its checkpoint; any other result of an earlier run is replaced
        overwrite = bool(_summary(place)) and outcomes[number].exit_code != EXIT_STOPPED
        code, line = start(member, place, overwrite)
        outcomes[number] = _judge(member, place, code, line)
        if interruption.signal is not None and outcomes[number].status == "failed":
            outcomes[number] = Outcome("stopped", EXIT_STOPPED, "by a signal to the study")
        tell(f"{position}: {_told(outcomes[number])}")
        update(outcomes)
    return outcomes


def _judge(member: Member, place: Path, code: int, line: str) -> Outcome:
    """The outcome of a member that has just run."""
    found = outcome_in(place, member)
    if code == EXIT_FINISHED:
        if found.status == "finished":
            return found
        reason = "its deck was changed while the study ran" if _summary(place) else "it left no summary.json"
        return Outcome("failed", EXIT_INTERNAL_ERROR, reason)
    if code in MEMBER_STATUS:
        return Outcome(MEMBER_STATUS[code], code, found.reason or line)
    how = f"ended by signal {-code}" if code < 0 else f"exit code {code}"
    return Outcome("failed", code, ": ".join(filter(None, (how, line))))


def _told(outcome: Outcome) -> str:
    if outcome.status != "finished":
        return f"{outcome.status} ({outcome.reason})" if outcome.reason else outcome.status
    evaluations = outcome.summary.get("solve", {}).get("evaluations")
    seconds = outcome.summary.get("seconds", {}).get("total")
    words = [f"{evaluations:,} evaluations" if evaluations else "", f"{seconds:.1f} s" if seconds else ""]
    return ", ".join(["finished", *filter(None, words)])


def exit_code(outcomes: Sequence[Outcome], interruption: Interruption) -> int:
    """0 if all members have finished, 75 if the study was stopped, else the code of the first that failed."""
    if all(outcome.status == "finished" for outcome in outcomes):
        return EXIT_FINISHED
    if interruption.signal is not None:
        return EXIT_STOPPED
    code = next(outcome.exit_code for outcome in outcomes if outcome.status != "finished")
    return code if code in MEMBER_STATUS else EXIT_INTERNAL_ERROR


def results_of(summary: dict[str, Any]) -> dict[str, float]:
    """All numbers of a summary by dotted name; probes without prefix, vectors by component, wall times last."""
    found: dict[str, float] = {}

    def visit(name: str, value: Any) -> None:
        if isinstance(value, dict):
            for key, item in value.items():
                visit(f"{name}.{key}" if name and name != "probes" else key, item)
        elif isinstance(value, list) and len(value) == 3 and all(isinstance(item, float) for item in value):
            for axis, item in zip("xyz", value, strict=True):
                visit(f"{name}_{axis}", item)
        elif isinstance(value, int | float) and not isinstance(value, bool):
            found[name] = value

    for key, value in summary.items():
        if key not in NOT_RESULTS:
            visit(key, value)
    return dict(sorted(found.items(), key=lambda item: item[0].startswith(WALL_TIMES)))


def table(members: Sequence[Member], outcomes: Sequence[Outcome]) -> tuple[list[str], list[list[Any]]]:
    """Header and rows of ``study.csv``: the varied keys, how the member ended, and all numbers of its summary."""
    results = [results_of(outcome.summary) if outcome.status == "finished" else {} for outcome in outcomes]
    names = list(dict.fromkeys(name for row in results for name in row))
    names.sort(key=lambda name: name.startswith(WALL_TIMES))  # stable: the order of the summaries is kept
    keys = [key for key, _ in members[0].values]
    header = [*keys, "status", "exit_code", "reason", "folder", "deck_sha256", *names]
    rows = []
    for member, outcome, found in zip(members, outcomes, results, strict=True):
        values = [_unquoted(value) for _, value in member.values]
        code = "" if outcome.exit_code is None else outcome.exit_code
        fixed = [outcome.status, code, outcome.reason, f"members/{member.name}", member.sha256]
        rows.append([*values, *fixed, *(found.get(name, "") for name in names)])
    return header, rows


def _unquoted(text: str) -> str:
    return text[1:-1] if len(text) > 1 and text[0] == text[-1] and text[0] in "\"'" else text


def choose_results(outcomes: Sequence[Outcome], wanted: Sequence[str]) -> list[str]:
    """Names of the results to draw: those wanted, else what probes measured, else the number of evaluations.

    Raises
    ------
    StudyError
        For a name that no member has.
    """
    found = [results_of(outcome.summary) for outcome in outcomes if outcome.status == "finished"]
    if wanted:
        names = list(dict.fromkeys(name for row in found for name in row))
        unknown = [name for name in wanted if name not in names]
        if unknown and found:
            raise StudyError(
                [f"--plot {name}: no such result. The columns of study.csv are {', '.join(names)}." for name in unknown]
            )
        return [name for name in wanted if name in names]
    probed = [results_of({"probes": outcome.summary.get("probes", {})}) for outcome in outcomes]
    names = list(dict.fromkeys(name for row in probed for name in row))
    largest = {name: max(abs(row.get(name, 0.0)) for row in probed) for name in names}
    top = {name.rpartition("_")[0]: 0.0 for name in names}
    for name in names:
        top[name.rpartition("_")[0]] = max(top[name.rpartition("_")[0]], largest[name])
    # components of a vector that symmetry makes 0 show round-off
    return [name for name in names if largest[name] > 1e-6 * top[name.rpartition("_")[0]]] or ["solve.evaluations"]


def draw(
    path: Path,
    members: Sequence[Member],
    axes: Sequence[Axis],
    outcomes: Sequence[Outcome],
    wanted: Sequence[str],
    tell: Callable[[str], None],
) -> None:
    """Draw results over the first axis, one curve for each combination of the others; nothing without results.

    Raises
    ------
    StudyError
        For a wanted name that no member has.
    """
    names = choose_results(outcomes, wanted)
    if not any(outcome.status == "finished" for outcome in outcomes):
        return
    key = axes[0].keys[-1]
    n_first = len(axes[0].keys)
    curves: dict[str, list[tuple[str, dict[str, float]]]] = {}
    for member, outcome in zip(members, outcomes, strict=True):
        others = ", ".join(f"{name} = {_unquoted(value)}" for name, value in member.values[n_first:])
        row = results_of(outcome.summary) if outcome.status == "finished" else {}
        curves.setdefault(others, []).append((_unquoted(dict(member.values)[key]), row))
    series = [
        Series(label, [x for x, _ in points], {name: [row.get(name) for _, row in points] for name in names})
        for label, points in curves.items()
    ]
    scene = members[0].scene
    unit = unit_of(scene, dimension_of(scene, key))
    failed = sum(outcome.status not in ("finished", "waiting") for outcome in outcomes)
    note = f"{failed} of {len(members)} members failed" if failed else ""
    units = {name: unit_of(scene, "length") for name in names if _is_displacement(scene, name)}
    along = f"{key}{f' ({unit})' if unit else ''}"
    attempt(lambda: draw_study(path, series, along, units, scene.title, note), path, tell)


def _is_displacement(scene: Scene, name: str) -> bool:
    probes = {probe.name for probe in scene.probes if probe.kind == "displacement"}
    return name == "end_displacement" or (name[-2:] in ("_x", "_y", "_z") and name[:-2] in probes)


def unit_of(scene: Scene, dimension: str) -> str:
    """A dimension in the deck's units; empty where the deck names none."""
    words = {"length": scene.units.length, "force": scene.units.force}
    if not all(words[word] for word in words if word in dimension) or dimension in ("", "1"):
        return ""
    return re.sub("length|force", lambda match: words[match.group()], dimension).replace(" / ", "/")


def run_study(
    members: Sequence[Member],
    axes: Sequence[Axis],
    folder: Path,
    start: Start,
    tell: Callable[[str], None],
    wanted: Sequence[str] = (),
    interruption: Interruption | None = None,
) -> int:
    """Run what is left of a study, keeping ``study.csv`` up to date, and draw it.

    Returns
    -------
    int
        As `exit_code`.

    Raises
    ------
    StudyError
        A wanted result that no member has; the table is there.
    OSError
        The folder cannot be written.
    """
    interruption = interruption or Interruption()
    folder.mkdir(parents=True, exist_ok=True)

    def update(outcomes):
        write_table(folder / "study.csv", *table(members, outcomes))

    with interruption.listening():
        outcomes = follow(members, folder, start, tell, interruption, update)
    draw(folder / "study.png", members, axes, outcomes, wanted, tell)
    return exit_code(outcomes, interruption)
