"""Messages between a role and the orchestrator: one JSON object a line. Pure.

A role sends `ready` once, then any number of `progress`, `step` and `picture`, and at last `result` or `failed`. The
orchestrator sends only one message: the start time.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from typing import Any

LINE_BYTES_MAX = 4 * 1024 * 1024  # the picture's thumbnails are the longest line, about a quarter of a megabyte
EVENTS = frozenset({"ready", "progress", "step", "picture", "result", "failed"})

Message = Mapping[str, Any]


class BadMessage(ValueError):
    """A line is not a message of a role."""


def encode(event: str, **fields: object) -> str:
    """Return one line without its line feed. Raises BadMessage for an event that the orchestrator does not know."""
    if event not in EVENTS:
        raise BadMessage(f"a role has no event {event!r}; there are {', '.join(sorted(EVENTS))}")
    return json.dumps({"event": event, **fields}, separators=(",", ":"), allow_nan=False)


def decode(line: str) -> Message:
    """Return the message of a line. Raises BadMessage, which quotes the line's beginning, if it is not a message."""
    try:
        message = json.loads(line)
    except json.JSONDecodeError:
        raise BadMessage(f"no JSON: {line[:80]!r}") from None
    if not isinstance(message, dict) or message.get("event") not in EVENTS:
        raise BadMessage(f"this line is not an event of a role: {line[:80]!r}")
    return message


def encode_start(start_unix_nano: int) -> str:
    """Return the orchestrator's only line: the first instant of the programme."""
    return json.dumps({"start_unix_nano": start_unix_nano})


def decode_start(line: str) -> int:
    """Return the first instant of the programme. Raises BadMessage if the line is anything else."""
    try:
        start = json.loads(line)["start_unix_nano"]
    except (ValueError, KeyError, TypeError):
        raise BadMessage(f"this line is not a start: {line[:80]!r}") from None
    if type(start) is not int:
        raise BadMessage(f"the start is {start!r}; it is an int, nanoseconds since the epoch")
    return start
