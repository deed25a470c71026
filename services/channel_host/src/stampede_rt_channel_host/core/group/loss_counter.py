"""Counts the items that a reader in time order will never get, although they belong to its subscription. Pure.

The position of a reader is a key and a seq. The reader is done with each item that has a lower key and a lower seq. All
other items are owed. An owed item is lost if the reader has not got it and the channel does not hold it any more.
"""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterator
from itertools import islice

from stampede_rt_channel_host.core.channel import Slice
from stampede_rt_channel_host.core.channel.held_items import CONSUMPTION
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.item_keys import ItemKey

LOOKED_AT_MAX = 4096
"""A search for the lowest owed seq looks at this number of items or slices at most."""


class LossCounter:
    """Counts the owed and the lost items of one reader of one channel.

    Most calls look only at the items that came, or that the reader got, after the last call. The items that
    the next `mark_read` counts as lost have no seq below `lowest_seq`.
    """

    __slots__ = ("_consumed", "_floor", "_held_from", "_low", "_owed", "lowest_seq", "next_seq")

    def __init__(self, held: Holdings, low: ItemKey, next_seq: int) -> None:
        """At first the owed items are the held items at or above `low`, and all items with `next_seq` or a later
        seq.
        """
        self._low = low
        # `_owed`: the number of held items at or above `_low` with a seq below `next_seq`
        self._owed, self.lowest_seq = _owed(held, low, next_seq)
        self._held_from = self.lowest_seq  # the search for the lowest owed seq continues here
        self._remember(held, low, next_seq)

    def mark_read(
        self, held: Holdings, low: ItemKey, next_seq: int, *, given_above: int, given_below: int,
        came_above: int | None = None,
    ) -> int:  # fmt: skip
        """Note that the reader is done with all items below `low` with a seq below `next_seq`.

        Returns the number of lost items. Of the items that the reader got after the last call, `given_above` lay at or
        above the former `low`, and `given_below` below it. `came_above` items came at or above the former `low` after
        the last call. If `came_above` is None, this call counts them.
        """
        owed = self._owed + next_seq - self.next_seq
        intact = held.floor <= max(self._low, self._floor) and held.collected[CONSUMPTION] == self._consumed
        if intact:
            if came_above is None:
                came_above = _items(above_key(held, self._low, self.next_seq, next_seq))
            left = self._owed + came_above - given_above
        elif held.floor >= low:  # all held items lie above `low`; items from `next_seq` on are not counted in `_owed`
            left = held.items - _items(held.slices_by_seq(next_seq, held.next_seq))
        else:
            left, self.lowest_seq = _owed(held, low, next_seq)
        self._owed = left
        self._remember(held, low, next_seq)
        return owed - given_above - given_below - left

    def lowest_owed(self, held: Holdings) -> int:
        """The lowest owed seq, or a lower seq if the search stops after LOOKED_AT_MAX slices.

        The next call continues a search that has stopped.
        """
        looked = [*islice(held.slices_by_seq(self._held_from, self.next_seq), LOOKED_AT_MAX)]
        parts = (split_at(part, self._low)[1] for part in looked)
        beyond = looked[-1].end_seq if len(looked) == LOOKED_AT_MAX else self.next_seq
        self._held_from = next((part.first_seq for part in parts if part.items), beyond)
        return self._held_from

    def _remember(self, held: Holdings, low: ItemKey, next_seq: int) -> None:
        """Note the state of the reader and of the channel as of this call."""
        self._low, self.next_seq = low, next_seq
        self._floor: ItemKey = held.floor
        self._consumed: int = held.collected[CONSUMPTION]


def _owed(held: Holdings, low: ItemKey, next_seq: int) -> tuple[int, int]:
    """The number of held items at or above `low` with a seq below `next_seq`, and the lowest seq of these items.

    If there are more than LOOKED_AT_MAX such items, the second number may be too low.
    """
    items = held.items - held.items_below(low) - _items(above_key(held, low, next_seq, held.next_seq))
    if items > LOOKED_AT_MAX:
        return items, held.seq_from(1, next_seq, LOOKED_AT_MAX)
    owed = (part.first_seq for part in held.slices(low) if part.first_seq < next_seq)
    return items, min(owed, default=next_seq)


def _items(parts: Iterator[Slice]) -> int:
    return sum(part.items for part in parts)


def newest_gone(held: Holdings) -> int | None:
    """The latest time of an item that the channel has collected, or None if it has collected no item."""
    return max((time for time in (held.newest_collected, held.newest_consumed) if time is not None), default=None)


def above_key(held: Holdings, low: ItemKey, first_seq: int, end_seq: int) -> Iterator[Slice]:
    """Held items at or above the key `low` with seqs from `first_seq` up to `end_seq`, exclusive, in seq order."""
    parts = (split_at(part, low)[1] for part in held.slices_by_seq(first_seq, end_seq))
    return (part for part in parts if part.items)


def split_at(part: Slice, key: ItemKey) -> tuple[Slice, Slice]:
    """The part of a slice below a key, and the part from the key on. The slice ascends in (time, seq)."""
    time, seq = key
    run, lo, hi = part
    at = bisect_left(run.times, time, lo, hi)
    while at < hi and run.times[at] == time and run.first_seq + at < seq:
        at += 1
    return Slice(run, lo, at), Slice(run, at, hi)
