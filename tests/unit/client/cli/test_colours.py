"""Colours on a terminal."""

from __future__ import annotations

import io

import pytest

from stampede_rt.cli.colours import styled


class Terminal(io.StringIO):
    def isatty(self) -> bool:
        return True


@pytest.fixture(autouse=True)
def plain_environment(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NO_COLOR", raising=False)
    monkeypatch.setenv("TERM", "xterm")


def test_a_terminal_shows_colours() -> None:
    assert styled("gone", "red", Terminal()) == "\x1b[31mgone\x1b[0m"


def test_an_output_that_is_no_terminal_has_no_colours() -> None:
    assert styled("gone", "red", io.StringIO()) == "gone"


@pytest.mark.parametrize(
    ("variable", "value", "is_plain"), [("NO_COLOR", "1", True), ("NO_COLOR", "", False), ("TERM", "dumb", True)]
)
def test_the_environment_switches_colours_off(
    variable: str, value: str, is_plain: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(variable, value)
    assert (styled("gone", "red", Terminal()) == "gone") is is_plain
