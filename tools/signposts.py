"""Check the documents: the paths that they name, the picture of the layers, and the index of decisions.

Without an option, draw the layers into ARCHITECTURE.md again. With --check, print the faults, and change nothing.
"""

from __future__ import annotations

import argparse
import functools
import re
import subprocess
import sys
import textwrap
import tomllib
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parent.parent
PICTURE_PAGE = "ARCHITECTURE.md"
REPORTS = {"docs/benchmarks.md"}  # names files that the reader's own run of a benchmark writes
WAY, WAY_LINES_MAX = "docs/finding-your-way.md", 60
DECISIONS = "docs/decisions"
BEGIN, END = "<!-- layers: drawn by tools/signposts.py from pyproject.toml -->", "<!-- end of the layers -->"
WIDTH = 112

MODULE = re.compile(r"`(stampede_rt\w*(?:\.\w+)*)`")
ENTRY_POINTS = {"stampede_rt.verbs", "stampede_rt.embedded_hosts"}
PATH = re.compile(r"`([\w./-]+(?:\.(?:py|proto|toml|md)|/))`")
MAPPED = re.compile(r"^  (\w+)/", re.MULTILINE)
PACKAGE_FOLDER = re.compile(r"((?:client|services/\w+)/src/\w+/(\w+))/.+\.py$")
GENERATED = {"v1", "_sync"}
INDEX_LINE = re.compile(r"^\| \[(\d{4})\]\((.+?)\) \|", re.MULTILINE)
MERGE_MARK = re.compile(r"^(?:<{7}|>{7}) ", re.MULTILINE)


def unknown_names(page: str, files: Iterable[str]) -> list[str]:
    """Return the modules and paths on a page that do not exist. A path may leave out its first folders."""
    places = _places(frozenset(files))
    modules = {name.replace(".", "/") for name in MODULE.findall(page) if name not in ENTRY_POINTS}
    unknown = [
        name.replace("/", ".")
        for name in modules
        if f"/src/{name}.py\n" not in places and f"/src/{name}/\n" not in places
    ]
    unknown += [name for name in set(PATH.findall(page)) if f"/{name}\n" not in places]
    return sorted(unknown)


@functools.cache
def _places(files: frozenset[str]) -> str:
    """All files and their folders, a line each. Each begins with a slash, and a folder also ends with one."""
    folders = {"/".join(parts[:end]) for file in files for parts in [file.split("/")] for end in range(1, len(parts))}
    return "".join(f"/{file}\n" for file in files) + "".join(f"/{folder}/\n" for folder in folders)


def unmapped_folders(page: str, files: Iterable[str]) -> list[str]:
    """Return the folders of the client and of the services that the map does not show.

    The map shows a folder as an indented line that begins with its name.
    """
    shown = set(MAPPED.findall(page))
    folders = {match[1] for file in files if (match := PACKAGE_FOLDER.match(file)) and match[2] not in GENERATED}
    return sorted(folder for folder in folders if folder.rsplit("/", 1)[1] not in shown)


def layers(contracts: Iterable[Mapping[str, Any]]) -> str:
    """Return the contracts of import-linter as a text for people."""
    return "\n\n".join(f"{contract['name']}\n{_drawn(contract)}" for contract in contracts)


def _drawn(contract: Mapping[str, Any]) -> str:
    if contract["type"] == "layers":
        rows = [", ".join(_short(re.split(r" [:|] ", row), contract)) for row in contract["layers"]]
        return "\n".join(_indented(row, "    " if row is rows[0] else "  ↓ ") for row in rows)
    if contract["type"] == "independence":
        return _indented(" | ".join(contract["modules"]))
    if contract["type"] == "acyclic_siblings":
        return _indented(", ".join(contract["ancestors"]))
    if contract["type"] == "protected":
        protected, importers = ", ".join(contract["protected_modules"]), ", ".join(contract["allowed_importers"])
        return f"{_indented(protected)}\n    is imported only by\n{_indented(importers)}"
    sources, forbidden = ", ".join(contract["source_modules"]), ", ".join(contract["forbidden_modules"])
    return f"{_indented(sources)}\n    ✗ do not import\n{_indented(forbidden)}"


