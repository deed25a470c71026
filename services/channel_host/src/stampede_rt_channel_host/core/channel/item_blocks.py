"""Counts the items of a channel below an item key, and their bytes, without a scan of all of them. Pure.

Retention needs both sums when it outdates items, perhaps a million in one step. So the channel counts held items in
blocks. A block holds the items between two item keys. Items after the last block are in no block, so a put in order
updates no block. The channel splits a block that gets many late items, so that no block grows to much more than twice
its usual size.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from itertools import accumulate, takewhile
from typing import NamedTuple

from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, ItemKey
from stampede_rt_channel_host.core.channel.run import ITEM_OVERHEAD_BYTES

BLOCK_ITEMS = 1024
"""The usual number of items in a block. To count some of the oldest items, the channel scans little more
than the items of one block.
"""


class WholeBlocks(NamedTuple):
    """Some of the first blocks: the number of their items and of their payload bytes.

    They hold all held items below `end`.
    """

    items: int
    payload_bytes: int
    end: ItemKey


NO_BLOCKS = WholeBlocks(0, 0, FIRST_KEY)


class ItemBlocks:
    """Held items by blocks. A block begins at the end of the block before it, and ends at its own end, exclusive.

    `items` and `payload_bytes` are the sums over all blocks. The blocks hold all held items below `end`.
    """

    __slots__ = ("_ends", "_items", "_payload_bytes", "end", "items", "payload_bytes")

    def __init__(self) -> None:
        self._ends: list[ItemKey] = []
        self._items: list[int] = []
        self._payload_bytes: list[int] = []
        self.end = FIRST_KEY
        self.items = 0
        self.payload_bytes = 0

    def close(self, end: ItemKey, items: int, payload_bytes: int) -> None:
        """Add a block with the held items from the last block's end up to `end`, exclusive."""
        self._ends.append(end)
        self._items.append(0)
        self._payload_bytes.append(0)
        self.end = end
        self._count(len(self._ends) - 1, items, payload_bytes)

    def add_late(self, first_seq: int, times: Sequence[int], lengths: Sequence[int]) -> tuple[ItemKey, ItemKey] | None:
        """Count those items of a run that are below `end`.

        Returns the bounds of a block that must be split, if there is one.
        """
        crowded: int | None = None
        for seq, (time, length) in enumerate(zip(times, lengths, strict=True), first_seq):
            if (time, seq) < self.end:
                block = self._block((time, seq))
                self._count(block, 1, length)
                if self._items[block] > 2 * BLOCK_ITEMS:
                    crowded = block
        if crowded is None:
            return None
        return self._ends[crowded - 1] if crowded else FIRST_KEY, self._ends[crowded]

    def split(self, at: ItemKey, items: int, payload_bytes: int) -> None:
        """Split the block that holds `at`. The lower part has `items` items of `payload_bytes` payload bytes."""
        block = self._block(at)
        self._ends.insert(block, at)
        self._items.insert(block, items)
        self._payload_bytes.insert(block, payload_bytes)
        self._items[block + 1] -= items
        self._payload_bytes[block + 1] -= payload_bytes

    def _block(self, key: ItemKey) -> int:
        return bisect_right(self._ends, key)

    def _count(self, block: int, items: int, payload_bytes: int) -> None:
        self._items[block] += items
        self._payload_bytes[block] += payload_bytes
        self.items += items
        self.payload_bytes += payload_bytes

    def take(self, items: int, payload_bytes: int) -> None:
        """Subtract the oldest `items` items, which have `payload_bytes` payload bytes."""
        gone = 0
        while gone < len(self._items) and items >= self._items[gone]:  # ends with the last block
            items -= self._items[gone]
            payload_bytes -= self._payload_bytes[gone]
            self._count(gone, -self._items[gone], -self._payload_bytes[gone])
            gone += 1
        if gone:
            for column in (self._ends, self._items, self._payload_bytes):
                del column[:gone]
        if not self._ends:
            self.end = FIRST_KEY
        elif items:
            self._count(0, -items, -payload_bytes)

    def whole_below(self, key: ItemKey) -> WholeBlocks:
        """The blocks that end at or below `key`. One step for each block."""
        return self._whole(self._block(key))

    def whole_within(self, *, items: int | None = None, charged_bytes: int | None = None) -> WholeBlocks:
        """The first blocks that together have at most `items` items, or at most `charged_bytes` charged bytes.

        One step for each block.
        """
        if not self._ends:
            return NO_BLOCKS
        if items is not None:
            if items < self._items[0]:
                return NO_BLOCKS
            return self._whole(_within(iter(self._items), items))
        columns = zip(self._items, self._payload_bytes, strict=True)
        charges = (count * ITEM_OVERHEAD_BYTES + payload for count, payload in columns)
        return self._whole(_within(charges, charged_bytes or 0))

    def _whole(self, blocks: int) -> WholeBlocks:
        if not blocks:
            return NO_BLOCKS
        return WholeBlocks(sum(self._items[:blocks]), sum(self._payload_bytes[:blocks]), self._ends[blocks - 1])


def _within(counts: Iterator[int], total_max: int) -> int:
    """The number of first counts whose sum is at most `total_max`."""
    return sum(1 for _ in takewhile(lambda total: total <= total_max, accumulate(counts)))
