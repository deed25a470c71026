"""How many items a reader in time order will never get, though they were meant for it. Pure.

A reader has dealt with all items below some place that were given a seq before some moment. It is owed the others:
those held at or above the place, and whatever is accepted later. What of these is neither given nor held is lost.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator

from stampede_rt_channel_host.core.channel import Slice
from stampede_rt_channel_host.core.channel.holdings import CONSUMPTION, Holdings
from stampede_rt_channel_host.core.channel.index import Place


class Ledger:
    """Of one reader of one channel. Costs what was put and given since the last settling; a walk over what is owed only
    if an item came in below what consumption had taken.

    `lowest_seq`: whatever is lost at the next settling has this seq or a later one.
    """

    __slots__ = ("_consumed", "_floor", "_held_from", "_low", "_owed", "lowest_seq", "next_seq")

    def __init__(self, held: Holdings, low: Place, next_seq: int) -> None:
        """Owed: held items at or above `low`, and all with `next_seq` or a later one."""
        self._low = low
        self._owed, self.lowest_seq = _owed(held, low, next_seq)
        self._held_from = self.lowest_seq  # what is owed and held has this seq or a later one
        self._remember(held, low, next_seq)

    def settle(self, held: Holdings, low: Place, next_seq: int, *, given_above: int, given_below: int) -> int:
        """The reader has dealt with everything below `low` that has a seq below `next_seq`: how many items it lost.

        `given_above`, `given_below`: of the items it was given, how many were at or above the former `low`, and below.
        """
        owed = self._owed + next_seq - self.next_seq
        intact = held.floor <= max(self._low, self._floor) and held.collected[CONSUMPTION] == self._consumed
        if intact:
            above = sum(part.items for part in above_place(held, self._low, self.next_seq, next_seq))
            left = self._owed + above - given_above
        elif held.floor >= low:  # all that is held is owed, but for what came since the step began
            left = held.items - sum(part.items for part in held.slices_by_seq(next_seq, held.next_seq))
        else:
            left, self.lowest_seq = _owed(held, low, next_seq)
        self._owed = left
        self._remember(held, low, next_seq)
        return owed - given_above - given_below - left

    def lowest_owed(self, held: Holdings) -> int:
        """The lowest seq that is still owed. Walks what was given since the last call."""
        parts = above_place(held, self._low, self._held_from, self.next_seq)
        self._held_from = next((part.first_seq for part in parts), self.next_seq)
        return self._held_from

    def _remember(self, held: Holdings, low: Place, next_seq: int) -> None:
        self._low, self.next_seq = low, next_seq
        self._floor: Place = held.floor
        self._consumed: int = held.collected[CONSUMPTION]


def _owed(held: Holdings, low: Place, next_seq: int) -> tuple[int, int]:
    """How many held items at or above the place have a seq below `next_seq`, and the lowest seq that is owed."""
    parts = [part for part in held.slices(low) if part.first_seq < next_seq]
    items = sum(min(part.end_seq, next_seq) - part.first_seq for part in parts)
    return items, min((part.first_seq for part in parts), default=next_seq)


def newest_gone(held: Holdings) -> int | None:
    """The latest time of an item that the channel had and has not any more."""
    return max((time for time in (held.newest_collected, held.newest_consumed) if time is not None), default=None)


def above_place(held: Holdings, low: Place, first_seq: int, end_seq: int) -> Iterator[Slice]:
    """Held items with seqs from `first_seq` up to, not including, `end_seq`, at or above a place, in seq order."""
    parts = (split_at(part, low)[1] for part in held.slices_by_seq(first_seq, end_seq))
    return (part for part in parts if part.items)


def below_place(held: Holdings, low: Place, first_seq: int, end_seq: int) -> list[Slice]:
    """Those below the place, ascending by (time, seq)."""
    parts = (split_at(part, low)[0] for part in held.slices_by_seq(first_seq, end_seq))
    return sorted((part for part in parts if part.items), key=lambda part: (part.first_time, part.first_seq))


def split_at(part: Slice, place: Place) -> tuple[Slice, Slice]:
    """A slice, which ascends in (time, seq), below a place and from it on."""
    time, seq = place
    run, lo, hi = part
    at = bisect_left(run.times, time, lo, hi)
    while at < hi and run.times[at] == time and run.first_seq + at < seq:
        at += 1
    return Slice(run, lo, at), Slice(run, at, hi)
