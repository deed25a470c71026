"""Answers reads by time from a ring, with the same answer that the host would give. Pure.

If the ring cannot answer a read exactly, the result is None, and the caller asks the host. An item before the interval
may have a span that reaches into the interval. So a read needs the bucket at or before the start of the interval. The
bucket of the first item of the ring's first ordered slot may lack items. The ring has all items of later buckets.
"""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Callable, Sequence
from itertools import pairwise
from typing import NamedTuple

from stampede_rt.ring.facts import age_bound, surely_held
from stampede_rt.ring.layout import (
    ABSENT_INSTANT,
    GONE_BEFORE,
    HEAD,
    LATEST_ADVANCE,
    NEWEST_SLOT,
    NEWEST_TIME,
    RECORDED,
)
from stampede_rt.ring.ring_view import RingView, Slot
from stampede_rt.values.answers import ABSENT
from stampede_rt.values.reading import ReadQuery
from stampede_rt.values.timeline import Match, MetaTime, ResolvedInterval

SLOTS_MAX = 256  # the most slots of one read; the host answers longer reads
ITEMS_MAX = 8192  # the most items of these slots

Columns = tuple[Sequence[int], Sequence[int] | None]
ColumnsOf = Callable[[bytes], Columns]
"""Returns the times of a run's items, and their durations or None. May raise StampedeError for a damaged run."""


class RunPiece(NamedTuple):
    """The items of an encoded run from position `lo` up to `hi`, exclusive. `is_whole`: these are all of them."""

    body: bytes
    lo: int
    hi: int
    is_whole: bool


class RingAnswer(NamedTuple):
    """The answer to a read, see `values.model.Items`. `next_time`: the time of the bucket after the last item."""

    pieces: Sequence[RunPiece]
    next_time: int | None
    interval: ResolvedInterval
    complete: bool
    truncated: bool
    more: bool


class _Items:
    """The items of some slots that follow each other, in order."""

    def __init__(self, view: RingView, slots: Sequence[Slot], columns_of: ColumnsOf) -> None:
        self.view, self.slots = view, slots
        self.times: list[int] = []
        self.durations: list[int] = []
        self.begins = [0]
        self.bodies: list[bytes | None] = []
        self.is_damaged = False
        for slot in slots:
            self._add(slot, columns_of)

    def _add(self, slot: Slot, columns_of: ColumnsOf) -> None:
        if slot.items == 1:
            self.times.append(slot.first_time)
            self.durations.append(slot.duration)
            self.bodies.append(None)
        else:
            body = self.view.copy(slot)
            if body is None or not self.view.is_whole(slot.number):
                self.is_damaged = True
                return
            times, durations = columns_of(body)
            self.times += times
            self.durations += durations or (ABSENT,) * len(times)
            self.bodies.append(body)
        self.begins.append(len(self.times))

    def seq(self, at: int) -> int:
        """Return the seq of an item."""
        number = bisect_right(self.begins, at) - 1
        return self.slots[number].seq + at - self.begins[number]

    def pieces(self, picks: Sequence[int]) -> list[RunPiece] | None:
        """Return the items at the positions `picks`, which ascend; None if the host has overwritten some of them."""
        pieces: list[RunPiece] = []
        for number, (begin, end) in enumerate(pairwise(self.begins)):
            own = picks[bisect_left(picks, begin) : bisect_left(picks, end)]
            if not own:
                continue
            body = self.bodies[number]
            if body is None:
                body = self.view.copy(self.slots[number])
            if body is None or not self.view.is_whole(self.slots[number].number):
                return None
            pieces += _runs(body, own, begin, end - begin)
        return pieces


def _runs(body: bytes, picks: Sequence[int], begin: int, items: int) -> list[RunPiece]:
    """Return the picked items of one run as pieces without gaps."""
    pieces, lo = [], picks[0]
    for at, following in zip(picks, [*picks[1:], None], strict=True):
        if following != at + 1:
            pieces.append(RunPiece(body, lo - begin, at + 1 - begin, at + 1 - lo == items))
            lo = following or 0
    return pieces


def select(view: RingView, facts: list[int], query: ReadQuery, now: int, columns_of: ColumnsOf) -> RingAnswer | None:
    """Return the answer to a read without `after` and `newer_than`, or None if only the host can answer.

    `now`: the host's clock. An answer has at least one item, and lacks none. The caller then checks that the ring is
    still open.
    """
    if facts[NEWEST_SLOT] < 0 or query.after is not None or query.newer_than is not None:
        return None
    within = _resolved(facts, query, now)
    if within is None or within.is_empty:
        return None
    gone, aged = facts[GONE_BEFORE], age_bound(facts, now)
    truncated = gone != ABSENT_INSTANT and within.start < gone
    needs_all = not (query.newest_first and query.limit is not None)
    is_certain = aged is None or within.start > aged
    if (truncated and needs_all) or not (truncated or is_certain):
        return None  # something is missing, or may have grown too old since the host wrote the facts
    if truncated and facts[RECORDED] and not query.within_memory:
        return None  # the archive may have what is missing
    items = _candidates(view, facts, query, within, columns_of)
    if items is None:
        return None
    found, covers_start = items
    picks = _matching(found, query.match, within, max(now, facts[NEWEST_TIME]), facts)
    return _answer(found, picks, query, within, facts, aged, covers_start and is_certain and not truncated, truncated)


