"""Nodes, elements and sets of an Abaqus file by their numbers and names.

A set may come in several parts, before or after its members, as ranges (by 1 unless they say otherwise), as the block
of a *NODE or *ELEMENT, or as other sets. Names that differ by case only are one name, as in Abaqus.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from pdfem_mpi.mesh.abaqus_cards import WHOLE, Card, fields_of, numbers_in, whole_number
from pdfem_mpi.mesh.raw import Block, RawMesh, Refusal, excerpt, places_of, repeated


@dataclass
class Nodes:
    """Rows of all *NODE cards of the part and of the assembly."""

    rows: list[tuple[str, np.ndarray, np.ndarray, np.ndarray]] = field(default_factory=list)

    def add(self, space: str, numbers: np.ndarray, places: np.ndarray, lines: np.ndarray) -> None:
        """Add the rows of one card."""
        self.rows.append((space, numbers, places, lines))

    def of(self, space: str) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        """Numbers (n,), places (n, 3) and lines (n,) in the file's order."""
        rows = [row[1:] for row in self.rows if row[0] == space]
        if not rows:
            return np.empty(0, np.int64), np.empty((0, 3)), np.empty(0, np.int64)
        return tuple(np.concatenate(column) for column in zip(*rows, strict=True))

    def once(self) -> tuple[np.ndarray, np.ndarray, int]:
        """Numbers and places of the part's nodes, and how many came again; refused if at another place."""
        numbers, places, lines = self.of("part")
        again = repeated(numbers)
        if not len(again):
            return numbers, places, 0
        first, where = np.unique(numbers, return_index=True)
        before = where[np.searchsorted(first, numbers[again])]
        moved = np.flatnonzero((places[again] != places[before]).any(axis=1))
        if len(moved):
            place, earlier = again[moved[0]], before[moved[0]]
            raise Refusal(
                f"line {lines[place]}: node {numbers[place]} is there already, at line {lines[earlier]} and at another "
                "place. Give each node one number."
            )
        kept = np.delete(np.arange(len(numbers)), again)
        return numbers[kept], places[kept], len(again)


@dataclass
class Elements:
    """Rows of all *ELEMENT cards of the part."""

    rows: list[tuple[str, str, int, np.ndarray, np.ndarray]] = field(default_factory=list)

    def add(self, kind: str, called: str, line: int, numbers: np.ndarray, corners: np.ndarray) -> None:
        """Add the rows of one card."""
        if len(numbers):
            self.rows.append((kind, called, line, numbers, corners))

    def blocks(self, node_numbers: np.ndarray) -> tuple[list[Block], np.ndarray]:
        """Blocks with the places of their nodes, and the numbers of all elements."""
        numbers = np.concatenate([row[3] for row in self.rows]) if self.rows else np.empty(0, np.int64)
        again = repeated(numbers)
        if len(again):
            line = self._line(again[0])
            raise Refusal(f"line {line}: element {numbers[again[0]]} is there already. Give each element one number.")
        blocks = []
        for kind, called, line, own, corners in self.rows:
            places = places_of(node_numbers, corners)
            lost = np.flatnonzero((places < 0).any(axis=1))
            if len(lost):
                node = corners[lost[0]][places[lost[0]] < 0][0]
                raise Refusal(
                    f"line {line}: element {own[lost[0]]} of the block that begins here names node {node}, which the "
                    "file does not have. Write the mesh again, with all nodes."
                )
            blocks.append(Block(kind, places, f"{called}, line {line}"))
        return blocks, numbers

    def _line(self, place: int) -> int:
        """The line of the card of an element."""
        end = 0
        for row in self.rows:
            end += len(row[3])
            if place < end:
                break
        return row[2]


@dataclass
class _Set:
    """One name: numbers, ranges and other names, each with the card or line it came from."""

    name: str
    line: int
    numbers: list[tuple[bool, np.ndarray, Card]] = field(default_factory=list)
    ranges: list[tuple[bool, int, int, int, int]] = field(default_factory=list)
    others: list[tuple[str, str, int]] = field(default_factory=list)


