"""Abaqus and CalculiX files: nodes, elements and sets of one part, each line read or refused by its number.

Only the mesh is read: sections, materials, loads and steps are passed over and named. Other solids than hexahedra of
eight nodes are refused; shells, trusses, springs and points stay beside the body, make sets, and are counted.
"""

from __future__ import annotations

import difflib
import re
from dataclasses import dataclass, field

import numpy as np

from pdfem_mpi.mesh.abaqus_cards import Card, cards_of, fields_of, number_table, real_number, whole_number
from pdfem_mpi.mesh.abaqus_sets import Elements, Nodes, Sets
from pdfem_mpi.mesh.abaqus_surfaces import find_surfaces
from pdfem_mpi.mesh.raw import RawMesh, Refusal, excerpt

#: Element types by what they are here; the first that fits. Others are solids that are refused, or no type at all.
KINDS = (
    (r"(DC|C)3D8[A-Z]*", "hexahedron"),
    (r"(S|DS|M3D|SFM3D|R3D|CPS|CPE|CPEG|CAX|DC2D)4[A-Z]*5?", "quad"),
    (r"(S|DS|M3D|SFM3D|R3D|CPS|CPE|CPEG|CAX|DC2D)3[A-Z]*|STRI3", "triangle"),
    (r"(T[23]D2|B[23][13]|PIPE[23]1|FRAME[23]D|R[23]D2|RB[23]D2|DC1D2)[A-Z]*", "line"),
    (r"MASS|ROTARYI|SPRING1|DASHPOT1|HEATCAP", "vertex"),
    (r"(SPRING|DASHPOT|GAP|CONN|JOINT|ITS|MCL|DCOUP)[A-Z0-9]*", "spring"),
    (r"(S|DS|M3D|SFM3D|CPS|CPE|CPEG|CAX|DC2D|STRI)[689]5?[A-Z]*5?|(T[23]D3|B[23]2|PIPE[23]2|DC1D3)[A-Z]*", "surface"),
)
CORNERS = {"hexahedron": 8, "quad": 4, "triangle": 3, "line": 2, "vertex": 1}
#: Keywords that make, move or fetch nodes and elements.
GENERATORS = ("NGEN", "NFILL", "NCOPY", "NMAP", "ELGEN", "ELCOPY", "SYSTEM", "INCLUDE", "PARAMETER")
READ = (
    "NODE", "ELEMENT", "NSET", "ELSET", "SURFACE",
    "PART", "END PART", "ASSEMBLY", "END ASSEMBLY", "INSTANCE", "END INSTANCE",
)  # fmt: skip
#: Keywords that say nothing of a body.
TITLES = ("HEADING", "PREPRINT")
#: A keyword this similar to one that is read is a slip of the pen.
SIMILAR = 0.8
#: Coordinates of a row, and with the normal that may follow them.
COORDINATES, WITH_NORMAL = 3, 6


@dataclass
class _Reader:
    """What the cards of a file have given so far."""

    nodes: Nodes = field(default_factory=Nodes)
    elements: Elements = field(default_factory=Elements)
    sets: Sets = field(default_factory=Sets)
    surfaces: list[tuple[Card, str]] = field(default_factory=list)
    passed: dict[str, None] = field(default_factory=dict)
    part: str | None = None
    instance: str | None = None
    inside: set[str] = field(default_factory=set)
    beside: dict[str, list[int]] = field(default_factory=dict)

    @property
    def space(self) -> str:
        """Where names belong to: the part, or the assembly."""
        return "assembly" if "ASSEMBLY" in self.inside and "INSTANCE" not in self.inside else "part"

    def take(self, card: Card) -> None:
        """Read one card."""
        word = card.word
        if word in GENERATORS:
            raise Refusal(_generator(card))
        if word not in READ:
            if near := difflib.get_close_matches(word, READ, 1, SIMILAR):
                raise Refusal(f"line {card.line}: *{word} is no keyword that is known. Did you mean *{near[0]}?")
            if word not in TITLES:
                self.passed[f"*{word}"] = None
        elif word == "NODE":
            self._take_nodes(card)
        elif word == "ELEMENT":
            self._take_elements(card)
        elif word in ("NSET", "ELSET"):
            self.sets.take(card, self.space)
        elif word == "SURFACE":
            self.surfaces.append((card, self.space))
        elif word.startswith("END "):
            self.inside.discard(word.removeprefix("END "))
        else:
            self.inside.add(word)
            if word != "ASSEMBLY":
                self._enter(card)

    def _enter(self, card: Card) -> None:
        """A part or an instance begins: the first of each, in its place, can be read."""
        name = card.options.get("NAME", "")
        moved = card.word == "INSTANCE" and any(
            real_number(item, line) != 0.0 for row, line in zip(card.rows, card.lines, strict=True)
            for item in fields_of(row)
        )  # fmt: skip
        if card.word == "PART":
            again, self.part = self.part, name
        else:
            again, self.instance = self.instance, name
        if again is not None or moved:
            what = f"is the second {card.word.lower()}" if again is not None else "is moved from its part's place"
            raise Refusal(
                f"line {card.line}: {excerpt(name)} {what}, which is not read. Write one part in its place "
                "(Abaqus: merge the instances into one part)."
            )

    def _take_nodes(self, card: Card) -> None:
        card.allow("NSET", "SYSTEM")
        if card.options.get("SYSTEM", "R").upper() not in ("", "R"):
            raise Refusal(f"line {card.line}: cylindrical or spherical coordinates of nodes. Write Cartesian ones.")
        table = number_table(card, 1 + COORDINATES, whole=False)
        if table is None or (table[:, 0] != np.floor(table[:, 0])).any() or (np.abs(table[:, 0]) > 2**53).any():
            numbers, places = np.empty(len(card.rows), np.int64), np.empty((len(card.rows), COORDINATES))
            for k, (row, line) in enumerate(zip(card.rows, card.lines, strict=True)):
                first, *rest = fields_of(row)
                numbers[k] = whole_number(first, line, "a node")
                if not COORDINATES <= len(rest) <= WITH_NORMAL:
                    raise Refusal(
                        f"line {line}: node {numbers[k]} has {len(rest)} coordinates. Write three; a file that ends "
                        "here was cut off."
                    )
                values = [real_number(item, line) for item in rest]
                places[k] = values[:COORDINATES]
        else:
            numbers, places = table[:, 0].astype(np.int64), table[:, 1:]
        self.nodes.add(self.space, numbers, places, np.array(card.lines, np.int64))
        if "NSET" in card.options:
            self.sets.add_block(card, "NSET", self.space, numbers)

    def _take_elements(self, card: Card) -> None:
        card.allow("TYPE", "ELSET", "SOLID ELEMENT NUMBERING")
        called = card.options.get("TYPE", "").upper()
        kind = next((kind for pattern, kind in KINDS if re.fullmatch(pattern, called)), "")
        if not kind or (kind == "hexahedron" and self.space == "assembly"):
            raise Refusal(
                f"line {card.line}: {len(card.rows)} rows of elements of type {excerpt(called)}, which cannot be read. "
                "Mesh the body with hexahedra of eight nodes (C3D8)."
            )
        if self.space == "assembly":
            self.beside.setdefault(called, []).extend(card.lines)
            return
        numbers, corners = _element_rows(card, kind)
        self.elements.add(kind, called, card.line, numbers, corners)
        if "ELSET" in card.options:
            self.sets.add_block(card, "ELSET", self.space, numbers)