def _answer(
    found: _Items, picks: list[int] | None, query: ReadQuery, within: ResolvedInterval, facts: list[int],
    aged: int | None, knows_start: bool, truncated: bool,
) -> RingAnswer | None:  # fmt: skip
    """Apply the limit. `knows_start`: `found` has all items of the interval, and none of them was collected."""
    if not picks:
        return None
    limit = query.limit
    more = limit is not None and len(picks) > limit
    if not (knows_start or more):
        return None
    if limit is not None and more:  # keep also the first item beyond the limit, which must be held for `more`
        picks = picks[-limit - 1 :] if query.newest_first else picks[: limit + 1]
    if not all(surely_held(facts, found.times[at], found.seq(at), None if knows_start else aged) for at in picks):
        return None
    if more:
        picks = picks[1:] if query.newest_first else picks[:-1]
    complete = max(facts[NEWEST_TIME], facts[LATEST_ADVANCE]) >= within.end + (not within.end_exclusive)
    pieces = found.pieces(picks)
    if pieces is None or (query.complete and not complete):
        return None
    next_time = _next_bucket_time(found, found.times[picks[-1]], facts)
    return RingAnswer(pieces, next_time, within, complete, truncated, more)


def _resolved(facts: list[int], query: ReadQuery, now: int) -> ResolvedInterval | None:
    if MetaTime.OLDEST in (query.interval.start.meta, query.interval.end.meta):
        return None
    newest = facts[NEWEST_TIME]
    return query.interval.resolve(now=max(now, newest), newest=newest, oldest=newest)


def _last_slot(view: RingView, first: int, head: int, is_before: Callable[[int], bool]) -> int:
    """Return the last slot from `first` on whose first time passes the test `is_before`; `first - 1` if none does.

    `head`: the end of the slots, exclusive.
    """
    low, high = first, head
    while low < high:
        middle = (low + high) // 2
        if is_before(view.first_time(middle)):
            low = middle + 1
        else:
            high = middle
    return low - 1


def _candidates(
    view: RingView, facts: list[int], query: ReadQuery, within: ResolvedInterval, columns_of: ColumnsOf
) -> tuple[_Items, bool] | None:
    """Return items that may match, and whether no other item of the channel may match. None if the host must answer."""
    first, head = view.first_ordered(facts), facts[HEAD]
    start, end = within.start, within.end
    last = _last_slot(view, first, head, lambda time: time < end or (time == end and not within.end_exclusive))
    low = _last_slot(view, first, last + 1, lambda time: time < start)
    if low >= first and query.match is Match.SPAN:
        # The bucket at or before `start` may begin in this slot or in an earlier one. Take an earlier slot, too.
        earliest = view.first_time(low)
        low = _last_slot(view, first, low, lambda time: time < earliest)
    covers = low >= first
    if not covers:
        if query.limit is None or not query.newest_first:
            return None
        low = first
    if query.newest_first and query.limit is not None and last - low > query.limit + 1:
        low, covers = last - query.limit - 1, False  # each slot has an item or more
    if last < low or last - low >= SLOTS_MAX:
        return None
    slots = [view.slot(number) for number in range(low, last + 1)]
    if any(slot.items < 1 for slot in slots) or sum(slot.items for slot in slots) > ITEMS_MAX:
        return None
    items = _Items(view, slots, columns_of)
    if items.is_damaged or not view.is_whole(low) or not _ascend(items.times):
        return None
    return items, covers


def _ascend(times: Sequence[int]) -> bool:
    return all(one <= other for one, other in pairwise(times))


def _next_bucket_time(found: _Items, time: int, facts: list[int]) -> int | None:
    """Return the time of the next bucket after `time`; None if `time` is the newest."""
    at = bisect_right(found.times, time)
    if at < len(found.times):
        return found.times[at]
    following = found.slots[-1].number + 1
    return found.view.first_time(following) if following < facts[HEAD] else None


def _matching(found: _Items, match: Match, within: ResolvedInterval, now: int, facts: list[int]) -> list[int] | None:
    """Return the positions of the matching items, in order. `now`: the instant of the meta-time NOW."""
    times, start, end = found.times, within.start, within.end
    low = bisect_right(times, start) if within.start_exclusive else bisect_left(times, start)
    high = bisect_left(times, end) if within.end_exclusive else bisect_right(times, end)
    if match is Match.START:
        return [*range(low, high)]
    if match is Match.SPAN:
        return [*_reaching_in(found, within, now, facts), *range(bisect_right(times, start), high)]
    return _staying_in(found, within, now, low, high, facts)


def _reaching_in(found: _Items, within: ResolvedInterval, now: int, facts: list[int]) -> list[int]:
    """Return the items at or before the interval's start whose spans contain an instant of it."""
    times, start = found.times, within.start
    end = bisect_right(times, start)
    if not end:
        return []
    bucket = times[end - 1]
    positions = range(bisect_left(times, bucket), end)
    if bucket in within:
        return [*positions]
    is_newest = _next_bucket_time(found, bucket, facts) is None
    lasts = not is_newest or now > start or (now == start and not within.start_exclusive)  # without a duration
    own = found.durations
    return [at for at in positions if (bucket + own[at] > start if own[at] != ABSENT else lasts)]


def _staying_in(found: _Items, within: ResolvedInterval, now: int, low: int, high: int, facts: list[int]) -> list[int]:
    """Return the items whose whole spans are in the interval. Only items of the last bucket can end outside of it."""
    if low >= high:
        return []
    times, durations, bucket = found.times, found.durations, found.times[high - 1]
    following = _next_bucket_time(found, bucket, facts)
    bound = now if following is None else following
    positions = range(max(low, bisect_left(times, bucket)), high)

    def stays(at: int) -> bool:
        if durations[at] == ABSENT:
            return bound <= within.end
        own = bucket + durations[at]
        return (own if following is None else min(own, following)) <= within.end

    return [*range(low, positions.start), *(at for at in positions if stays(at))]
