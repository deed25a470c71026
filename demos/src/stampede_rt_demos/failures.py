"""The one exception that a demo ends with when it cannot go on. Pure."""

from __future__ import annotations


class DemoFailed(Exception):
    """The demo cannot go on; the message is one sentence for the person in front of it: what, why, and the way out."""


def one_sentence(story: str) -> str:
    """The first line of a service's story and the last thing that it said."""
    lines = [line.strip() for line in story.splitlines() if line.strip()]
    first = lines[0].removesuffix("; its last lines:")
    return first if len(lines) == 1 else f"{first}: {lines[-1]}"
