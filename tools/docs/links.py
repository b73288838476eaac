"""Links of the pages: files and headings that are not there, and paths of the repository that a page names."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
#: Folders of the repository whose files pages name as code.
NAMED = re.compile(r"(?:docs|jobs|tools|tests|pdfem_mpi|\.ci)/[\w./-]+")
#: What a page may name although it is not there: what a reader makes, and what git does not keep.
MADE = ("runs/",)


def pages() -> list[Path]:
    """README, changelog and all pages of docs/."""
    return [ROOT / "README.md", ROOT / "CHANGELOG.md", *sorted((ROOT / "docs").rglob("*.md"))]


def broken_links(page: Path) -> list[str]:
    """What a page refers to that is not there, as sentences."""
    text = page.read_text(encoding="utf-8")
    prose = without_code(text)
    found = [f"{page.relative_to(ROOT)}: {reason}" for reason in _links(page, prose)]
    if page.name != "CHANGELOG.md":  # which speaks of what was there once
        found += [f"{page.relative_to(ROOT)}: names {path}, which is not there" for path in _missing_paths(text)]
    return found


def headings(text: str) -> set[str]:
    """Anchors of the headings of a page, as GitHub makes them."""
    found = re.findall(r"^#{1,6} +(.+?) *#*$", without_blocks(text), re.MULTILINE)
    return {anchor(re.sub(r"\[([^\]]*)\]\([^)]*\)", r"\1", heading)) for heading in found}


def anchor(heading: str) -> str:
    """The anchor of a heading."""
    kept = re.sub(r"[^\w\s-]", "", heading.lower())
    return re.sub(r"\s", "-", kept.strip())


def without_blocks(text: str) -> str:
    """A page without fenced blocks."""
    return re.sub(r"^( *)(```|~~~).*?^\1\2 *$", "", text, flags=re.MULTILINE | re.DOTALL)


def without_code(text: str) -> str:
    """A page without blocks and without code in a line."""
    return re.sub(r"`[^`\n]*`", "", re.sub(r"^    .*$", "", without_blocks(text), flags=re.MULTILINE))


def _links(page: Path, prose: str) -> Iterator[str]:
    for target in re.findall(r"\]\(([^)\s]+)(?: \"[^\"]*\")?\)", prose):
        if re.match(r"[a-z]+:", target):
            continue
        name, _, fragment = target.partition("#")
        path = (page.parent / name).resolve() if name else page
        if not path.exists():
            yield f"links to {target}, and there is no such file"
        elif fragment and (path.suffix != ".md" or fragment not in headings(path.read_text(encoding="utf-8"))):
            yield f"links to {target}, and there is no such heading"


def _missing_paths(text: str) -> Iterator[str]:
    for span in re.findall(r"`([^`\n]+)`", text):
        for path in NAMED.findall(span.split(":")[0]):
            path = path.rstrip(".")
            if not re.search(r"[A-Z]{4}|\*|NAME", path.replace("README", "")) and not (ROOT / path).exists():
                yield path
