"""Commands before a run: init, schema."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from pdfem_mpi.command.beginning import TEMPLATES, NotBegun, begin, schema_text
from pdfem_mpi.command.console import fail, print_at_once, print_problems
from pdfem_mpi.deck.table import did_you_mean
from pdfem_mpi.system.exit_codes import EXIT_FINISHED, EXIT_NOT_WRITTEN

NameArgument = Annotated[Path, typer.Argument(metavar="NAME", help="The deck to write, NAME.toml.", show_default=False)]
FromOption = Annotated[
    str,
    typer.Option(
        "--from",
        metavar="|".join(TEMPLATES),
        help="; ".join(f"{name}: {words}" for name, words in TEMPLATES.items()),
        autocompletion=lambda: list(TEMPLATES.items()),
    ),
]


def init(name: NameArgument, template: FromOption = "bar") -> int:
    """Write a commented deck to begin with, and the schema by which editors complete and check it."""
    if template not in TEMPLATES:
        hint = did_you_mean(template, TEMPLATES)
        raise fail([f"pdfem: --from {template} is none of {', '.join(TEMPLATES)}.{hint}"], 0)
    try:
        files = begin(name, template)
    except NotBegun as error:
        raise fail([f"pdfem: {error}"], 0) from None
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or error
        print_problems([f"pdfem: {name} cannot be written ({reason}). Choose another place."], 0)
        return EXIT_NOT_WRITTEN
    deck = next(path for path in files if path.suffix == ".toml")
    for path in files:
        print_at_once(f"wrote {path}")
    print_at_once(f"next: pdfem check {quoted(deck)}, pdfem run {quoted(deck)}")
    return EXIT_FINISHED


def schema() -> int:
    """Print the JSON schema of decks, for editors: pdfem schema > pdfem-schema.json."""
    print_at_once(schema_text().rstrip())
    return EXIT_FINISHED


def quoted(path: Path) -> str:
    """A path as a shell takes it."""
    text = str(path)
    return f"'{text}'" if any(letter in text for letter in " ()&;'\"") and "'" not in text else text
