"""Each line of a service's log has a stable event, and docs/observing.md explains each event."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[3]
OBSERVING = ROOT / "docs" / "observing.md"
SOURCES = ("services", "client/src/stampede_rt/security")
LEVELS = {"debug", "info", "warning", "error", "exception", "log"}


def log_calls() -> Iterator[tuple[str, ast.Call, str]]:
    """Each call of a logger in a service: its place, the call, and the source of its function."""
    for folder in SOURCES:
        for file in sorted((ROOT / folder).rglob("*.py")):
            source = file.read_text()
            for function in (
                one for one in ast.walk(ast.parse(source)) if isinstance(one, ast.FunctionDef | ast.AsyncFunctionDef)
            ):
                for call in ast.walk(function):
                    if (
                        isinstance(call, ast.Call)
                        and isinstance(call.func, ast.Attribute)
                        and call.func.attr in LEVELS
                        and ast.unparse(call.func.value) == "logger"
                    ):
                        yield f"{file.name}:{call.lineno}", call, ast.unparse(function)


def documented() -> list[str]:
    _, _, events = OBSERVING.read_text().partition("### Events")
    return re.findall(r"^\| `([a-z_]+)` \|", events.partition("\n## ")[0], re.MULTILINE)


def test_each_line_names_its_event() -> None:
    calls = list(log_calls())
    assert len(calls) > 50
    for place, call, function in calls:
        extra = next((one.value for one in call.keywords if one.arg == "extra"), None)
        assert extra is not None, place
        assert "'event': " in (ast.unparse(extra) if isinstance(extra, ast.Dict) else function), place


def test_the_docs_list_each_event_once_and_no_other() -> None:
    used = set()
    for folder in SOURCES:
        for file in (ROOT / folder).rglob("*.py"):
            used |= set(re.findall(r'"event": "([a-z_]+)"', file.read_text()))
    used |= set(
        re.findall(
            r'Note\(\s*"([a-z_]+)"', (ROOT / "services/frontend/src/stampede_rt_frontend/status_log.py").read_text()
        )
    )
    found = documented()
    assert sorted(found) == sorted(used | {"other"})
