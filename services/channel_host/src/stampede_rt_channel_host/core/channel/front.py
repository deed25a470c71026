"""The oldest held items, as far as a limit takes them. Pure."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable
from typing import NamedTuple

from stampede_rt_channel_host.core.channel.run import ITEM_OVERHEAD_BYTES, Slice


class Front(NamedTuple):
    """The oldest held items: how many, and their payload bytes; the last slice of them, as far as it goes, None if they
    are none; and the first slice behind them, None if they are all that is held."""

    items: int
    payload_bytes: int
    last: Slice | None
    rest: Slice | None


Going = Callable[[Slice], int]
"""Tells how many items of a slice go; slices come from the oldest on."""


def before(time: int) -> Going:
    """Takes items before `time`."""

    def going(part: Slice) -> int:
        return part.items if part.last_time < time else bisect_left(part.run.times, time, part.lo, part.hi) - part.lo

    return going


def oldest_items(count: int) -> Going:
    """Takes the first `count` items."""

    def going(part: Slice) -> int:
        nonlocal count
        taken = min(part.items, count)
        count -= taken
        return taken

    return going


def oldest_bytes(charged_bytes: int) -> Going:
    """Takes items until so many bytes are charged for them."""

    def going(part: Slice) -> int:
        nonlocal charged_bytes
        lengths, lo = part.run.lengths, part.lo
        for at in range(lo, part.hi):
            if charged_bytes <= 0:
                return at - lo
            charged_bytes -= lengths[at] + ITEM_OVERHEAD_BYTES
        return part.items

    return going
