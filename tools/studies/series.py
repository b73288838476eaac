"""What all studies share: the environment, runs that are not done, kept results, and tables between markers.

A study is a script that lists cases, runs those without a result, and fills the tables of one document. Its cases are
runs of ``pdfem`` in folders of their own, members of ``pdfem study``, or results kept as JSON files; whatever was
interrupted goes on where it stopped. Only the standard library is needed to load this module.
"""

from __future__ import annotations

import argparse
import csv
import json
import os
import shutil
import subprocess
import sys
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
RUNS = ROOT / "runs"
DOCS = ROOT / "docs"
JOBS = ROOT / "jobs"
#: An interrupted run or study ends with it; it goes on when it is started again.
INTERRUPTED = 75


# --- the environment -------------------------------------------------------------------------------------


def program() -> str:
    """The path of ``pdfem``: that of .venv where `tools/run` has made it, else that on the PATH."""
    own = ROOT / ".venv" / "bin" / "pdfem"
    found = str(own) if own.exists() else shutil.which("pdfem")
    if found is None:
        sys.exit(f"{name_of()}: no pdfem found. Run `tools/run jobs/bar_fe.toml` once, which sets up .venv.")
    return found


def in_environment() -> None:
    """Go on with the Python that has the program, prepared for kernels and ranks."""
    python = Path(program()).parent / "python"
    if Path(sys.prefix).resolve() != python.parent.parent.resolve():
        os.execv(python, [str(python), *sys.argv])
    import pdfem_mpi

    _ = pdfem_mpi.RunFolder  # loaded when it is first asked for, after the environment was prepared for it


def name_of() -> str:
    """How the script was called, from the repository's root on."""
    path = Path(sys.argv[0]).resolve()
    return path.relative_to(ROOT).as_posix() if path.is_relative_to(ROOT) else path.name


def parser_of(text: str, **flags: str) -> argparse.ArgumentParser:
    """The options that all studies have: ``--only``, ``--dry-run``, ``--report``, and switches with their help."""
    parser = argparse.ArgumentParser(description=text.partition("\n")[0])
    for name, words in flags.items():
        parser.add_argument(f"--{name}", action="store_true", help=words)
    parser.add_argument("--only", default="", metavar="TEXT", help="run only what has this in its name")
    parser.add_argument("--dry-run", action="store_true", help="list what is left to run, and run nothing")
    parser.add_argument("--report", action="store_true", help="run nothing; write what can be written")
    return parser


# --- runs ------------------------------------------------------------------------------------------------


def run_deck(
    deck: str, settings: Mapping[str, str] | Iterable[str], out: Path, *options: str, check: bool = True, **env: str
) -> subprocess.CompletedProcess:
    """Run a deck of jobs/ with ``pdfem run``; return the finished process.

    Parameters
    ----------
    settings : mapping or texts
        Keys and values for ``--set``.
    options : text
        Further options, such as ``-n 2``.
    check : bool
        End the script with what the program said when its exit code is not 0.
    """
    pairs = [f"{key}={value}" for key, value in settings.items()] if isinstance(settings, Mapping) else list(settings)
    command = [program(), "run", str(JOBS / deck), *(f"--set={pair}" for pair in pairs), *options, "--out", str(out)]
    done = subprocess.run(command, capture_output=True, text=True, env=os.environ | env)
    if check and done.returncode:
        sys.exit(f"{' '.join(command)}\n{done.stdout}{done.stderr}")
    return done


def summary_of(folder: Path) -> dict[str, Any]:
    """What a run wrote about itself; empty where there is none."""
    try:
        return json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    except (FileNotFoundError, json.JSONDecodeError):
        return {}


def rows_of(path: Path) -> list[dict[str, str]]:
    """Rows of a CSV file, as text."""
    with path.open(newline="", encoding="utf-8") as file:
        return list(csv.DictReader(file))


