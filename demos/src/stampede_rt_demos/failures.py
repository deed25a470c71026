"""The one exception that a demo ends with when it cannot go on. Pure."""

from __future__ import annotations

_RULERS = " |+-^"


class DemoFailed(Exception):
    """The demo cannot go on; the message is one sentence for the person in front of it: what, why, and the way out."""


def one_sentence(story: str) -> str:
    """The first line of a service's story and the last thing that it said, without a traceback's rulers."""
    first, *lines = [line.strip(_RULERS) for line in story.splitlines() if line.strip(_RULERS)]
    first = first.removesuffix("; its last lines:")
    return f"{first}: {lines[-1]}" if lines else first
