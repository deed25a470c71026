"""Counts the items that each open subscription did not get, because its reader was too slow."""

from __future__ import annotations

import itertools
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from heapq import nlargest

from stampede_rt_channel_host.core.channel import Pieces, batched
from stampede_rt_runtime.access.control import shown_name

UNNAMED = "@anyone"
READERS_PER_PIECE = 256


class SourceReaders:
    """The open subscriptions to one channel or group. `dropped`: the items that they missed together."""

    __slots__ = ("dropped", "readers")

    def __init__(self) -> None:
        self.dropped = 0
        self.readers: dict[ReaderDrops, None] = {}


class ReaderDrops:
    """One open subscription to the channel or group `source`.

    `subscriber`: its caller, and a number that only this subscription has.

    `collected`: items that retention collected before the reader took them. `skipped`: items that a reader of the
    newest item did not take, because a newer one came.
    """

    __slots__ = ("_among", "collected", "skipped", "source", "subscriber")

    def __init__(self, source: str, subscriber: str, among: SourceReaders | None = None) -> None:
        self.source, self.subscriber = source, subscriber
        self.collected = self.skipped = 0
        self._among = among or SourceReaders()

    def count(self, collected: int, skipped: int) -> None:
        """Set both counts."""
        self._among.dropped += collected + skipped - self.total
        self.collected, self.skipped = collected, skipped

    @property
    def total(self) -> int:
        """All items that the reader did not get."""
        return self.collected + self.skipped


class Readers:
    """The open subscriptions of a host, which the limits of its port bound, and the sums of the subscriptions that have
    ended.
    """

    def __init__(self) -> None:
        self._channels: dict[str, SourceReaders] = {}
        self._groups: dict[str, SourceReaders] = {}
        self._open: dict[ReaderDrops, None] = {}
        self._ended = ReaderDrops("", "")
        self._numbers = itertools.count(1)

    def __len__(self) -> int:
        return len(self._open)

    @contextmanager
    def reading(self, source: str, *, of_group: bool = False) -> Iterator[ReaderDrops]:
        """The counts of one subscription of the present call's caller, for the duration of the block."""
        sources = self._groups if of_group else self._channels
        among = sources.setdefault(source, SourceReaders())
        drops = ReaderDrops(source, f"{shown_name() or UNNAMED}#{next(self._numbers)}", among)
        self._open[drops] = among.readers[drops] = None
        try:
            yield drops
        finally:
            del self._open[drops], among.readers[drops]
            if not among.readers:
                del sources[source]
            among.dropped -= drops.total
            self._ended.count(self._ended.collected + drops.collected, self._ended.skipped + drops.skipped)

    def sums(self) -> tuple[int, int]:
        """All collected and all skipped items so far."""
        counts = [self._ended, *self._open]
        return sum(one.collected for one in counts), sum(one.skipped for one in counts)

    def worst(self, count: int) -> Iterable[ReaderDrops]:
        """The open subscriptions that missed the most items, at most `count`. Leaves out subscriptions that missed
        none.
        """
        return nlargest(count, (one for one in self._open if one.total), key=_total)

    def of_channel(self, name: str, count: int) -> Pieces[list[ReaderDrops]]:
        """The open subscriptions to one channel, at most `count`, in pieces. The subscriptions that missed the most
        come first.
        """
        among, largest_drops = self._channels.get(name), list[ReaderDrops]()
        for at, part in enumerate(batched([] if among is None else [*among.readers], READERS_PER_PIECE)):
            if at:
                yield
            largest_drops = nlargest(count, [*largest_drops, *part], key=_total)
        return largest_drops

    def dropped(self, name: str) -> int:
        """The items that the open subscriptions to one channel missed."""
        among = self._channels.get(name)
        return 0 if among is None else among.dropped


def _total(drops: ReaderDrops) -> int:
    return drops.total