# --- kept results ----------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Results:
    """Results of cases, a JSON file each, with what they depend on."""

    folder: Path

    def read(self, name: str, identity: Any = None) -> dict[str, Any] | None:
        """The result of a case; None where there is none, or one of another identity (any, without one)."""
        try:
            known = json.loads((self.folder / f"{name}.json").read_text(encoding="utf-8"))
        except (FileNotFoundError, json.JSONDecodeError):
            return None
        return known if identity is None or known.get("identity") == identity else None

    def write(self, name: str, identity: Any, result: Mapping[str, Any]) -> None:
        """Write under a temporary name, then rename: an interrupted study leaves no half a file."""
        self.folder.mkdir(parents=True, exist_ok=True)
        path = self.folder / f"{name}.json"
        text = json.dumps({"identity": identity} | dict(result), indent=1)
        path.with_suffix(".tmp").write_text(text + "\n", encoding="utf-8")
        path.with_suffix(".tmp").replace(path)


# --- what tests measured ---------------------------------------------------------------------------------


def run_tests(report: Path, *arguments: str, ranks: int = 1) -> int:
    """Run tests, on ranks where there are several; rank 0 writes the report. Returns the exit code."""
    report.parent.mkdir(parents=True, exist_ok=True)
    report.unlink(missing_ok=True)
    command = [sys.executable, "-m", "pytest", "-q"]
    if ranks > 1:
        from tools.stages import on_ranks

        command, additions = on_ranks(ranks, report.with_suffix(""), *command, "--only-mpi", *arguments)
        code = subprocess.run(command, cwd=ROOT, env=os.environ | additions).returncode
        first = report.with_suffix(".0.xml")
        if first.exists():
            first.replace(report)
        return code
    return subprocess.run([*command, f"--junitxml={report}", *arguments], cwd=ROOT).returncode


def properties_of(report: Path, name: str) -> list[tuple[bool, Any]]:
    """Of each test that recorded a property of this name, which is JSON: whether it passed, and the value."""
    if not report.exists():
        return []
    found = []
    for case in ElementTree.parse(report).getroot().iter("testcase"):
        passed = not {child.tag for child in case} & {"failure", "error"}
        values = [item.get("value", "null") for item in case.iter("property") if item.get("name") == name]
        found += [(passed, json.loads(value)) for value in values]
    return found


# --- tables ----------------------------------------------------------------------------------------------


def table(header: Sequence[str], rows: Iterable[Sequence[str]]) -> list[str]:
    """Lines of a Markdown table."""
    lines = ["| " + " | ".join(header) + " |", "|" + "---|" * len(header)]
    for row in rows:
        if len(row) != len(header):
            raise ValueError(f"a row of {len(row)} cells under {len(header)} headings: {row}")
        lines.append("| " + " | ".join(row) + " |")
    return lines


def kept(lines: Sequence[str], document: Path, name: str, columns: int) -> list[str]:
    """A table with those rows of the document's besides that it does not have, in the document's order.

    Rows are told apart by their first ``columns`` cells; new ones follow those that share their first cell.
    """
    text = document.read_text(encoding="utf-8").partition(f"<!-- {name}: ")[2].partition(f"<!-- end of {name} -->")[0]

    def keyed(rows: Iterable[str]) -> dict[tuple[str, ...], str]:
        return {tuple(cell.strip() for cell in row.split(" | ")[:columns]): row for row in rows}

    new, old = keyed(lines[2:]), keyed([row for row in text.splitlines() if row.startswith("| ")][1:])
    order = list(old)
    for key in new:
        if key not in old:
            alike = [k for k, other in enumerate(order) if other[0] == key[0]]
            order.insert(alike[-1] + 1 if alike else len(order), key)
    return [*lines[:2], *(new.get(key) or old[key] for key in order)]


def fill(document: Path, tables: Mapping[str, Sequence[str]]) -> None:
    """Write each table between its markers, ``<!-- NAME: SCRIPT -->`` and ``<!-- end of NAME -->``."""
    text = document.read_text(encoding="utf-8")
    for name, lines in tables.items():
        begin, end = f"<!-- {name}: ", f"<!-- end of {name} -->"
        before, found, rest = text.partition(begin)
        script, _, rest = rest.partition("\n")
        _, found_end, after = rest.partition(end)
        if not found or not found_end:
            sys.exit(f"{document}: the markers of {name} are missing.")
        text = f"{before}{begin}{script}\n" + "\n".join(lines) + f"\n{end}{after}"
    document.write_text(text, encoding="utf-8")