def _generator(card: Card) -> str:
    if card.word == "INCLUDE":
        file = excerpt(card.options.get("INPUT", ""))
        return (
            f"line {card.line}: *INCLUDE of {file}, which is not followed. Give that file as mesh.path if it holds the "
            "mesh, or put its text in place of this line."
        )
    return f"line {card.line}: *{card.word}, which is not read. Write the nodes and elements themselves."


def _element_rows(card: Card, kind: str) -> tuple[np.ndarray, np.ndarray]:
    """Numbers of elements, (n,), and of their nodes, (n, k); rows go on where a line ends with a comma."""
    width = CORNERS.get(kind, 0)
    if width and (table := number_table(card, 1 + width, whole=True)) is not None:
        return table[:, 0], table[:, 1:]
    numbers, corners, row, start = [], [], [], 0
    for k, (text, line) in enumerate(zip(card.rows, card.lines, strict=True)):
        start = start if row else line
        row += fields_of(text)
        last = k + 1 == len(card.rows)
        if text.rstrip().endswith(b",") and len(row) <= width and not last:
            continue
        if text.rstrip().endswith(b",") and not width and not last:
            continue
        numbers.append(whole_number(row[0], start, "an element"))
        if width and (len(row) != 1 + width and not (kind == "line" and len(row) > 1 + width)):
            raise Refusal(
                f"line {start}: element {numbers[-1]} of type {card.options['TYPE']} has {len(row) - 1} nodes and "
                f"not {width}. Correct the line; a file that ends here was cut off."
            )
        corners.append([whole_number(item, start, "a node") for item in row[1 : 1 + width]])
        row = []
    return np.array(numbers, np.int64), np.array(corners, np.int64).reshape(len(numbers), width)


def read_abaqus(content: bytes) -> RawMesh:
    """Read the content of a file.

    Raises
    ------
    Refusal
        With the line, what was found and what to do.
    """
    reader = _Reader()
    for card in cards_of(content):
        reader.take(card)
    numbers, points, again = reader.nodes.once()
    blocks, of_elements = reader.elements.blocks(numbers)
    raw = RawMesh(points, blocks, folded=True)
    if again:
        raw.notes.append(f"{again} nodes are there twice, with the same number at the same place")
    reader.sets.resolve(raw, numbers, of_elements, reader.instance or reader.part or "")
    find_surfaces(raw, reader.surfaces, reader.sets)
    _note(raw, reader)
    return raw


def _note(raw: RawMesh, reader: _Reader) -> None:
    extra = len(reader.nodes.of("assembly")[0])
    if extra:
        raw.notes.append(f"left out {extra} nodes of the assembly, such as reference points")
    for called, lines in reader.beside.items():
        raw.notes.append(f"left out {len(lines)} elements of type {called} of the assembly (line {lines[0]})")
    if reader.passed:
        raw.notes.append(f"only the mesh is read; passed over: {', '.join(sorted(reader.passed))}")
