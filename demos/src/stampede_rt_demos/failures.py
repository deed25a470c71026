"""The exception with which a demo ends when it cannot go on. Pure."""

from __future__ import annotations

_TRACEBACK_MARKS = " |+-^"


class DemoFailed(Exception):
    """The demo cannot go on. The message is one sentence for the user with the failure, its reason, and the way out."""


def one_sentence(output: str) -> str:
    """Return the first line of a service's output and its last line, without the marks of a traceback."""
    first, *lines = [line.strip(_TRACEBACK_MARKS) for line in output.splitlines() if line.strip(_TRACEBACK_MARKS)]
    first = first.removesuffix("; its last lines:")
    return f"{first}: {lines[-1]}" if lines else first
