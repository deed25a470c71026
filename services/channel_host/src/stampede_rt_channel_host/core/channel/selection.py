"""Decides which held items an interval selects (paper, section 3.2). Pure.

The matching items follow each other in the order (time, seq), except in one bucket, where the read looks at each item.
With `span` this is the last bucket at or before the lower bound: the spans of its items may reach into the interval.
With `whole` it is the last bucket in the interval: the spans of its items may end after the interval. So a read costs
two searches, that bucket, and the items that the read returns. With overlap the read also looks at each item that
begins at most one `overlap` before the bound. The span of an earlier item cannot reach so far.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import NamedTuple, Protocol

from stampede_rt.values.timeline import Match, ResolvedInterval
from stampede_rt_channel_host.core.channel import pieces
from stampede_rt_channel_host.core.channel.held_items import HeldItems
from stampede_rt_channel_host.core.channel.index_snapshot import IndexSnapshot
from stampede_rt_channel_host.core.channel.item_keys import SEQ_END, ItemKey
from stampede_rt_channel_host.core.channel.pieces import Pieces, WorkAbandoned
from stampede_rt_channel_host.core.channel.run import ABSENT, Slice
from stampede_rt_channel_host.core.channel.single_items import item_at, last_in
from stampede_rt_channel_host.core.channel.slices_in_parts import SlicesInParts, emptying
from stampede_rt_channel_host.core.channel.values import NO_NEXT_TIMES, Position, Query

Fits = Callable[[int, int], bool]
"""A test of an item's time and duration."""


class ReadableItems(Protocol):
    """Held items as reads see them: all items of a channel, or the part that a group shows."""

    @property
    def newest(self) -> int | None:
        """The latest time of an item, or None if there are no items."""

    @property
    def oldest(self) -> int | None:
        """The earliest time of an item, or None if there are no items."""

    @property
    def frontier(self) -> int | None:
        """See `Holdings`."""

    @property
    def gone_before(self) -> int | None:
        """See `Holdings`."""

    @property
    def overlap_nanos(self) -> int:
        """See `Holdings`."""

    @property
    def collected_by(self) -> str:
        """See `Holdings`."""

    @property
    def end(self) -> ItemKey:
        """A key above the keys of all visible items, and at or below the keys of all hidden items."""

    def snapshot(self) -> IndexSnapshot:
        """All items that the channel holds now, visible or not."""

    def next_time(self, time: int, /) -> int | None:
        """The time of the next bucket after `time`, or None if there is none."""

    def last_time_up_to(self, time: int, /) -> int | None:
        """The time of the last bucket at or before `time`, or None if there is none."""


class _KeyRange(NamedTuple):
    """The items at or above `low` and below `high`. With `fits`, only items that pass this test."""

    low: ItemKey
    high: ItemKey
    fits: Fits | None = None


class SelectedSlices(NamedTuple):
    """The matching slices, in ascending order.

    `more`: the limit cut off further items. `next_time` is the time of the bucket after the last item, or None if the
    last item is in the newest bucket. `next_times`: see `ReadAnswer`.
    """

    slices: Sequence[Slice]
    more: bool
    next_time: int | None
    next_times: Mapping[ItemKey, int]


NOTHING = SelectedSlices((), False, None, NO_NEXT_TIMES)


def select(
    held: ReadableItems, query: Query, within: ResolvedInterval, now: int, on_hold: Callable[[], object] = lambda: None
) -> Pieces[SelectedSlices]:  # fmt: skip
    """The matching items, in pieces. `now` is the instant of the meta-time NOW.

    If there is more than one piece, calls `on_hold` at the end of the first piece.
    """
    if within.is_empty or held.oldest is None:
        return NOTHING
    if isinstance(held, HeldItems) and (single := _single(held, query, within, now)) is not None:
        return single
    ranges = [_clip(key_range, query, held.end) for key_range in _key_ranges(held, query.match, within, now)]
    snapshot = held.snapshot()

    def next_time(time: int) -> int | None:
        return snapshot.next_time(time, held.end) if snapshot.is_held else held.next_time(time)

    taking = _SliceSelection(snapshot, query.limit, next_time, down=query.newest_first)
    try:
        for key_range in reversed(ranges) if query.newest_first else ranges:
            if key_range.low >= key_range.high:
                continue
            while (rest := taking.take(key_range)) is not None:
                key_range = rest  # the range without the items already taken
                if not snapshot.is_held:
                    snapshot.hold()
                    on_hold()
                yield
        slices = taking.finish()
        if not slices:
            return NOTHING
        return SelectedSlices(slices, taking.more, next_time(slices[-1].last_time), taking.next_times)
    except WorkAbandoned:
        snapshot.close()
        yield from emptying(taking.finish())
        raise
    finally:
        snapshot.close()


