"""Which held items an interval selects (paper, section 3.2). Pure.

In the order (time, seq) the items that match are a stretch, of which only one bucket needs a look at each item: with
`span` the last bucket at or before the lower bound, which may reach in; with `whole` the last bucket in the interval,
which may reach out. So a read costs two searches and what it returns.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import NamedTuple, Protocol

from stampede_rt.timeline import Match, ResolvedInterval
from stampede_rt_channel_host.core.channel.index import SEQ_END, Place
from stampede_rt_channel_host.core.channel.run import ABSENT, Slice
from stampede_rt_channel_host.core.channel.values import Position, Query

Fits = Callable[[int], bool]


class Readable(Protocol):
    """Held items as reads see them: all of a channel's, or the part of them that a group shows."""

    @property
    def newest(self) -> int | None:
        """The latest time of an item in it; None if it holds none."""

    @property
    def oldest(self) -> int | None:
        """The earliest time."""

    @property
    def frontier(self) -> int | None:
        """As in `Holdings`."""

    @property
    def collected_by(self) -> str:
        """As in `Holdings`."""

    def slices(self, low: Place = ..., high: Place = ..., /) -> Iterator[Slice]:
        """Items at or above `low` and below `high`, ascending."""

    def slices_down(self, low: Place = ..., high: Place = ..., /) -> Iterator[Slice]:
        """The same, the last slice first."""

    def next_time(self, time: int, /) -> int | None:
        """The time of the next later bucket than `time`."""

    def floor_time(self, time: int, /) -> int | None:
        """The time of the bucket at or before `time`."""


class _Stretch(NamedTuple):
    """Items at or above `low` and below `high`; with `fits`, those of them whose duration it takes."""

    low: Place
    high: Place
    fits: Fits | None = None


def select(held: Readable, query: Query, within: ResolvedInterval, now: int) -> tuple[list[Slice], bool]:
    """The slices that match, ascending, and whether the limit cut more of them off. `now` is the resolved meta-time."""
    if within.is_empty or held.oldest is None:
        return [], False
    stretches = [_clip(stretch, query) for stretch in _stretches(held, query.match, within, now)]
    if query.newest_first:
        found = (part for stretch in reversed(stretches) for part in _parts_down(held, stretch))
    else:
        found = (part for stretch in stretches for part in _parts(held, stretch))
    slices, more = _take(found, query.limit, query.newest_first)
    if query.newest_first:
        slices.reverse()
    return slices, more


def _stretches(held: Readable, match: Match, within: ResolvedInterval, now: int) -> list[_Stretch]:
    low = (within.start, SEQ_END if within.start_exclusive else 0)
    high = (within.end, 0 if within.end_exclusive else SEQ_END)
    if match is Match.START:
        return [_Stretch(low, high)]
    if match is Match.SPAN:
        return [*_reaching_in(held, within, now), _Stretch((within.start, SEQ_END), high)]
    return _staying_in(held, within, low, now)


def _reaching_in(held: Readable, within: ResolvedInterval, now: int) -> list[_Stretch]:
    """The last bucket at or before the lower bound, as far as its spans hold an instant of the interval."""
    bucket = held.floor_time(within.start)
    if bucket is None:
        return []
    if bucket in within:
        return [_Stretch((bucket, 0), (bucket, SEQ_END))]
    following = held.next_time(bucket)

    def fits(duration: int) -> bool:
        if duration != ABSENT:
            return bucket + duration > within.start
        if following is not None:
            return True
        return now > within.start or (now == within.start and not within.start_exclusive)

    return [_Stretch((bucket, 0), (bucket, SEQ_END), fits)]


def _staying_in(held: Readable, within: ResolvedInterval, low: Place, now: int) -> list[_Stretch]:
    """The buckets in the interval; the spans of all but the last end within it."""
    bucket = held.floor_time(within.end - 1 if within.end_exclusive else within.end)
    if bucket is None or bucket not in within:
        return []
    following = held.next_time(bucket)
    bound = now if following is None else following

    def fits(duration: int) -> bool:
        if duration == ABSENT:
            return bound <= within.end
        end = bucket + duration
        return (end if following is None else min(end, following)) <= within.end

    return [_Stretch(low, (bucket, 0)), _Stretch((bucket, 0), (bucket, SEQ_END), fits)]


def _clip(stretch: _Stretch, query: Query) -> _Stretch:
    low, high, fits = stretch
    if query.newer_than is not None:
        low = max(low, behind(query.newer_than))
    if query.after is not None and not query.newest_first:
        low = max(low, behind(query.after))
    if query.after is not None and query.newest_first:
        high = min(high, (query.after.time, query.after.seq or 0))
    return _Stretch(low, high, fits)


def behind(position: Position) -> Place:
    """The first place later than a position."""
    return position.time, SEQ_END if position.seq is None else position.seq + 1


def _parts(held: Readable, stretch: _Stretch) -> Iterator[Slice]:
    for part in held.slices(stretch.low, stretch.high):
        if stretch.fits is None:
            yield part
        else:
            yield from _fitting(part, stretch.fits)


def _parts_down(held: Readable, stretch: _Stretch) -> Iterator[Slice]:
    for part in held.slices_down(stretch.low, stretch.high):
        if stretch.fits is None:
            yield part
        else:
            yield from reversed(list(_fitting(part, stretch.fits)))


def _fitting(part: Slice, fits: Fits) -> Iterator[Slice]:
    """The longest slices of `part` whose durations all fit."""
    durations = part.run.durations
    if durations is None:
        if fits(ABSENT):
            yield part
        return
    lo = part.lo
    for at in range(part.lo, part.hi):
        if not fits(durations[at]):
            if lo < at:
                yield Slice(part.run, lo, at)
            lo = at + 1
    if lo < part.hi:
        yield Slice(part.run, lo, part.hi)


def _take(found: Iterator[Slice], limit: int | None, newest_first: bool) -> tuple[list[Slice], bool]:
    if limit is None:
        return list(found), False
    taken: list[Slice] = []
    for part in found:
        if not limit:
            return taken, True
        if part.items > limit:
            lo, hi = (part.hi - limit, part.hi) if newest_first else (part.lo, part.lo + limit)
            taken.append(Slice(part.run, lo, hi))
            return taken, True
        taken.append(part)
        limit -= part.items
    return taken, False
