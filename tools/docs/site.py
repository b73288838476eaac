"""The pages of docs/ as a site: MkDocs with its own theme, the navigation of docs/index.md, and no network."""

from __future__ import annotations

import logging
import re
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
DOCS = ROOT / "docs"
CONFIGURATION = Path(__file__).with_name("mkdocs.yml")


class Findings(logging.Handler):
    """Collects warnings, each of which is an error here."""

    def __init__(self) -> None:
        super().__init__(logging.WARNING)
        self.messages: list[str] = []

    def emit(self, record: logging.LogRecord) -> None:
        """Keep a message."""
        self.messages.append(record.getMessage())


def navigation() -> list[dict]:
    """Sections of docs/index.md with their pages; pages that it does not name come last.

    So a page that is added is in the site at once, and in its place when the index names it.
    """
    text = (DOCS / "index.md").read_text(encoding="utf-8")
    sections: list[dict] = [{"Home": "index.md"}]
    named = {"index.md"}
    for part in text.split("\n## ")[1:]:
        heading, _, body = part.partition("\n")
        links = re.findall(r"^\* \[([^\]]+)\]\(([^)#]+\.md)\)", body, re.MULTILINE)
        sections.append({heading: [{title: path} for title, path in links]})
        named |= {path for _, path in links}
    pages = {path.relative_to(DOCS).as_posix() for path in DOCS.rglob("*.md")}
    if more := sorted(pages - named):
        sections.append({"More": more})
    return sections


def build(folder: Path) -> list[str]:
    """Write the site into a folder; what is wrong with the pages, as sentences."""
    from mkdocs.commands.build import build as build_site
    from mkdocs.config import load_config

    findings, logger = Findings(), logging.getLogger("mkdocs")
    logger.addHandler(findings)
    try:
        build_site(load_config(str(CONFIGURATION), nav=navigation(), site_dir=str(folder)))
    finally:
        logger.removeHandler(findings)
    return findings.messages
