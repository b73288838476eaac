"""The pages of docs/ as a site: built strictly, with every page in its navigation, and without network."""

import re

import pytest

from tools.docs import site

pytest.importorskip("mkdocs", reason="builds the site (extra: test)")


def pages_of(navigation):
    """Paths of all pages in the navigation."""
    for section in navigation:
        for entry in section.values():
            yield from (
                [entry]
                if isinstance(entry, str)
                else (page if isinstance(page, str) else next(iter(page.values())) for page in entry)
            )


def test_the_site_builds_without_a_warning_and_loads_nothing_from_elsewhere(tmp_path, monkeypatch):
    monkeypatch.setattr("socket.socket.connect", lambda *_: pytest.fail("the network was asked"))
    assert site.build(tmp_path / "site") == []
    home = (tmp_path / "site" / "index.html").read_text("utf-8")
    assert "tutorial.html" in home and "figures/tutorial_crack.png" in home
    loaded = re.findall(r'<(?:script|link|img)[^>]+(?:src|href)="(?:https?:)?//[^"]+', home)
    assert not loaded


def test_a_link_that_leads_nowhere_is_an_error(tmp_path, monkeypatch):
    docs = tmp_path / "docs"
    docs.mkdir()
    (docs / "index.md").write_text("# Home\n\n## Pages\n\n* [One](one.md)\n")
    (docs / "one.md").write_text("# One\n\n[two](two.md) [no heading](index.md#none)\n")
    (docs / "more.md").write_text("# More\n")
    monkeypatch.setattr(site, "DOCS", docs)
    monkeypatch.setattr(site, "CONFIGURATION", tmp_path / "mkdocs.yml")
    (tmp_path / "mkdocs.yml").write_text(
        "site_name: x\ndocs_dir: docs\ntheme: readthedocs\nvalidation:\n  anchors: warn\n"
    )
    assert len(site.build(tmp_path / "site")) == 2
    assert site.navigation()[-1] == {"More": ["more.md"]}


def test_every_page_is_in_the_navigation_once():
    found = list(pages_of(site.navigation()))
    assert sorted(found) == sorted(path.relative_to(site.DOCS).as_posix() for path in site.DOCS.rglob("*.md"))