def _single(held: HeldItems, query: Query, within: ResolvedInterval, now: int) -> SelectedSlices | None:
    """The answer of a usual read for one item, found without a scan; None: scan."""
    if query.after is not None or query.newer_than is not None:
        return None
    if query.match is Match.SPAN and within.start == within.end:
        found = item_at(held, within.start, now)
        return None if found is None else SelectedSlices((found.part,), False, found.next_time, NO_NEXT_TIMES)
    if query.match is Match.START and query.newest_first and query.limit == 1:
        found = last_in(held, within)
        more = held.items > 1 if found is None or found.next_time is None else found.part.first_time != held.oldest
        return None if found is None else SelectedSlices((found.part,), more, found.next_time, NO_NEXT_TIMES)
    return None


class _SliceSelection:
    """Takes slices from ranges of keys, in one direction, until the limit is reached."""

    def __init__(
        self, snapshot: IndexSnapshot, limit: int | None, next_time: Callable[[int], int | None], *, down: bool
    ) -> None:
        self._snapshot = snapshot
        self._items_left = limit
        self._next_time = next_time
        self._down = down
        self._left_out = False  # whether the test has left an item out after the last taken slice
        self._parts: deque[list[Slice]] = deque()  # the slices that earlier pieces took
        self._slices: list[Slice] = []
        self.more = False
        self.next_times: dict[ItemKey, int] = {}

    def take(self, key_range: _KeyRange) -> _KeyRange | None:
        """Take slices from a range, as many as one piece of work allows.

        Returns the rest of the range, or None if the range is done or the limit is reached.
        """
        if self.more:
            return None
        fits, all_shown = key_range.fits, not self._snapshot.is_held
        steps, steps_max = 0, pieces.STEPS_PER_PIECE
        for part in self._scan(key_range):
            steps += 1
            if all_shown or self._snapshot.shows(part):
                if fits is None and self._items_left is None and not self._left_out:
                    self._slices.append(part)
                elif not self._take_fitting(part, fits):
                    return None
            if fits is not None:
                steps += part.items // pieces.ITEMS_PER_STEP
            if steps >= steps_max:
                self._close_part()
                return self._behind(part, key_range)
        return None

    def _scan(self, key_range: _KeyRange) -> Iterator[Slice]:
        scan = self._snapshot.slices_down if self._down else self._snapshot.slices
        return scan(key_range.low, key_range.high)

    def _behind(self, part: Slice, key_range: _KeyRange) -> _KeyRange:
        """The part of the range that a scan reaches after `part`."""
        if self._down:
            return key_range._replace(high=(part.first_time, part.first_seq))
        return key_range._replace(low=(part.last_time, part.end_seq))

    def _take_fitting(self, part: Slice, fits: Fits | None) -> bool:
        """Take the fitting items of a slice. Returns False if the limit cut items off."""
        found = [part] if fits is None else [*_fitting(part, fits)]
        at, end = (part.hi, part.lo) if self._down else (part.lo, part.hi)
        for one in reversed(found) if self._down else found:
            first, last = (one.hi, one.lo) if self._down else (one.lo, one.hi)
            self._left_out |= first != at
            at = last
            if self._items_left is not None and one.items > self._items_left:
                self.more = True
                if self._items_left:
                    lo, hi = (one.hi - self._items_left, one.hi) if self._down else (one.lo, one.lo + self._items_left)
                    self._append(Slice(one.run, lo, hi))
                return False
            self._append(one)
            self._items_left = None if self._items_left is None else self._items_left - one.items
        self._left_out |= at != end
        return True

    def _append(self, one: Slice) -> None:
        if self._left_out:
            self._note_next_time(one)
            self._left_out = False
        self._slices.append(one)

    def _note_next_time(self, one: Slice) -> None:
        """Note the time of an item that the test leaves out: with overlap it may end the span of an item before it."""
        taken = self._slices[-1] if self._slices else self._taken_before()
        if taken is None:
            return
        before, after = (one, taken) if self._down else (taken, one)
        next_time = self._next_time(before.last_time)
        if next_time is not None and next_time < after.first_time:
            self.next_times[before.last_time, before.end_seq] = next_time

    def _taken_before(self) -> Slice | None:
        """The slice that an earlier piece took last."""
        if not self._parts:
            return None
        return self._parts[0][0] if self._down else self._parts[-1][-1]

    def _close_part(self) -> None:
        """Move the slices taken so far to `_parts`."""
        part, self._slices = self._slices, []
        if self._down:
            part.reverse()
        if part:
            (self._parts.appendleft if self._down else self._parts.append)(part)

    def finish(self) -> Sequence[Slice]:
        """All slices taken, in ascending order."""
        self._close_part()
        return SlicesInParts(self._parts) if len(self._parts) > 1 else self._parts[0] if self._parts else ()