@dataclass
class Sets:
    """All sets by the space their name belongs to, their kind, and their name in upper case."""

    table: dict[tuple[str, str, str], _Set] = field(default_factory=dict)
    found: dict[tuple[str, str, str], np.ndarray] = field(default_factory=dict)
    owner: str = ""
    numbers: dict[str, np.ndarray] = field(default_factory=dict)
    corners: list[Block] = field(default_factory=list)

    def _entry(self, card: Card, kind: str, space: str) -> _Set:
        name = card.options.get(kind) or card.options.get("NAME", "")
        if not name:
            raise Refusal(f"line {card.line}: *{card.word} without the name of a set. Write {kind}=NAME.")
        return self.table.setdefault((space, kind, name.upper()), _Set(name, card.line))

    def add_block(self, card: Card, kind: str, space: str, numbers: np.ndarray) -> None:
        """The items of a *NODE or *ELEMENT card make a set."""
        self._entry(card, kind, space).numbers.append((space == "part", numbers, card))

    def take(self, card: Card, space: str) -> None:
        """Read a *NSET or *ELSET card."""
        kind = card.word
        card.allow("NSET", "ELSET", "GENERATE", "INSTANCE", "INTERNAL", "UNSORTED", "NAME")
        entry = self._entry(card, kind, space)
        of_part = space == "part" or "INSTANCE" in card.options
        inner = "part" if of_part else space
        if kind == "NSET" and "ELSET" in card.options:
            entry.others.append((inner, f"ELSET {card.options['ELSET']}", card.line))
        if "GENERATE" in card.options:
            for row, line in zip(card.rows, card.lines, strict=True):
                entry.ranges.append((of_part, *_range(row, line), line))
            return
        text = b",".join(row.strip().rstrip(b", \t") for row in card.rows)
        numbers = numbers_in(text, whole=True) if text else np.empty(0, np.int64)
        if numbers is not None and len(numbers) == (text.count(b",") + 1 if text else 0):
            entry.numbers.append((of_part, numbers, card))
            return
        some = []
        for row, line in zip(card.rows, card.lines, strict=True):
            for item in filter(None, fields_of(row)):
                if WHOLE.fullmatch(item):
                    some.append(whole_number(item, line, "a member"))
                else:
                    entry.others.append((inner, f"{kind} {item.decode('utf-8', 'replace')}", line))
        entry.numbers.append((of_part, np.array(some, np.int64), card))

    def resolve(self, raw: RawMesh, nodes: np.ndarray, elements: np.ndarray, owner: str) -> None:
        """Put all sets into the mesh under the names they were first given."""
        self.owner = owner.upper()
        self.numbers = {"NSET": nodes, "ELSET": elements}
        self.corners = raw.blocks
        gaps: dict[str, int] = {}
        for key in sorted(self.table, key=lambda key: key[0]):  # those of the assembly are what loads speak of
            space, kind, folded = key
            members = self._members(key, (), gaps)
            name = self.table[key].name
            hidden = space == "part" and ("assembly", kind, folded) in self.table
            if hidden:
                name = f"{owner}.{name}"
                raw.notes.append(
                    f"the {kind} {self.table[key].name} of the part is called {name} beside the assembly's"
                )
            if kind == "NSET":
                raw.nodes[name] = members
            else:
                chosen = np.zeros(len(elements), bool)
                chosen[members] = True
                raw.set_of_cells(name, chosen)
        for name, count in gaps.items():
            raw.notes.append(f"ranges of the set {name} name {count} numbers that the file does not have")

    def _members(self, key: tuple[str, str, str], above: tuple, gaps: dict[str, int]) -> np.ndarray:
        """Places of the members of a set among all nodes or elements of the part, ascending."""
        if key in self.found:
            return self.found[key]
        entry, numbers = self.table[key], self.numbers[key[1]]
        if key in above:
            raise Refusal(f"line {entry.line}: the set {entry.name} is made of itself. Write its members.")
        parts = [np.empty(0, np.int64)]
        for of_part, wanted, card in entry.numbers:
            places = places_of(numbers, wanted)
            if of_part and (places < 0).any():
                raise Refusal(_missing(entry, card, wanted[places < 0][0]))
            parts.append(places[places >= 0] if of_part else np.empty(0, np.int64))
        for of_part, first, last, step, line in entry.ranges:
            inside = (numbers >= first) & (numbers <= last) & ((numbers - first) % step == 0)
            if of_part and not inside.any():
                raise Refusal(
                    f"line {line}: the range {first} to {last} of the set {entry.name} holds no number that the file "
                    "has. Correct it, or write all nodes and elements."
                )
            gap = (last - first) // step + 1 - int(np.count_nonzero(inside))
            if of_part and gap:
                gaps[entry.name] = gaps.get(entry.name, 0) + gap
            parts.append(np.flatnonzero(inside) if of_part else np.empty(0, np.int64))
        for space, wanted, line in entry.others:
            kind, _, name = wanted.partition(" ")
            other = self.find(space, kind, name)
            if other is None:
                raise Refusal(
                    f"line {line}: the set {entry.name} is made of {excerpt(name)}, which is no {kind} of the file. "
                    "Correct the name, or write its members."
                )
            members = self._members(other, (*above, key), gaps)
            parts.append(members if kind == key[1] else self._nodes_of(members))
        self.found[key] = np.unique(np.concatenate(parts))
        return self.found[key]

    def find(self, space: str, kind: str, name: str) -> tuple[str, str, str] | None:
        """The key of a set by its name, seen from a part or the assembly; ``INSTANCE.NAME`` is one of the part."""
        folded = name.upper()
        before, dot, after = folded.partition(".")
        if dot and before == self.owner and ("part", kind, after) in self.table:
            return "part", kind, after
        for place in dict.fromkeys((space, "part", "assembly")):
            if (place, kind, folded) in self.table:
                return place, kind, folded
        return None

    def _nodes_of(self, elements: np.ndarray) -> np.ndarray:
        """Places of the nodes of some elements."""
        start, found = 0, [np.empty(0, np.int64)]
        for block in self.corners:
            own = elements[(elements >= start) & (elements < start + len(block.nodes))] - start
            found.append(block.nodes[own].reshape(-1))
            start += len(block.nodes)
        return np.concatenate(found)


def _range(row: bytes, line: int) -> tuple[int, int, int]:
    """First, last and step of a row of GENERATE; without a step it is 1, and one number is itself."""
    items = [whole_number(item, line, "a member") for item in fields_of(row) if item]
    if not 1 <= len(items) <= 3:
        raise Refusal(f"line {line}: {len(items)} numbers are no range. Write the first, the last and the step.")
    first, last, step = (*items, *((items[0], 1) if len(items) == 1 else (1,)))[:3]
    if step < 1 or last < first:
        raise Refusal(
            f"line {line}: the range {first} to {last} by {step} has no members. Write the smaller number first, and "
            "a step of at least 1."
        )
    return first, last, step


def _missing(entry: _Set, card: Card, number: int) -> str:
    line = next(
        (line for row, line in zip(card.rows, card.lines, strict=True) if str(number).encode() in row), card.line
    )
    what = "node" if card.word == "NSET" else "element"
    return (
        f"line {line}: the set {entry.name} has {what} {number}, which the file does not have. Correct the line, or "
        f"write all {what}s."
    )
