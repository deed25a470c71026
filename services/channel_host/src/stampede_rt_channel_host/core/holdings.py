"""What a channel holds and what became of the rest: the state under retention, acceptance and reading. Pure.

What lies below `floor` is outdated: collected in every count and never returned, though its memory may be freed later.
So a policy that outdates a million items at once stalls nobody.
"""

from __future__ import annotations

from collections.abc import Iterator

from stampede_rt_channel_host.core.index import FIRST_PLACE, LAST_PLACE, SEQ_END, ChannelIndex, Place
from stampede_rt_channel_host.core.run import ABSENT, ITEM_OVERHEAD_BYTES, Run, Slice

AGE, COUNT, BYTES, CONSUMPTION = "age", "count", "bytes", "consumption"


class Holdings:
    """Held items and counts. Invariant: `accepted == items + sum(collected.values())`.

    `newest`, `oldest`: times of held items, None if there are none. `newest_collected`: the latest time that age, count
    or bytes have collected; `collected_end`: the latest span end among those, and `collected_by` its cause.
    """

    __slots__ = (
        "_stored_bytes", "accepted", "accepted_bytes", "collected", "collected_by", "collected_end", "floor", "index",
        "items", "newest", "newest_collected", "oldest", "payload_bytes",
    )  # fmt: skip

    def __init__(self) -> None:
        self.index = ChannelIndex()
        self.floor: Place = FIRST_PLACE
        self.items = 0
        self.payload_bytes = 0
        self.newest: int | None = None
        self.oldest: int | None = None
        self.accepted = 0
        self.accepted_bytes = 0
        self.collected = {AGE: 0, COUNT: 0, BYTES: 0, CONSUMPTION: 0}
        self.newest_collected: int | None = None
        self.collected_end: int | None = None
        self.collected_by = AGE
        self._stored_bytes = 0  # charged bytes of every entry in the index, outdated ones included

    @property
    def next_seq(self) -> int:
        """The seq of the next accepted item."""
        return self.accepted + 1

    @property
    def charged_bytes(self) -> int:
        """What the held items count against max_bytes."""
        return self.payload_bytes + self.items * ITEM_OVERHEAD_BYTES

    @property
    def backlog_bytes(self) -> int:
        """Charged bytes of outdated items whose memory is not freed."""
        return self._stored_bytes - self.charged_bytes

    @property
    def frontier(self) -> int | None:
        """The latest span end that was collected, but not above the oldest held item's time."""
        if self.collected_end is None or self.oldest is None:
            return self.collected_end
        return min(self.collected_end, self.oldest)

    def store(self, run: Run, payload_bytes: int, low: int, high: int) -> None:
        """Add a run whose times lie between `low` and `high`."""
        self.index.insert(run)
        self.count_in(len(run), payload_bytes, low, high)

    def count_in(self, items: int, payload_bytes: int, low: int, high: int) -> None:
        """Count items that were added to the index, with times between `low` and `high`."""
        self.items += items
        self.payload_bytes += payload_bytes
        self.accepted += items
        self.accepted_bytes += payload_bytes
        self._stored_bytes += payload_bytes + items * ITEM_OVERHEAD_BYTES
        if self.newest is None or high > self.newest:
            self.newest = high
        if self.oldest is None or low < self.oldest:
            self.oldest = low

    def slices(self, low: Place = FIRST_PLACE, high: Place = LAST_PLACE) -> Iterator[Slice]:
        """Held items at or above `low` and below `high`, ascending."""
        return self.index.slices(max(low, self.floor), high)

    def slices_down(self, low: Place = FIRST_PLACE, high: Place = LAST_PLACE) -> Iterator[Slice]:
        """The same, the last slice first."""
        return self.index.slices_down(max(low, self.floor), high)

    def slices_by_seq(self, low: int, high: int) -> Iterator[Slice]:
        """Held items with seqs from `low` up to, not including, `high`, in seq order."""
        return self.index.slices_by_seq(low, high, self.floor)

    def next_time(self, time: int) -> int | None:
        """The time of the next later bucket than `time`."""
        return None if self.newest is None or time >= self.newest else self.index.next_time(time)

    def floor_time(self, time: int) -> int | None:
        """The time of the bucket at or before `time`."""
        if self.oldest is None or time < self.oldest:
            return None
        return self.index.floor_time(time)

    def bucket_end(self, time: int, bound: int) -> int:
        """The last span end of the bucket at `time` if `bound` is the next bucket's time."""
        return latest_end(self.slices((time, 0), (time, SEQ_END)), time, bound)

    def place_of_item(self, ordinal: int) -> Place:
        """The place of the held item that `ordinal` others precede; the end if there are no more."""
        for part in self.slices():
            if ordinal < part.items:
                return part.run.times[part.lo + ordinal], part.first_seq + ordinal
            ordinal -= part.items
        return LAST_PLACE

    def place_past_bytes(self, charged_bytes: int) -> Place:
        """The first place below which held items are charged with at least so many bytes."""
        for part in self.slices():
            size = part.payload_bytes + part.items * ITEM_OVERHEAD_BYTES
            if size >= charged_bytes:
                return self._place_within(part, charged_bytes)
            charged_bytes -= size
        return LAST_PLACE

    def _place_within(self, part: Slice, charged_bytes: int) -> Place:
        lengths = part.run.lengths
        for at in range(part.lo, part.hi):
            charged_bytes -= lengths[at] + ITEM_OVERHEAD_BYTES
            if charged_bytes <= 0:
                return part.run.times[at], part.run.first_seq + at + 1
        return LAST_PLACE

    def outdate_below(self, place: Place, cause: str, now: int) -> None:
        """Collect everything below `place`. `now` ends the spans of the newest bucket, if they are among it."""
        items = payload_bytes = 0
        last: Slice | None = None
        for last in self.slices(high=place):
            items += last.items
            payload_bytes += last.payload_bytes
        if last is None:
            return
        self._note_end(last.last_time, place, cause, now)
        # Not `place` itself: an item may yet come between the last one collected and the first one held.
        self.floor = last.last_time, last.end_seq
        self.items -= items
        self.payload_bytes -= payload_bytes
        self.collected[cause] += items
        first = next(self.slices(), None)
        self.oldest = None if first is None else first.run.times[first.lo]
        self.newest = None if first is None else self.newest

    def _note_end(self, time: int, place: Place, cause: str, now: int) -> None:
        """Earlier buckets end at or before the last collected one's time, so only that one's items count."""
        following = self.next_time(time)
        collected = self.slices((time, 0), place)
        end = _end_of_newest(collected, time, now) if following is None else latest_end(collected, time, following)
        if self.collected_end is None or end >= self.collected_end:
            self.collected_end = end
            self.collected_by = cause
        if self.newest_collected is None or time > self.newest_collected:
            self.newest_collected = time

    def free(self, entries_max: int, backlog_bytes_max: int) -> bool:
        """Free entries of outdated items: up to `entries_max`, or until the backlog is small. True if any are left."""
        while entries_max > 0 or self.backlog_bytes > backlog_bytes_max:
            entry = self.index.pop_below(self.floor)
            if entry is None:
                return False
            items = entry.hi - entry.lo
            self._stored_bytes -= entry.run.payload_bytes(entry.lo, entry.hi) + items * ITEM_OVERHEAD_BYTES
            entries_max -= 1
        return self.backlog_bytes > 0


def latest_end(bucket: Iterator[Slice], time: int, bound: int) -> int:
    """The latest span end of items at `time` that the next bucket's time `bound` bounds."""
    longest = 0
    for part in bucket:
        durations = part.run.durations
        if durations is None:
            return bound
        for duration in durations[part.lo : part.hi]:
            if duration == ABSENT:
                return bound
            longest = max(longest, duration)
    return min(time + longest, bound)


def _end_of_newest(bucket: Iterator[Slice], time: int, now: int) -> int:
    """The latest span end of items in the newest bucket: nothing bounds durations, open items hold until `now`."""
    ends = [time]
    for part in bucket:
        durations = part.run.durations
        for duration in (ABSENT,) if durations is None else durations[part.lo : part.hi]:
            ends.append(max(now, time) if duration == ABSENT else time + duration)
    return max(ends)
