"""The pages of docs/reference, made from the program's own tables and the words that stand beside this file."""

from __future__ import annotations

from pathlib import Path

from tools.docs.command_page import command_page
from tools.docs.deck_page import deck_page
from tools.docs.result_pages import exit_code_page, fields_page, history_page, summary_page

ROOT = Path(__file__).resolve().parents[2]
FOLDER = ROOT / "docs" / "reference"
#: The first line of each page.
MARK = "<!-- Written by tools/docs/reference. Do not edit: the next run of it would undo that. -->\n\n"
MAKERS = {
    "deck.md": deck_page,
    "history.md": history_page,
    "summary.md": summary_page,
    "fields.md": fields_page,
    "exit_codes.md": exit_code_page,
    "commands.md": command_page,
}


def all_pages() -> dict[str, str]:
    """The text of each page by its name."""
    return {name: MARK + make() for name, make in MAKERS.items()}


def outdated() -> list[str]:
    """Pages that are not what would be written, and files of the folder that are no page."""
    pages = all_pages()
    there = {path.name for path in FOLDER.glob("*")}
    changed = [name for name, text in pages.items() if name not in there or _read(name) != text]
    return changed + sorted(there - set(pages))


def write_pages() -> list[str]:
    """Write the pages that are out of date; their paths from the repository's root on."""
    FOLDER.mkdir(exist_ok=True)
    written = []
    for name, text in all_pages().items():
        path = FOLDER / name
        if not path.exists() or _read(name) != text:
            path.write_text(text, encoding="utf-8")
            written.append(path.relative_to(ROOT).as_posix())
    return written


def _read(name: str) -> str:
    return (FOLDER / name).read_text(encoding="utf-8")
