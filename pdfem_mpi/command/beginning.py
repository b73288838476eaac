"""`pdfem init`: a commented deck to begin with, the schema by which editors know its keys, its mesh if it has one."""

from __future__ import annotations

import itertools
import json
from collections.abc import Iterable
from importlib import resources
from pathlib import Path

from pdfem_mpi.deck.schema import SCHEMA_FILE, deck_schema
from pdfem_mpi.system.files import replacing

#: Decks to begin with, and what each is.
TEMPLATES = {
    "bar": "elastic bar under tension, half finite elements and half peridynamics (seconds)",
    "plate": "plate with a hole, pulled until it breaks (half a minute)",
    "bending": "notched beam in three-point bending, a crack that grows (half a minute)",
    "bracket": "L-shaped bracket from a mesh file, pressed until it breaks (half a minute)",
    "experiment": "notched beam of concrete, steered by the opening of its crack as in a laboratory (half a minute)",
}


class NotBegun(Exception):
    """A deck that is not written; the sentence has the remedy."""


def begin(name: Path, template: str) -> list[Path]:
    """Write a deck and what belongs to it; the files written.

    Parameters
    ----------
    name : Path
        The deck, with or without its suffix.
    template : str
        One of `TEMPLATES`.

    Raises
    ------
    NotBegun
        A file is there already; nothing is written then.
    OSError
    """
    deck = name if name.suffix == ".toml" else name.with_name(f"{name.name}.toml")
    text = resources.files("pdfem_mpi.command").joinpath(f"templates/{template}.toml").read_text("utf-8")
    text = text.replace("NAME", deck.stem)
    files = {deck: text}
    if template == "bracket":
        mesh = deck.with_name(f"{deck.stem}.inp")
        files = {mesh: bracket_mesh(), deck: text.replace("MESH", mesh.name)}
    for path in files:
        if path.exists():
            raise NotBegun(f"{path} is there already, and is left alone. Give another name, or move it.")
    schema = deck.with_name(SCHEMA_FILE)
    if not schema.exists():
        files[schema] = schema_text()
    deck.parent.mkdir(parents=True, exist_ok=True)
    for path, content in files.items():
        with replacing(path) as temporary:
            Path(temporary).write_text(content, encoding="utf-8")
    return list(files)


def schema_text() -> str:
    """The schema of decks as the text of a file."""
    return json.dumps(deck_schema(), indent=1, ensure_ascii=False) + "\n"


def bracket_mesh(arm: int = 20, width: int = 5, depth: int = 3, edge: float = 2.0) -> str:
    """An L of cubic cells as an Abaqus file, with the sets that the deck names.

    Parameters
    ----------
    arm, width, depth : int
        Cells along an arm, across it, and along z.
    edge : float, dimension length
    """
    cells = [
        (i, j, k)
        for k, j, i in itertools.product(range(depth), range(arm), range(arm))
        if i < width or j >= arm - width
    ]
    corners = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1)]
    places = sorted({(i + a, j + b, k + c) for i, j, k in cells for a, b, c in corners}, key=lambda p: p[::-1])
    number = {place: n for n, place in enumerate(places, start=1)}
    from_corner = {cell: max(cell[0], arm - 1 - cell[1]) for cell in cells}
    inner, outer = width + 2, width + 5
    sets = {
        "corner": [n for n, cell in enumerate(cells, start=1) if from_corner[cell] < inner],
        "band": [n for n, cell in enumerate(cells, start=1) if inner <= from_corner[cell] < outer],
        "arms": [n for n, cell in enumerate(cells, start=1) if outer <= from_corner[cell]],
    }
    lines = ["*HEADING", f"L-shaped bracket, arms of {arm * edge:g}, cells of {edge:g}", "*NODE"]
    lines += [f"{number[place]}, {', '.join(f'{edge * x:g}' for x in place)}" for place in places]
    lines.append("*ELEMENT, TYPE=C3D8")
    for n, (i, j, k) in enumerate(cells, start=1):
        lines.append(", ".join(map(str, (n, *(number[i + a, j + b, k + c] for a, b, c in corners)))))
    for name, members in sets.items():
        lines += [f"*ELSET, ELSET={name}", *_rows(members)]
    for name, members in {
        "wall": [number[place] for place in places if place[1] == 0],
        "tip": [number[place] for place in places if place[0] == arm],
    }.items():
        lines += [f"*NSET, NSET={name}", *_rows(members)]
    return "\n".join(lines) + "\n"


def _rows(members: Iterable[int], most: int = 12) -> list[str]:
    """Numbers in rows of a card; none ends with a comma."""
    members = list(members)
    return [", ".join(map(str, members[first : first + most])) for first in range(0, len(members), most)]
