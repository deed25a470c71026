"""Finds the item of a usual read without a walk: the item at an instant, and the newest item. Pure."""

from __future__ import annotations

from typing import NamedTuple

from stampede_rt.values.timeline import ResolvedInterval
from stampede_rt_channel_host.core.channel.held_items import HeldItems
from stampede_rt_channel_host.core.channel.run import ABSENT, Slice


class FoundItem(NamedTuple):
    """One item, and the time of the bucket after it; None: it is in the newest bucket."""

    part: Slice
    next_time: int | None


def item_at(held: HeldItems, time: int, now: int) -> FoundItem | None:
    """The only item whose span holds the instant `time`. `now` is the instant of the meta-time NOW.

    None: there may be no such item, or several, and only a walk finds out.
    """
    part = None if held.overlap_nanos else held.index.single_up_to(time)
    if part is None:
        return None
    bucket, durations = part.first_time, part.run.durations
    if (bucket, part.first_seq) < held.floor:
        return None
    duration, following = ABSENT if durations is None else durations[part.lo], held.next_time(bucket)
    if bucket < time and (bucket + duration <= time if duration != ABSENT else following is None and now < time):
        return None
    return FoundItem(part, following)


def newest_in(held: HeldItems, within: ResolvedInterval) -> FoundItem | None:
    """The newest item, if the interval holds all items; otherwise None."""
    oldest, newest = held.oldest, held.newest
    if oldest is None or newest is None or oldest not in within or newest not in within:
        return None
    part = held.index.last_item
    return None if part is None else FoundItem(part, None)
