"""Which messages were put lately under an id of their own, so that a second put of the same id is not held again.

Pure. What is known is bounded in time and in bytes; the oldest is forgotten first.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from typing import NamedTuple

KEPT_NANOS = 600_000_000_000
OVERHEAD_BYTES = 192
"""The bytes, about, that an id takes beside its characters."""
KNOWN_BYTES_MAX = 16 * 2**20
"""Of one queue: about 70,000 ids of 36 characters."""


class KnownMessage(NamedTuple):
    """A message that was accepted under an id: its seq, and when."""

    message_id: str
    seq: int
    time: int


class MessageIds:
    """Of the last 10 minutes. `now` never runs backwards."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, KnownMessage] = OrderedDict()  # in the order of their acceptance
        self.footprint_bytes = 0

    def find(self, message_id: str, now: int) -> int | None:
        """The seq of the message that was accepted under this id; None: there is none, or it was too long ago."""
        known = self._known.get(message_id)
        return known.seq if known is not None and known.time > now - KEPT_NANOS else None

    def record(self, message_id: str, seq: int, now: int) -> None:
        """The message was accepted. Its id is not known, or was forgotten by now."""
        if message_id in self._known:
            self._forget(message_id)
        self._known[message_id] = KnownMessage(message_id, seq, now)
        self.footprint_bytes += _cost(message_id)
        while self.footprint_bytes > KNOWN_BYTES_MAX:
            self._forget(next(iter(self._known)))

    def forget_one(self, now: int) -> bool:
        """Forget an id that was accepted too long ago; False if there is none."""
        due = self.next_deadline()
        if due is None or due > now:
            return False
        self._forget(next(iter(self._known)))
        return True

    def next_deadline(self) -> int | None:
        """When the oldest is to be forgotten."""
        return next(iter(self._known.values())).time + KEPT_NANOS if self._known else None

    def all(self, now: int) -> Iterator[KnownMessage]:
        """The known ids, the oldest first."""
        return (known for known in self._known.values() if known.time > now - KEPT_NANOS)

    def _forget(self, message_id: str) -> None:
        del self._known[message_id]
        self.footprint_bytes -= _cost(message_id)


def _cost(message_id: str) -> int:
    return len(message_id) + OVERHEAD_BYTES
