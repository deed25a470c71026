"""How many items a channel holds before some instant, and their bytes, without a walk over all of them. Pure.

Ageing needs both sums at the moment when it outdates items, be they a million. So held items are counted in blocks,
stretches of time that adjoin each other. What lies behind the last block is in none: a put in order counts nothing.
"""

from __future__ import annotations

from bisect import bisect_right
from typing import NamedTuple

from stampede_rt_channel_host.core.channel.run import Run

BEGINNING = -(1 << 64)
"""Before every instant."""


class Whole(NamedTuple):
    """The first blocks: how many items they count, of how many payload bytes; all of these are earlier than `end`."""

    items: int
    payload_bytes: int
    end: int


class Tally:
    """Held items by blocks. A block goes from the end of the one before it up to its own end, which is not in it.

    `items`, `payload_bytes`: all that blocks count, which is everything held before `end`.
    """

    __slots__ = ("_ends", "_items", "_payload_bytes", "end", "items", "payload_bytes")

    def __init__(self) -> None:
        self._ends: list[int] = []
        self._items: list[int] = []
        self._payload_bytes: list[int] = []
        self.end = BEGINNING
        self.items = 0
        self.payload_bytes = 0

    def close(self, end: int, items: int, payload_bytes: int) -> None:
        """Another block, of what is held from the last one's end on; all of it is earlier than `end`."""
        self._ends.append(end)
        self._items.append(0)
        self._payload_bytes.append(0)
        self.end = end
        self._count(len(self._ends) - 1, items, payload_bytes)

    def add_late(self, run: Run, payload_bytes: int, low: int, high: int) -> None:
        """Count in a run of which an item lies before `end`; O(log blocks), for each item if it is in several."""
        if self._block(low) == self._block(high):
            self._count(self._block(low), len(run), payload_bytes)
            return
        for time, length in zip(run.times, run.lengths, strict=True):
            self.add_late_item(length, time)

    def add_late_item(self, payload_bytes: int, time: int) -> None:
        """Count in one item, if it lies before `end`."""
        if time < self.end:
            self._count(self._block(time), 1, payload_bytes)

    def _block(self, time: int) -> int:
        return bisect_right(self._ends, time)

    def _count(self, block: int, items: int, payload_bytes: int) -> None:
        self._items[block] += items
        self._payload_bytes[block] += payload_bytes
        self.items += items
        self.payload_bytes += payload_bytes

    def take(self, items: int, payload_bytes: int) -> None:
        """The oldest items go: so many, of so many payload bytes."""
        gone = 0
        while gone < len(self._items) and items >= self._items[gone]:  # ends with the blocks
            items -= self._items[gone]
            payload_bytes -= self._payload_bytes[gone]
            self._count(gone, -self._items[gone], -self._payload_bytes[gone])
            gone += 1
        for column in (self._ends, self._items, self._payload_bytes):
            del column[:gone]
        if not self._ends:
            self.end = BEGINNING
        elif items:
            self._count(0, -items, -payload_bytes)

    def whole_before(self, time: int) -> Whole:
        """The blocks that end at or before `time`; a step for each."""
        blocks = self._block(time)
        end = self._ends[blocks - 1] if blocks else BEGINNING
        return Whole(sum(self._items[:blocks]), sum(self._payload_bytes[:blocks]), end)
