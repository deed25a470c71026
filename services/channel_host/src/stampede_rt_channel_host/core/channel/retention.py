"""When items go (paper, section 3.4): by age, by count, by bytes. Pure.

`clock` is the host's clock; `now` in the docstrings of the time model is the later of it and the newest item's time,
but items age by the clock alone, so that a producer whose clock runs ahead shortens nobody's window.
"""

from __future__ import annotations

from bisect import bisect_left

from stampede_rt_channel_host.core.channel.holdings import AGE, BYTES, COUNT, Going, Holdings
from stampede_rt_channel_host.core.channel.index import SEQ_END
from stampede_rt_channel_host.core.channel.limits import Limits
from stampede_rt_channel_host.core.channel.run import ITEM_OVERHEAD_BYTES, Slice


class Retention:
    """Applies limits to holdings. `limits` may be replaced at any time."""

    __slots__ = ("_held", "limits")

    def __init__(self, limits: Limits, held: Holdings) -> None:
        self.limits = limits
        self._held = held

    def cutoff(self, clock: int) -> int | None:
        """Buckets whose last span ended at or before this instant go."""
        age = self.limits.max_age_nanos
        return None if age is None else clock - age

    def age_out(self, clock: int) -> None:
        """Collect the buckets that are past the age: whole ones, never the newest."""
        cutoff = self.cutoff(clock)
        held = self._held
        if cutoff is None or held.oldest is None or held.oldest > cutoff or held.oldest == held.newest:
            return
        bound = self._age_bound(cutoff)
        if bound is not None:
            held.outdate(held.front(_before(bound)), AGE, clock)

    def _age_bound(self, cutoff: int) -> int | None:
        """The time of the first bucket that age leaves. Span ends ascend with the buckets, so one bucket decides."""
        bucket = self._held.floor_time(cutoff)
        if bucket is None:
            return None
        following = self._held.next_time(bucket)
        if following is None or self._held.bucket_end(bucket, following) > cutoff:
            return bucket
        return following

    def next_age_out(self) -> int | None:
        """When the oldest bucket passes the age, if nothing else happens; None: never."""
        held = self._held
        if self.limits.max_age_nanos is None or held.oldest is None:
            return None
        following = held.next_time(held.oldest)
        if following is None:
            return None
        return held.bucket_end(held.oldest, following) + self.limits.max_age_nanos

    def drop_excess(self, clock: int) -> None:
        """Collect the oldest items above the limits, if that is what a full channel does."""
        held, limits = self._held, self.limits
        if not limits.drops_oldest:
            return
        if limits.max_items is not None and held.items > limits.max_items:
            held.outdate(held.front(oldest_items(held.items - limits.max_items)), COUNT, clock)
        if held.charged_bytes > limits.max_bytes:
            held.outdate(held.front(oldest_bytes(held.charged_bytes - limits.max_bytes)), BYTES, clock)

    def has_room(self, items: int, payload_bytes: int) -> bool:
        """So many more items fit without anything going."""
        held, limits = self._held, self.limits
        within_items = limits.max_items is None or held.items + items <= limits.max_items
        return within_items and held.charged_bytes + payload_bytes + items * ITEM_OVERHEAD_BYTES <= limits.max_bytes

    def has_room_as_if_put(self, time: int, payload_bytes: int, clock: int) -> bool:
        """One item at `time` fits, judged as if it were in: it may end the oldest bucket's span, which then goes."""
        if self.has_room(1, payload_bytes):
            return True
        freed_items, freed_bytes = self._freed_by(time, clock)
        return freed_items > 0 and self.has_room(1 - freed_items, payload_bytes - freed_bytes)

    def _freed_by(self, time: int, clock: int) -> tuple[int, int]:
        """Items and payload bytes that age would collect because an item at `time` comes in.

        Only the bucket before it gets another end, and only the oldest bucket can go first.
        """
        held, cutoff = self._held, self.cutoff(clock)
        if cutoff is None or held.oldest is None or held.oldest >= time:
            return 0, 0
        following = held.next_time(held.oldest)
        if (following is not None and following <= time) or held.bucket_end(held.oldest, time) > cutoff:
            return 0, 0
        bucket = list(held.slices(high=(held.oldest, SEQ_END)))
        return sum(part.items for part in bucket), sum(part.payload_bytes for part in bucket)

    def release_oldest(self, clock: int) -> None:
        """Collect the oldest bucket, whose age an item has waited for that is in now."""
        oldest = self._held.oldest
        following = None if oldest is None else self._held.next_time(oldest)
        if following is not None:
            self._held.outdate(self._held.front(_before(following)), AGE, clock)

    def retry_at(self, time: int, own_end: int | None) -> int | None:
        """When age next makes room, judged as if an item were in at `time`; `own_end` is its end by duration, if any.

        None: only another put can bring that about.
        """
        held, age = self._held, self.limits.max_age_nanos
        if age is None or held.oldest is None:
            return None
        if time < held.oldest:
            return (held.oldest if own_end is None else min(own_end, held.oldest)) + age
        following = held.next_time(held.oldest)
        if time == held.oldest:
            if following is None:
                return None
            own = following if own_end is None else min(own_end, following)
            return max(held.bucket_end(held.oldest, following), own) + age
        return held.bucket_end(held.oldest, time if following is None else min(time, following)) + age


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


def _before(time: int) -> Going:
    """Takes items before `time`."""

    def going(part: Slice) -> int:
        return part.items if part.last_time < time else bisect_left(part.run.times, time, part.lo, part.hi) - part.lo

    return going
