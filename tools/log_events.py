"""Check that each line of a service's log names its event, and that docs/observing.md lists exactly these events.

Programs that watch logs rely on the names, because the messages change.
"""

from __future__ import annotations

import ast
import re
import sys
from collections.abc import Iterable, Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PAGE = ROOT / "docs" / "observing.md"
SOURCES = ("services", "client/src/stampede_rt/security")
LEVELS = {"debug", "info", "warning", "error", "exception", "critical", "log"}
UNNAMED = "other"  # the event of a library's lines; see `stampede_rt_runtime.logs`
KEY = "event"


def log_calls(source: str) -> Iterator[tuple[int, ast.Call, ast.AST]]:
    """Yield each call of `logger` in a module: its line, the call, and the function around it."""
    for function in ast.walk(ast.parse(source)):
        if isinstance(function, ast.FunctionDef | ast.AsyncFunctionDef):
            for call in ast.walk(function):
                if isinstance(call, ast.Call) and _is_of_logger(call):
                    yield call.lineno, call, function


def _is_of_logger(call: ast.Call) -> bool:
    of = call.func
    return isinstance(of, ast.Attribute) and of.attr in LEVELS and ast.unparse(of.value) == "logger"


def names_event(call: ast.Call, function: ast.AST) -> bool:
    """Return whether the call's `extra`, or the function that makes it, names an event."""
    extra = next((one.value for one in call.keywords if one.arg == "extra"), None)
    return extra is not None and bool(_events(extra if isinstance(extra, ast.Dict) else function))


def _events(node: ast.AST) -> set[str]:
    """Return the values of the key "event" in all dictionaries below `node`; "" for one that is not a literal."""
    found: set[str] = set()
    for one in ast.walk(node):
        if isinstance(one, ast.Dict):
            for key, value in zip(one.keys, one.values, strict=True):
                if isinstance(key, ast.Constant) and key.value == KEY:
                    found.add(str(value.value) if isinstance(value, ast.Constant) else "")
        elif isinstance(one, ast.keyword) and one.arg == KEY:  # the event of a line that another function logs
            found |= {str(text.value) for text in ast.walk(one.value) if isinstance(text, ast.Constant) and text.value}
    return found


def listed(page: str) -> list[str]:
    """Return the events in the page's table."""
    table = page.partition("### Events")[2].partition("\n## ")[0]
    return re.findall(r"^\| `([a-z_]+)` \|", table, re.MULTILINE)


def complaints(modules: Iterable[tuple[str, str]], page: str) -> list[str]:
    """Return a line for each fault. `modules`: (path, source)."""
    found, used = [], {UNNAMED}
    for path, source in modules:
        used |= _events(ast.parse(source)) - {""}
        found += [
            f'{path}:{line}: the line of the log names no event; give it extra={{"event": "..."}}'
            for line, call, function in log_calls(source)
            if not names_event(call, function)
        ]
    known = listed(page)
    found += [f"docs/observing.md does not explain the event {one}" for one in sorted(used - set(known))]
    found += [f"docs/observing.md explains the event {one}, which nothing logs" for one in sorted(set(known) - used)]
    found += [
        f"docs/observing.md explains the event {one} twice" for one in sorted({o for o in known if known.count(o) > 1})
    ]
    return found


def main() -> int:
    """Print the complaints. Returns the exit status."""
    files = sorted(file for folder in SOURCES for file in (ROOT / folder).rglob("*.py"))
    found = complaints(((str(file.relative_to(ROOT)), file.read_text()) for file in files), PAGE.read_text())
    for line in found:
        print(line)
    return 1 if found else 0


if __name__ == "__main__":
    sys.exit(main())
