"""Pages of what a run leaves: columns of history.csv, keys of summary.json, datasets of the fields, exit codes."""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

from pdfem_mpi.system import exit_codes
from tools.docs.markdown import code, table

WORDS = Path(__file__).parent / "words"


@cache
def words(name: str) -> dict[str, Any]:
    """What stands in words/NAME.toml."""
    return tomllib.loads((WORDS / f"{name}.toml").read_text("utf-8"))


def history_page() -> str:
    """docs/reference/history.md."""
    return (
        "# Columns of history.csv\n\n"
        "`history.csv` has a row for each load step or event, written when it is done. Numbers have all their digits "
        "and the units of the deck. An empty field is a number that is not known.\n\n"
        + table(("column", "unit", "there when", "meaning"), _coded(words("history")["columns"]))
        + "\n`pdfem plot RUNDIR` draws `reaction` over `displacement`. In Python: "
        '`pdfem.open_run("runs/bracket").history["reaction"]`.\n'
    )


def summary_page() -> str:
    """docs/reference/summary.md."""
    return (
        "# Keys of summary.json\n\n"
        "`summary.json` is written at the end of each start, also of one that was stopped. Units are those of the "
        "deck. `a.b` is key `b` of table `a`; `<...>` stands for a name.\n\n"
        + table(("key", "unit", "meaning"), _coded(words("summary")["keys"]))
    )


def fields_page() -> str:
    """docs/reference/fields.md."""
    found = words("fields")
    return (
        "# Datasets of the VTKHDF files\n\n"
        "Fields are HDF5 files in the VTKHDF format, which ParaView 5.12 or newer opens. Any HDF5 library reads them. "
        "The geometry is stored once, a field once for each frame. Which fields there are, `output.fields` says "
        "([results](../results.md)); `pdfem export` writes VTU files or tables of text.\n\n"
        + table(("file", "what"), _coded(found["files"]))
        + "\n## Attributes\n\n"
        + table(("attribute", "meaning"), _coded(found["attributes"]))
        + "\n## Datasets\n\nPaths are those below the group `VTKHDF`.\n\n"
        + table(("dataset", "file", "rows", "unit", "meaning"), _coded(found["datasets"]))
    )


def exit_code_page() -> str:
    """docs/reference/exit_codes.md."""
    rows = [(str(number), *words("exit_codes")[name]) for name, number in exit_code_names().items()]
    return (
        "# Exit codes\n\nAll commands of `pdfem` end with one of these codes; batch scripts can rely on them.\n\n"
        + table(("code", "meaning", "what to do"), rows)
        + "\nOther codes (such as 9 or 137) mean that the system or the launcher ended a rank. `pdfem resume` goes on "
        "from the last checkpoint. A study (`pdfem study`) ends with 0 if all members finished, else with the code of "
        "a member that did not.\n"
    )


def exit_code_names() -> dict[str, int]:
    """Exit codes by the names that the program has for them."""
    return {name: value for name, value in vars(exit_codes).items() if name.startswith("EXIT_")}


def undocumented(found: Iterable[str], known: Iterable[str]) -> list[str]:
    """Names that no entry describes; ``<...>`` in an entry stands for any letters, and dots."""
    patterns = [re.compile(re.sub(r"<\w+>", ".+", re.escape(name))) for name in known]
    return [name for name in found if not any(pattern.fullmatch(name) for pattern in patterns)]


def _coded(rows: Iterable[list[str]]) -> Iterable[tuple[str, ...]]:
    return ((code(name), *others) for name, *others in rows)
