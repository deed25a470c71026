"""What a channel holds and what became of the rest: the state under retention, acceptance and reading. Pure.

What lies below `floor` is outdated: collected in every count and never returned, though its memory may be freed later.
So a policy that outdates a million items at once stalls nobody.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Callable, Iterator
from typing import NamedTuple

from stampede_rt_channel_host.core.channel.index import FIRST_PLACE, LAST_PLACE, SEQ_END, ChannelIndex, Place
from stampede_rt_channel_host.core.channel.run import ABSENT, ITEM_OVERHEAD_BYTES, Run, Slice
from stampede_rt_channel_host.core.channel.tally import Tally

AGE, COUNT, BYTES, CONSUMPTION = "age", "count", "bytes", "consumption"

ITEMS_PER_BLOCK = 1024
"""About so many items that came in order are counted as one, so that ageing walks hardly more than so many."""


class Front(NamedTuple):
    """The oldest held items: how many, and their payload bytes; the slices that reach into their last bucket; and the
    first slice behind them, None if they are all that is held."""

    items: int
    payload_bytes: int
    tail: list[Slice]
    rest: Slice | None


Going = Callable[[Slice], int]


class Holdings:
    """Held items and counts. Invariant: `accepted == items + sum(collected.values())`.

    `newest`, `oldest`: times of held items, None if there are none. `newest_collected`: the latest time that age, count
    or bytes have collected; `collected_end`: the latest span end among those, and `collected_by` its cause.
    `newest_consumed`: the latest time that consumption has collected. `last_cause`: of the latest collection. `on_gone`
    hears which seqs are collected, from the first up to, not including, the end.
    """

    __slots__ = (
        "_came_up_to", "_following", "_stored_bytes", "_tally",
        "accepted", "accepted_bytes", "collected", "collected_by", "collected_end", "floor", "index", "items",
        "last_cause", "newest", "newest_collected", "newest_consumed", "oldest", "on_gone", "payload_bytes",
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
        self.newest_consumed: int | None = None
        self.last_cause = AGE
        self.on_gone: Callable[[int, int], None] | None = None
        self._came_up_to: int | None = None
        self._following: tuple[int | None, int | None] = (None, None)  # the last answer of next_time, while it holds
        self._tally = Tally()  # of what is held, without the newest items
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
    def has_backlog(self) -> bool:
        """There are entries to free."""
        return self.index.has_below(self.floor)

    @property
    def frontier(self) -> int | None:
        """The latest span end that was collected, but not above the oldest held item's time; with none left, not above
        what had come when the last one went: a long duration says nothing of items that are still to come."""
        bound = self._came_up_to if self.oldest is None else self.oldest
        if self.collected_end is None or bound is None:
            return self.collected_end
        return min(self.collected_end, bound)

    def store(self, run: Run, payload_bytes: int, low: int, high: int) -> None:
        """Add a run whose times lie between `low` and `high`."""
        if low < self.floor[0]:
            self._make_way()
        self.index.insert(run)
        if low < self._tally.end:
            self._tally.add_late(run, payload_bytes, low, high)
        self._count_in(len(run), payload_bytes, low, high)

    def store_item(self, run: Run, at: int, payload_bytes: int) -> None:
        """Add the item at place `at` of a run of which exactly those before it are in."""
        time = run.times[at]
        if time < self.floor[0]:
            self._make_way()
        self.index.insert_item(run, at)
        if time < self._tally.end:
            self._tally.add_late_item(payload_bytes, time)
        self._count_in(1, payload_bytes, time, time)

    def _make_way(self) -> None:
        """An item comes in below what consumption has taken: of that, nothing may be left in the index."""
        self.free(len(self.index))
        trimmed = self.index.trim_below(self.floor)
        if trimmed is not None:
            self._forget(trimmed)
        self.floor = FIRST_PLACE

    def _count_in(self, items: int, payload_bytes: int, low: int, high: int) -> None:
        self._following = (None, None)
        if self.items - self._tally.items >= ITEMS_PER_BLOCK and self.newest is not None and low > self.newest:
            self._tally.close(low, self.items - self._tally.items, self.payload_bytes - self._tally.payload_bytes)
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

    @property
    def newest_seq(self) -> int | None:
        """The seq of the newest item; None if there is none."""
        last = next(self.slices_down(), None)
        return None if last is None else last.end_seq - 1

    def newest_end(self, now: int) -> int | None:
        """The latest span end in the newest bucket; what has no end holds until `now`."""
        time = self.newest
        return None if time is None else _end_of_newest(self.slices((time, 0)), time, now)

    def slices_by_seq(self, low: int, high: int) -> Iterator[Slice]:
        """Held items with seqs from `low` up to, not including, `high`, in seq order."""
        return self.index.slices_by_seq(low, high, self.floor)

    def seq_from(self, low: int, high: int, entries_max: int) -> int:
        """The first held seq from `low` on, or how far it is known that none is held (see `ChannelIndex.seq_from`)."""
        return self.index.seq_from(low, high, self.floor, entries_max)

    def next_time(self, time: int) -> int | None:
        """The time of the next later bucket than `time`."""
        if self.newest is None or time >= self.newest:
            return None
        known, following = self._following
        if known != time:
            following = self.index.next_time(time)
            self._following = time, following
        return following

    def floor_time(self, time: int) -> int | None:
        """The time of the bucket at or before `time`."""
        if self.oldest is None or time < self.oldest:
            return None
        return self.index.floor_time(time)

    def bucket_end(self, time: int, bound: int) -> int:
        """The last span end of the bucket at `time` if `bound` is the next bucket's time."""
        return latest_end(self.slices((time, 0), (time, SEQ_END)), time, bound)

    def front(self, going: Going) -> Front:
        """The oldest held items, as far as `going` takes them: it tells of each slice in turn how many items go."""
        items = payload_bytes = 0
        tail: list[Slice] = []
        for part in self.index.slices_from(self.floor):
            taken = going(part)
            if taken:
                gone = part if taken == part.items else Slice(part.run, part.lo, part.lo + taken)
                items += taken
                payload_bytes += gone.payload_bytes
                if not tail or tail[-1].last_time < gone.last_time:
                    tail.clear()
                tail.append(gone)
            if taken < part.items:
                return Front(items, payload_bytes, tail, Slice(part.run, part.lo + taken, part.hi))
        return Front(items, payload_bytes, tail, None)

    def front_before(self, time: int) -> Front:
        """The held items before `time`, however many there are: walks only those that whole blocks do not count."""
        items, payload_bytes, end = self._tally.whole_before(time)
        if not items:
            return self.front(before(time))
        for part in self.slices((end, 0), (time, 0)):
            items += part.items
            payload_bytes += part.payload_bytes
        last_time = self.index.floor_time(time - 1)
        assert last_time is not None, "there are items"
        tail = list(self.slices((last_time, 0), (time, 0)))
        return Front(items, payload_bytes, tail, next(self.slices((time, 0)), None))

    def time_behind(self, front: Front) -> int | None:
        """The time of the bucket behind the last one that a front, which is not empty, takes of."""
        if front.rest is None:
            return None
        last_time, first_held = front.tail[-1].last_time, front.rest.first_time
        return first_held if first_held > last_time else self.next_time(last_time)

    def outdate(self, front: Front, cause: str, now: int) -> None:
        """Collect a front. `now` ends the open spans of the newest bucket, if they are among it."""
        if not front.items:
            return
        self.last_cause = cause
        last, former_floor = front.tail[-1], self.floor
        if cause == CONSUMPTION:  # moves no frontier: items may yet come in below
            before = self.newest_consumed
            self.newest_consumed = last.last_time if before is None else max(before, last.last_time)
        else:
            self._note_end(front, cause, now)
        # Not where the next held item begins: another may yet come between the two.
        self.floor = last.last_time, last.end_seq
        self.items -= front.items
        self.payload_bytes -= front.payload_bytes
        self._tally.take(front.items, front.payload_bytes)
        self.collected[cause] += front.items
        self.oldest = None if front.rest is None else front.rest.first_time
        if front.rest is None:
            self.newest = None
            self._came_up_to = last.last_time if cause == CONSUMPTION else max(last.last_time, now)
        if self.on_gone is not None:
            for part in self.index.slices(former_floor, self.floor):
                self.on_gone(part.first_seq, part.end_seq)

    def _note_end(self, front: Front, cause: str, now: int) -> None:
        """Earlier buckets end at or before the last one's time, so only that one's items count."""
        time = front.tail[-1].last_time
        following = self.time_behind(front)
        bucket = (Slice(part.run, bisect_left(part.run.times, time, part.lo, part.hi), part.hi) for part in front.tail)
        end = _end_of_newest(bucket, time, now) if following is None else latest_end(bucket, time, following)
        if self.collected_end is None or end >= self.collected_end:
            self.collected_end = end
            self.collected_by = cause
        if self.newest_collected is None or time > self.newest_collected:
            self.newest_collected = time

    def free(self, entries_max: int, backlog_bytes_max: int | None = None) -> bool:
        """Free up to `entries_max` entries of outdated items, and more while these are charged with more than
        `backlog_bytes_max`. True if any are left."""
        while entries_max > 0 or (backlog_bytes_max is not None and self.backlog_bytes > backlog_bytes_max):
            entry = self.index.pop_below(self.floor)
            if entry is None:
                return False
            self._forget(Slice(entry.run, entry.lo, entry.hi))
            entries_max -= 1
        return self.has_backlog

    def _forget(self, part: Slice) -> None:
        self._stored_bytes -= part.payload_bytes + part.items * ITEM_OVERHEAD_BYTES


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


def before(time: int) -> Going:
    """Takes items before `time`."""

    def going(part: Slice) -> int:
        return part.items if part.last_time < time else bisect_left(part.run.times, time, part.lo, part.hi) - part.lo

    return going
