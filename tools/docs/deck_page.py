"""docs/reference/deck.md: every key of a deck."""

from __future__ import annotations

from pdfem_mpi.deck.formulas import CONSTANTS, FUNCTIONS, VARIABLES
from tools.docs.deck_tables import KIND, DeckTable, deck_tables, default_of, kind_of, range_of, unit_of
from tools.docs.examples import example_of
from tools.docs.markdown import code, table

INTRODUCTION = """# Deck keys

A deck is a TOML file. `[name]` begins a table, `[[name]]` one of several tables of the same name. The program knows the
keys below and refuses all others. `pdfem check DECK` says what is wrong, with the key, the value and the remedy.

* **Units** are those of the deck: any consistent ones, such as mm, N and MPa. Nothing is converted.
* **Default** is what holds where the key is left out; "-" is nothing, and the meaning says what follows from that.
* **`--set`** changes a key for one run: `--set mesh.spacing=0.1`, `--set loads.0.total=[100,0,0]`. Tables in double
  brackets count from 0, or go by their name.
* **Editors** complete keys in a deck whose first line is `#:schema pdfem-schema.json`; `pdfem schema` prints that file.
"""

COLUMNS = ("key", "type", "unit", "default", "range", "meaning", "example")


def deck_page() -> str:
    """The page."""
    tables = deck_tables()
    rows = [
        (f"[{each.title}](#{anchor(each.title)})", code(each.header) if each.header else "-", each.words)
        for each in tables
    ]
    parts = [INTRODUCTION, table(("table", "in the deck", "what"), rows), *map(_section, tables), _formulas()]
    return "\n".join(parts)


def anchor(title: str) -> str:
    """What a link to a heading says."""
    return "".join(letter for letter in title.lower().replace(" ", "-") if letter.isalnum() or letter in "-_")


def _section(each: DeckTable) -> str:
    kind = f' with `kind = "{each.kind}"`' if each.kind else ""
    where = f"{code(each.header)}{kind}: " if each.header else ""
    rows = [
        (
            code(name),
            kind_of(field.annotation),
            unit_of(field),
            "required" if name == KIND and each.kind and not each.by_default else default_of(field),
            range_of(field),
            words,
            code(example_of(each, name, field)),
        )
        for name, field, words in each.keys
    ]
    return f"## {each.title}\n\n{where}{each.words}\n\n{table(COLUMNS, rows)}"


def _formulas() -> str:
    variables, constants, functions = (", ".join(map(code, names)) for names in (VARIABLES, CONSTANTS, FUNCTIONS))
    return (
        "## Formulas\n\n"
        f'A formula is a text such as `"1e-3 * y * f"`. It may name {variables}: `x`, `y` and `z` are coordinates '
        f"at rest in the deck's units, `f` is the load factor. It knows {constants}, `+ - * / **` with `^` for "
        f"`**`, brackets, and {functions}.\n"
    )