def _key_ranges(held: ReadableItems, match: Match, within: ResolvedInterval, now: int) -> list[_KeyRange]:
    """The ranges of keys that together hold the matching items, in ascending order."""
    low = (within.start, SEQ_END if within.start_exclusive else 0)
    high = (within.end, 0 if within.end_exclusive else SEQ_END)
    if match is Match.START:
        return [_KeyRange(low, high)]
    if match is Match.SPAN:
        return [*_reaching_in(held, within, now), _KeyRange((within.start, SEQ_END), high)]
    return _staying_in(held, within, low, now)


def _reaching_in(held: ReadableItems, within: ResolvedInterval, now: int) -> list[_KeyRange]:
    """The items that begin at or before the lower bound, and whose spans contain an instant of the interval."""
    bucket = held.last_time_up_to(within.start)
    if bucket is None:
        return []
    earlier = _reaching_over(held.overlap_nanos, within.start, bucket)
    if bucket in within:
        return [*earlier, _KeyRange((bucket, 0), (bucket, SEQ_END))]
    following = held.next_time(bucket)

    def fits(time: int, duration: int) -> bool:
        if duration != ABSENT:
            return bucket + duration > within.start
        if following is not None:
            return True
        return now > within.start or (now == within.start and not within.start_exclusive)

    return [*earlier, _KeyRange((bucket, 0), (bucket, SEQ_END), fits)]


def _reaching_over(overlap: int, start: int, bucket: int) -> list[_KeyRange]:
    """The items before `bucket` whose spans reach beyond `start`."""
    if not overlap:
        return []
    return [
        _KeyRange((start - overlap, SEQ_END), (bucket, 0), lambda time, duration: time + min(duration, overlap) > start)
    ]


def _staying_in(held: ReadableItems, within: ResolvedInterval, low: ItemKey, now: int) -> list[_KeyRange]:
    """The items whose whole spans lie in the interval.

    Without overlap, only the spans of the last bucket in the interval can end outside it.
    """
    bucket = held.last_time_up_to(within.end - 1 if within.end_exclusive else within.end)
    if bucket is None or bucket not in within:
        return []
    following = held.next_time(bucket)
    bound = now if following is None else following
    overlap = held.overlap_nanos

    def fits(time: int, duration: int) -> bool:
        if duration == ABSENT:
            return bound <= within.end
        end = time + duration
        if following is not None:
            end = min(end, max(following, time + overlap))
        return end <= within.end

    last = _KeyRange((bucket, 0), (bucket, SEQ_END), fits)
    if not overlap:
        return [_KeyRange(low, (bucket, 0)), last]
    middle = max(low, (within.end - overlap, SEQ_END))
    ends = _KeyRange(middle, (bucket, 0), lambda time, duration: time + min(duration, overlap) <= within.end)
    return [_KeyRange(low, min(middle, (bucket, 0))), ends, last]


def _clip(key_range: _KeyRange, query: Query, end: ItemKey) -> _KeyRange:
    """The range without the items that the query's positions exclude, and without items at or above `end`."""
    low, high, fits = key_range
    high = min(high, end)
    if query.newer_than is not None:
        low = max(low, behind(query.newer_than))
    if query.after is not None and not query.newest_first:
        low = max(low, behind(query.after))
    if query.after is not None and query.newest_first:
        high = min(high, (query.after.time, query.after.seq or 0))
    return _KeyRange(low, high, fits)


def behind(position: Position) -> ItemKey:
    """The first key after a position."""
    return position.time, SEQ_END if position.seq is None else position.seq + 1


def _fitting(part: Slice, fits: Fits) -> Iterator[Slice]:
    """The longest slices of `part` whose items all pass the test."""
    durations = part.run.durations
    if durations is None:
        if fits(part.first_time, ABSENT):
            yield part
        return
    times, lo = part.run.times, part.lo
    for at in range(part.lo, part.hi):
        if not fits(times[at], durations[at]):
            if lo < at:
                yield Slice(part.run, lo, at)
            lo = at + 1
    if lo < part.hi:
        yield Slice(part.run, lo, part.hi)
