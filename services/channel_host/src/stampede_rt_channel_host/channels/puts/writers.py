"""The callers whose items one channel accepted lately. Pure."""

from __future__ import annotations

WRITERS_MAX = 8
"""The most writers that a channel remembers. Their names and times take up about 600 bytes."""


class Writers:
    """The latest writers of one channel, each with the time of its last accepted put. Beyond WRITERS_MAX the channel
    forgets the writer whose last put is the oldest.
    """

    __slots__ = ("_last",)

    def __init__(self) -> None:
        self._last: dict[str, int] = {}

    def note(self, name: str, now: int) -> None:
        """Note that the channel accepted a put of `name`."""
        last = self._last
        if name not in last and len(last) >= WRITERS_MAX:
            del last[min(last, key=last.__getitem__)]
        last[name] = now

    def latest(self) -> list[tuple[str, int]]:
        """The writers with the times of their last puts, the latest first."""
        return sorted(self._last.items(), key=lambda one: one[1], reverse=True)
