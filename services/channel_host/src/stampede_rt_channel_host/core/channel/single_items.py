"""Finds the item of a usual read without a scan: the item at an instant, and the last item before an end. Pure."""

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

    None: there may be no such item, or several, and only a scan finds out.
    """
    found = None if held.overlap_nanos else _single_up_to(held, time)
    if found is None:
        return None
    part, following = found
    bucket, durations = part.first_time, part.run.durations
    duration = ABSENT if durations is None else durations[part.lo]
    if bucket < time and (bucket + duration <= time if duration != ABSENT else following is None and now < time):
        return None
    return found


def last_in(held: HeldItems, within: ResolvedInterval) -> FoundItem | None:
    """The last item whose time is in the interval, if the interval begins at or before the oldest item.

    None: only a scan finds out.
    """
    oldest, newest, latest_time = held.oldest, held.newest, within.end - within.end_exclusive
    if oldest is None or newest is None or oldest < within.start + within.start_exclusive:
        return None
    if newest > latest_time:
        return _single_up_to(held, latest_time)
    part = held.index.last_item
    return None if part is None else FoundItem(part, None)


def _single_up_to(held: HeldItems, time: int) -> FoundItem | None:
    """The last held item at or before `time`, if no other item has its time; otherwise None."""
    found = held.index.single_up_to(time)
    if found is None:
        return None
    part, following = found
    return None if (part.first_time, part.first_seq) < held.floor else FoundItem(part, following)
