"""Compares the JSON of a verb with the fields that docs/command-line.md names."""

from __future__ import annotations

import json
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

PAGE = Path(__file__).parents[3] / "docs/command-line.md"


def documented() -> dict[str, set[str]]:
    """Return the documented fields of each command. A word in capitals stands for the fields in its own row."""
    rows = re.findall(r"^\| (.+) \| (`.+) \|$", PAGE.read_text().partition("## Fields")[2], flags=re.MULTILINE)
    cells = {one.strip("`"): re.findall(r"`([^`]+)`", right) for left, right in rows for one in left.split(", ")}

    def whole(path: str) -> set[str]:
        head, _, word = path.rpartition(".")
        if not word.isupper():
            return {path}
        return {f"{head}.{one}".removeprefix(".") for below in cells[word] for one in whole(below)}

    return {name: set().union(*map(whole, paths)) for name, paths in cells.items() if not name.isupper()}


DOCUMENTED = documented()


def require_fields(name: str, output: str, *, may_be_empty: bool = False) -> None:
    """Require that the output of a verb is JSON with the documented fields, and with no others."""
    try:
        printed = json.loads(output)
    except json.JSONDecodeError:  # the output has one object in each line
        printed = [json.loads(line) for line in output.splitlines()]
    assert printed or may_be_empty
    expected = DOCUMENTED[name]
    opened = {path[: end.start()] for path in expected for end in re.finditer(r"\{\}", path)}
    found = set(map(_bare, _fields(printed, opened))) if printed else set(map(_bare, expected))
    empty = {path for path in found if any(one.startswith((f"{path}[", f"{path}{{", f"{path}.")) for one in expected)}
    needed = {_bare(path) for path in expected if not path.endswith("?")}
    lacking = {path for path in needed - found if not any(path.startswith(f"{one}") for one in empty)}
    assert (sorted(found - set(map(_bare, expected)) - empty), sorted(lacking)) == ([], []), printed


def _fields(value: Any, opened: set[str], prefix: str = "") -> Iterator[str]:
    """The paths of all values. A path in `opened` is an object whose keys differ from case to case."""
    if isinstance(value, list) and value:
        for one in value:
            yield from _fields(one, opened, f"{prefix}[]")
    elif isinstance(value, dict) and value:
        for key, one in value.items():
            path = f"{prefix}{{}}" if prefix in opened else f"{prefix}.{key}".removeprefix("[]").removeprefix(".")
            yield from _fields(one, opened, path)
    else:
        yield prefix


def _bare(path: str) -> str:
    return path.removesuffix("?").removesuffix("[]").removesuffix("{}")
