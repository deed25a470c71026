"""The message ids of the latest messages, so that a second message of the same id is not stored. Pure.

The memory is bounded in time and in bytes. The oldest ids are forgotten first.
"""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator
from typing import NamedTuple

KEPT_NANOS = 600_000_000_000
OVERHEAD_BYTES = 192
"""The approximate bytes that an id takes beside its characters."""
KNOWN_BYTES_MAX = 16 * 2**20
"""The bound of one queue: about 70,000 ids of 36 characters."""


class KnownMessage(NamedTuple):
    """An accepted message with an id: its seq, and the time of its acceptance."""

    message_id: str
    seq: int
    time: int


class MessageIds:
    """The ids of the last 10 minutes. `now` never goes back."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, KnownMessage] = OrderedDict()  # in the order of acceptance
        self.footprint_bytes = 0

    def find(self, message_id: str, now: int) -> int | None:
        """The seq of the message that was accepted under this id; None: there is none, or it was too long ago."""
        known = self._known.get(message_id)
        return known.seq if known is not None and known.time > now - KEPT_NANOS else None

    def record(self, message_id: str, seq: int, now: int) -> None:
        """Note an accepted message. It replaces one that was accepted under the same id too long ago."""
        if message_id in self._known:
            self._forget(message_id)
        self._known[message_id] = KnownMessage(message_id, seq, now)
        self.footprint_bytes += _cost(message_id)
        while self.footprint_bytes > KNOWN_BYTES_MAX:
            self._forget(next(iter(self._known)))

    def forget_one(self, now: int) -> bool:
        """Forget one id that was accepted too long ago. Returns False if there is none."""
        due = self.next_deadline()
        if due is None or due > now:
            return False
        self._forget(next(iter(self._known)))
        return True

    def next_deadline(self) -> int | None:
        """The time at which the oldest id is to be forgotten; None: no id is known."""
        return next(iter(self._known.values())).time + KEPT_NANOS if self._known else None

    def all(self, now: int) -> Iterator[KnownMessage]:
        """The known ids, the oldest first."""
        return (known for known in self._known.values() if known.time > now - KEPT_NANOS)

    def _forget(self, message_id: str) -> None:
        del self._known[message_id]
        self.footprint_bytes -= _cost(message_id)


def _cost(message_id: str) -> int:
    return len(message_id) + OVERHEAD_BYTES
