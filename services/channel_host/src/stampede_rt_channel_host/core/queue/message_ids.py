"""The message ids of the latest messages, so that the queue does not store a second message of the same id. Pure.

The queue remembers an id for a limited time, and its ids take up a limited number of bytes. Above this number it
forgets the oldest ids of the caller whose ids take up most. So one caller does not push out the ids of other callers.
"""

from __future__ import annotations

from collections import Counter, OrderedDict, deque
from collections.abc import Iterable, Iterator
from heapq import merge
from typing import NamedTuple

KEPT_NANOS = 600_000_000_000  # the time that a queue remembers an id
OVERHEAD_BYTES = 192
"""About how many bytes an id takes in addition to its characters."""
KNOWN_BYTES_MAX = 16 * 2**20
"""The most bytes that the ids of one queue take: about 70,000 ids of 36 characters."""
SHED_PARTS = 256
"""Above the bound, one step frees about 1/256 of the bound, so that such steps are rare."""


class KnownMessage(NamedTuple):
    """An accepted message with an id: its seq, and the time of its acceptance.

    `caller_name` is the name of the caller that put the message; empty if the caller has no name of its own.
    """

    message_id: str
    seq: int
    time: int
    caller_name: str = ""


class MessageIds:
    """The message ids of the last 10 minutes. `now` never goes back."""

    def __init__(self) -> None:
        self._known: OrderedDict[str, KnownMessage] = OrderedDict()  # in the order of acceptance
        # The known messages of each caller, in the order of acceptance, and some forgotten ones.
        self._messages_by_caller: dict[str, deque[KnownMessage]] = {}
        self._bytes_by_caller: Counter[str] = Counter()  # the bytes of the known ids of each caller that has any
        self.footprint_bytes = 0

    def find(self, message_id: str, now: int) -> int | None:
        """The seq of the message that was accepted with this id, or None if none was in the last 10 minutes."""
        known = self._known.get(message_id)
        return known.seq if known is not None and known.time > now - KEPT_NANOS else None

    def record(self, message_id: str, seq: int, now: int, caller_name: str = "") -> None:
        """Note an accepted message with an id. The entry replaces an older entry with the same id.

        `caller_name` is the name of the caller; empty if the caller has no name of its own.
        """
        if message_id in self._known:
            self._forget(message_id)
        known = self._known[message_id] = KnownMessage(message_id, seq, now, caller_name)
        self._messages_by_caller.setdefault(caller_name, deque()).append(known)
        self._bytes_by_caller[caller_name] += _cost(message_id)
        self.footprint_bytes += _cost(message_id)
        while self.footprint_bytes > KNOWN_BYTES_MAX:
            self._shed()

    def _shed(self) -> None:
        """Forget the oldest ids of the caller whose ids take most bytes.

        Forgets somewhat more than needed, because this method looks at all callers.
        """
        caller_name = max(self._bytes_by_caller, key=self._bytes_by_caller.__getitem__)
        own, enough = self._messages_by_caller[caller_name], KNOWN_BYTES_MAX - KNOWN_BYTES_MAX // SHED_PARTS
        while own and self.footprint_bytes > enough:
            oldest = own.popleft()
            if self._known.get(oldest.message_id) is oldest:
                self._forget(oldest.message_id)

    def forget_one(self, now: int) -> bool:
        """Forget one id that is older than 10 minutes. Returns False if there is no such id."""
        due = self.next_deadline()
        if due is None or due > now:
            return False
        self._forget(next(iter(self._known)))
        return True

    def next_deadline(self) -> int | None:
        """The time at which the queue may forget the oldest id, or None if no id is known."""
        return next(iter(self._known.values())).time + KEPT_NANOS if self._known else None

    def copied(self) -> list[deque[KnownMessage]]:
        """Lists with the known messages, for `latest_of`. Copies 80,000 messages in a millisecond."""
        return [own.copy() for own in self._messages_by_caller.values()]

    def _forget(self, message_id: str) -> None:
        known, cost = self._known.pop(message_id), _cost(message_id)
        self.footprint_bytes -= cost
        self._bytes_by_caller[known.caller_name] -= cost
        own = self._messages_by_caller[known.caller_name]
        if own and own[0] is known:
            own.popleft()
        if not self._bytes_by_caller[known.caller_name]:
            del self._bytes_by_caller[known.caller_name], self._messages_by_caller[known.caller_name]


def latest_of(lists: Iterable[Iterable[KnownMessage]], now: int) -> Iterator[KnownMessage]:
    """The messages with an id of the last 10 minutes, the oldest first. `lists`: the result of `copied`.

    The queue forgets an id earlier only if it also removes it from these lists.
    """
    merged = merge(*lists, key=lambda known: known.seq)
    return (known for known in merged if known.time > now - KEPT_NANOS)


def _cost(message_id: str) -> int:
    return len(message_id) + OVERHEAD_BYTES
