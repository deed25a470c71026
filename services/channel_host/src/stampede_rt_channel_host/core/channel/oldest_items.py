"""The oldest held items, up to a limit. Pure."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable
from typing import NamedTuple

from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.run import ITEM_OVERHEAD_BYTES, Slice


class OldestItems(NamedTuple):
    """Some of the oldest held items, without a gap between them: their number and their payload bytes.

    `last` is their last slice, or None if there are no such items. `rest` is the first slice after them, or None if no
    held item follows. Both may be parts of one slice of the index.
    """

    items: int
    payload_bytes: int
    last: Slice | None
    rest: Slice | None


CountOldest = Callable[[Slice], int]
"""Returns how many items at the beginning of a slice belong to the `OldestItems`.

`Holdings.oldest_items` calls the function with one slice after the other, from the oldest on, until a slice has an item
that does not belong to them.
"""


def before(time: int) -> CountOldest:
    """A `CountOldest` that counts the items before `time`."""

    def count_oldest(part: Slice) -> int:
        return part.items if part.last_time < time else bisect_left(part.run.times, time, part.lo, part.hi) - part.lo

    return count_oldest


def below(key: ItemKey) -> CountOldest:
    """A `CountOldest` that counts the items below `key`."""
    time, seq = key

    def count_oldest(part: Slice) -> int:
        if part.last_time < time:
            return part.items
        times = part.run.times
        bucket = bisect_left(times, time, part.lo, part.hi)
        bucket_end = bisect_right(times, time, bucket, part.hi)
        return min(max(bucket, seq - part.run.first_seq), bucket_end) - part.lo

    return count_oldest


def first_items(count: int) -> CountOldest:
    """A `CountOldest` that counts the first `count` items."""

    def count_oldest(part: Slice) -> int:
        nonlocal count
        taken = min(part.items, count)
        count -= taken
        return taken

    return count_oldest


def first_bytes(charged_bytes: int) -> CountOldest:
    """A `CountOldest` that counts items until they are together charged with `charged_bytes` or more.

    An item is charged with its payload and ITEM_OVERHEAD_BYTES.
    """

    def count_oldest(part: Slice) -> int:
        nonlocal charged_bytes
        lengths, lo = part.run.lengths, part.lo
        for at in range(lo, part.hi):
            if charged_bytes <= 0:
                return at - lo
            charged_bytes -= lengths[at] + ITEM_OVERHEAD_BYTES
        return part.items

    return count_oldest
