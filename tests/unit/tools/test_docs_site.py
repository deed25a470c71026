"""The site of the documentation: its navigation names every page once, so that its strict build cannot break."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import yaml

from tools.docs_site import PAGES, REFERENCE

ROOT = Path(__file__).resolve().parents[3]


def named(entry: object) -> Iterator[str]:
    """The files that a part of the navigation names."""
    if isinstance(entry, str):
        yield entry
    for part in entry.values() if isinstance(entry, dict) else entry if isinstance(entry, list) else ():
        yield from named(part)


def test_the_navigation_names_each_page_of_the_documentation_once() -> None:
    nav = yaml.safe_load((ROOT / "mkdocs.yml").read_text())["nav"]
    documents = {str(path.relative_to(ROOT)) for path in (ROOT / "docs").rglob("*.md")}
    documents = {path for path in documents if not path.startswith("docs/decisions/0")}  # `not_in_nav` of mkdocs.yml
    others = {"index.md" if page == "README.md" else page for page in PAGES} | {f"api/{name}.md" for name in REFERENCE}
    assert sorted(named(nav)) == sorted(documents | others)
