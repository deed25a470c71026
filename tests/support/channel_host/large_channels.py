"""Large channels, and a count of the slices that their index visits."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import pytest

from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT, parse_interval
from stampede_rt_channel_host.core.channel import ChannelCore, Query, Slice, index, index_entries
from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from tests.support.channel_host.channel_cores import CLOCK, a_channel, put

ITEMS = 20_000


class SliceCounter:
    """Counts the slices that any index has visited."""

    def __init__(self) -> None:
        self.slices = 0


def count_slices(monkeypatch: pytest.MonkeyPatch) -> SliceCounter:
    """A counter for the rest of the test."""
    counter, clipped = SliceCounter(), index_entries.clipped
    slices_from = index.ChannelIndex.slices_from

    def counting(*args: Any) -> Iterator[Slice]:
        counter.slices += 1
        yield from clipped(*args)

    def counting_from(self: index.ChannelIndex, floor: ItemKey) -> Iterator[Slice]:
        for part in slices_from(self, floor):
            counter.slices += 1
            yield part

    monkeypatch.setattr(index, "clipped", counting)
    monkeypatch.setattr(index.ChannelIndex, "slices_from", counting_from)
    return counter


def filled(items: int = ITEMS, **policy: Any) -> ChannelCore:
    """A channel with one run for each item, in the order of their times."""
    channel = a_channel(**policy)
    for time in range(items):
        put(channel, CLOCK + time)
    return channel


def shuffled(items: int = ITEMS) -> ChannelCore:
    """A channel with pairs of runs of 200 items. The items of a pair alternate in time, as from two producers."""
    channel = a_channel()
    for first in range(0, items, 400):
        for odd in (0, 1):
            put(channel, *(CLOCK + first + at for at in range(odd, 400, 2)))
    return channel


def backwards(items: int, **policy: Any) -> ChannelCore:
    """A channel in which each item is earlier than the one before it, so that items leave out of the order of seqs."""
    channel = a_channel(max_age_nanos=10**12, **policy)
    for time in range(items):
        put(channel, CLOCK - time)
    return channel


def everything(**fields: Any) -> Query:
    return Query(interval=parse_interval(MIN_INSTANT, MAX_INSTANT), **fields)
