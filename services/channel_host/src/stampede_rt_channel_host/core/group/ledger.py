"""Counts the items that a reader in time order will never get, although they belong to its subscription. Pure.

A reader is done with all items below some key that got a seq before some moment. It has still to get the others: the
held items at or above the key, and all items accepted later. Items among these that are neither given nor held are
lost.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from itertools import islice

from stampede_rt_channel_host.core.channel import Slice
from stampede_rt_channel_host.core.channel.held_items import CONSUMPTION
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.index import ItemKey

LOOKED_AT_MAX = 4096
"""The most items or slices at which a search for the lowest seq still to give looks."""


class Ledger:
    """The ledger of one reader of one channel. Most calls look only at the items put and given since the last call.

    `lowest_seq`: all items that the next `mark_read` finds lost have this seq or a later one.
    """

    __slots__ = ("_consumed", "_floor", "_held_from", "_low", "_owed", "lowest_seq", "next_seq")

    def __init__(self, held: Holdings, low: ItemKey, next_seq: int) -> None:
        """Begin: still to give are the held items at or above `low`, and all items with `next_seq` or a later seq."""
        self._low = low
        # `_owed`: the number of held items that are still to give
        self._owed, self.lowest_seq = _owed(held, low, next_seq)
        self._held_from = self.lowest_seq  # all held items that are still to give have this seq or a later one
        self._remember(held, low, next_seq)

    def mark_read(
        self, held: Holdings, low: ItemKey, next_seq: int, *, given_above: int, given_below: int,
        came_above: int | None = None,
    ) -> int:  # fmt: skip
        """Note that the reader is done with all items below `low` with a seq below `next_seq`.

        Returns the number of lost items. `given_above` and `given_below` count the items given at or above the former
        `low`, and below it. `came_above` counts the items that came at or above it since the last call; None: count
        them here.
        """
        owed = self._owed + next_seq - self.next_seq
        intact = held.floor <= max(self._low, self._floor) and held.collected[CONSUMPTION] == self._consumed
        if intact:
            if came_above is None:
                came_above = _items(above_key(held, self._low, self.next_seq, next_seq))
            left = self._owed + came_above - given_above
        elif held.floor >= low:  # all held items are still to give, except those that came since the step began
            left = held.items - _items(held.slices_by_seq(next_seq, held.next_seq))
        else:
            left, self.lowest_seq = _owed(held, low, next_seq)
        self._owed = left
        self._remember(held, low, next_seq)
        return owed - given_above - given_below - left

    def lowest_owed(self, held: Holdings) -> int:
        """A seq below which no item is still to give.

        It is the lowest such seq, unless very many items lie between it and the last result.
        """
        looked = [*islice(held.slices_by_seq(self._held_from, self.next_seq), LOOKED_AT_MAX)]
        parts = (split_at(part, self._low)[1] for part in looked)
        beyond = looked[-1].end_seq if len(looked) == LOOKED_AT_MAX else self.next_seq
        self._held_from = next((part.first_seq for part in parts if part.items), beyond)
        return self._held_from

    def _remember(self, held: Holdings, low: ItemKey, next_seq: int) -> None:
        self._low, self.next_seq = low, next_seq
        self._floor: ItemKey = held.floor
        self._consumed: int = held.collected[CONSUMPTION]


def _owed(held: Holdings, low: ItemKey, next_seq: int) -> tuple[int, int]:
    """The number of held items at or above the key with a seq below `next_seq`, and a seq below which none is still to
    give.

    The second is exact unless there are very many items.
    """
    items = held.items - held.items_below(low) - _items(above_key(held, low, next_seq, held.next_seq))
    if items > LOOKED_AT_MAX:
        return items, held.seq_from(1, next_seq, LOOKED_AT_MAX)
    owed = (part.first_seq for part in held.slices(low) if part.first_seq < next_seq)
    return items, min(owed, default=next_seq)


def _items(parts: Iterator[Slice]) -> int:
    return sum(part.items for part in parts)


def newest_gone(held: Holdings) -> int | None:
    """The latest time of an item that the channel had and has no more."""
    return max((time for time in (held.newest_collected, held.newest_consumed) if time is not None), default=None)


def above_key(held: Holdings, low: ItemKey, first_seq: int, end_seq: int) -> Iterator[Slice]:
    """Held items with seqs from `first_seq` up to `end_seq`, exclusive, at or above a key, in seq order."""
    parts = (split_at(part, low)[1] for part in held.slices_by_seq(first_seq, end_seq))
    return (part for part in parts if part.items)


def split_at(part: Slice, key: ItemKey) -> tuple[Slice, Slice]:
    """The parts of a slice below a key and from the key on. The slice ascends in (time, seq)."""
    time, seq = key
    run, lo, hi = part
    at = bisect_left(run.times, time, lo, hi)
    while at < hi and run.times[at] == time and run.first_seq + at < seq:
        at += 1
    return Slice(run, lo, at), Slice(run, at, hi)
