"""Counts the items that each open subscription did not get, because its reader was too slow."""

from __future__ import annotations

import itertools
from collections import Counter
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from heapq import nlargest

from stampede_rt_runtime.access.control import shown_name

UNNAMED = "@anyone"


@dataclass(eq=False, slots=True)
class ReaderDrops:
    """One open subscription to the channel or group `source`.

    `subscriber`: its caller, and a number that only this subscription has.

    `collected`: items that retention collected before the reader took them. `skipped`: items that a reader of the
    newest item did not take, because a newer one came. `of_group`: the source is a group.
    """

    source: str
    subscriber: str
    collected: int = 0
    skipped: int = 0
    of_group: bool = False

    @property
    def total(self) -> int:
        """All items that the reader did not get."""
        return self.collected + self.skipped


class Readers:
    """The open subscriptions of a host, which the limits of its port bound, and the sums of those that have ended."""

    def __init__(self) -> None:
        self._open: dict[ReaderDrops, None] = {}
        self._ended = ReaderDrops("", "")
        self._numbers = itertools.count(1)

    def __len__(self) -> int:
        return len(self._open)

    @contextmanager
    def reading(self, source: str, *, of_group: bool = False) -> Iterator[ReaderDrops]:
        """The counts of one subscription of the present call's caller, for the duration of the block."""
        subscriber = f"{shown_name() or UNNAMED}#{next(self._numbers)}"
        drops = ReaderDrops(source, subscriber, of_group=of_group)
        self._open[drops] = None
        try:
            yield drops
        finally:
            del self._open[drops]
            self._ended.collected += drops.collected
            self._ended.skipped += drops.skipped

    def sums(self) -> tuple[int, int]:
        """All collected and all skipped items so far."""
        counts = [self._ended, *self._open]
        return sum(one.collected for one in counts), sum(one.skipped for one in counts)

    def worst(self, count: int) -> Iterable[ReaderDrops]:
        """The open subscriptions that missed the most items, at most `count`. Leaves out those that missed none."""
        return nlargest(count, (one for one in self._open if one.total), key=lambda one: one.total)

    def of_channel(self, name: str, count: int) -> Iterable[ReaderDrops]:
        """The open subscriptions to one channel, at most `count`. Those that missed the most items come first."""
        found = (one for one in self._open if one.source == name and not one.of_group)
        return nlargest(count, found, key=lambda one: one.total)

    def dropped_by_channel(self) -> Mapping[str, int]:
        """The items that the open subscriptions of each channel missed; only channels with missed items."""
        sums: Counter[str] = Counter()
        for one in self._open:
            if one.total and not one.of_group:
                sums[one.source] += one.total
        return sums
