"""The exit statuses: one list in the code, and the same one on the page."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

import stampede_rt.cli
from stampede_rt.cli import exit_statuses
from stampede_rt_runtime import certs_command

CLI = Path(stampede_rt.cli.__file__).parent
COMMAND = re.compile(r"_?run(_\w+)?|main|drain|administer|take|_played|_ended|_written|_exported")
PAGE = Path(__file__).parents[4] / "docs/command-line.md"


def test_the_page_explains_each_status_as_the_code_does() -> None:
    rows = re.findall(r"^\| (\d+) \| (.+) \|$", PAGE.read_text(), flags=re.MULTILINE)
    assert [int(status) for status, _ in rows] == list(exit_statuses.EXIT_STATUSES)
    for status, text in rows:
        expected = exit_statuses.EXIT_STATUSES[int(status)]
        assert text.startswith(expected.rstrip(".").split(":")[0].split(", or")[0]), status


def returned_numbers() -> Iterator[tuple[str, int]]:
    """Each number that the function of a command returns as its status."""
    for path in CLI.glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.FunctionDef) and COMMAND.match(node.name):
                for one in ast.walk(node):
                    if isinstance(one, ast.Return) and one.value is not None:
                        yield from (
                            (f"{path.name}::{node.name}", value.value)
                            for value in ast.walk(one.value)
                            if isinstance(value, ast.Constant) and type(value.value) is int
                        )


def test_no_command_returns_a_status_that_the_list_lacks() -> None:
    found = list(returned_numbers())
    assert len(found) > 30
    assert [one for one in found if one[1] not in (0, 1)] == []


def test_services_use_the_same_statuses() -> None:
    assert certs_command.EXIT_FAILED == exit_statuses.FAILED
    assert certs_command.EXIT_BAD_SETTINGS == exit_statuses.MISUSED