def _short(names: Iterable[str], contract: Mapping[str, Any]) -> list[str]:
    package = ", ".join(contract.get("containers", ())) or contract["layers"][0].split(".")[0]
    return [name.strip().removeprefix(f"{package}.") for name in names]


def _indented(text: str, start: str = "    ") -> str:
    return textwrap.fill(text, WIDTH, initial_indent=start, subsequent_indent="    ", break_on_hyphens=False)


def with_layers(page: str, picture: str) -> str:
    """Return the page with the picture between its two marks. Raises ValueError if they are missing."""
    before, begin, rest = page.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not (begin and end):
        raise ValueError(f"{PICTURE_PAGE} needs the two lines {BEGIN!r} and {END!r} around the picture")
    return f"{before}{begin}\n\n```\n{picture}\n```\n\n{end}{after}"


def index_complaints(index: str, records: Mapping[str, str]) -> list[str]:
    """Return what the index lacks or lists wrongly. `records`: the text of each record, by its file name."""
    listed = INDEX_LINE.findall(index)
    files = [file for _, file in listed]
    lines = [f"{file} is not in the index of decisions" for file in sorted(records.keys() - set(files))]
    lines += [f"the index of decisions lists {file}, which does not exist" for file in files if file not in records]
    lines += [f"the index calls {file} number {number}" for number, file in listed if not file.startswith(number)]
    if files != sorted(set(files)):
        lines.append("the index of decisions is not in the order of the numbers, or lists one twice")
    return lines


def merge_complaints(pages: Mapping[str, str]) -> list[str]:
    """Return a complaint for each page with the marks of a merge conflict. `pages`: the text of each, by file name."""
    marked = [page for page, text in pages.items() if MERGE_MARK.search(text)]
    return [f"{page} has the marks of a merge conflict; resolve it" for page in marked]


def complaints() -> list[str]:
    """Return a line for each fault of the present pages."""
    files = subprocess.run(
        ["git", "ls-files", "--cached", "--others", "--exclude-standard"],
        cwd=ROOT, check=True, capture_output=True, text=True,
    ).stdout.splitlines()  # fmt: skip
    existing = [file for file in files if (ROOT / file).exists()]
    pages = {file: (ROOT / file).read_text() for file in existing if file.endswith(".md")}
    lines = [
        f"{page} names {name}, which does not exist; correct the name"
        for page in sorted(pages.keys() - REPORTS)
        for name in unknown_names(pages[page], existing)
    ]
    if len(pages[WAY].splitlines()) > WAY_LINES_MAX:
        lines.append(f"{WAY} has more than {WAY_LINES_MAX} lines; shorten it, because a newcomer reads all of it")
    page = pages[PICTURE_PAGE]
    lines += [f"the map of {PICTURE_PAGE} lacks {folder}/; add a line" for folder in unmapped_folders(page, existing)]
    if with_layers(page, layers(_contracts())) != page:
        lines.append(f"the layers in {PICTURE_PAGE} differ from pyproject.toml; run: make stubs")
    lines += merge_complaints(pages)
    folder = ROOT / DECISIONS
    records = {path.name: path.read_text() for path in folder.glob("[0-9]*.md")}
    return lines + index_complaints((folder / "README.md").read_text(), records)


def _contracts() -> list[dict[str, Any]]:
    return list(tomllib.loads((ROOT / "pyproject.toml").read_text())["tool"]["importlinter"]["contracts"])


def main(arguments: list[str] | None = None) -> int:
    """Draw, or with --check compare."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--check", action="store_true")
    if not parser.parse_args(arguments).check:
        page = ROOT / PICTURE_PAGE
        page.write_text(with_layers(page.read_text(), layers(_contracts())))
        return 0
    lines = complaints()
    for line in lines:
        print(line)
    return 1 if lines else 0


if __name__ == "__main__":
    sys.exit(main())
