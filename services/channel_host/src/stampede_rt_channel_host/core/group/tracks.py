"""Tracks: the items of one member of a group, for a search of the item nearest to an instant. Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple, Protocol

from stampede_rt.matching.key_track import KeyTrack, nearer
from stampede_rt_channel_host.core.channel import ChannelCore, DeliveredSlice, Slice
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, LAST_KEY, SEQ_END, ItemKey

TRACK_ITEMS_MAX = 65_536
"""The most item keys that a `RemoteTrack` holds."""


class NearestItem(NamedTuple):
    """The time and seq of a found item. `item` is None if the item is at another host, or in this host's archive."""

    time: int
    seq: int
    item: DeliveredSlice | None
    is_archived: bool = False


class Track(Protocol):
    """The items of one member, among which a match searches the nearest one."""

    def nearest(
        self, time: int, tolerance: int, now: int, low: ItemKey = FIRST_KEY, high: ItemKey = LAST_KEY
    ) -> NearestItem | None:
        """The item nearest to `time`, at most `tolerance` nanoseconds away; None if there is no such item.

        Of two equally near items returns the earlier one, and within a bucket the one with the lower seq. Only items at
        or above `low` and below `high` count.
        """

    def forget_before(self, time: int) -> None:
        """Forget the items before `time`, because no match needs them any more."""


class LocalTrack:
    """The track of a member at this host. Searches the channel itself."""

    def __init__(self, channel: ChannelCore) -> None:
        self._channel = channel

    def nearest(
        self, time: int, tolerance: int, now: int, low: ItemKey = FIRST_KEY, high: ItemKey = LAST_KEY
    ) -> NearestItem | None:
        """See `Track`."""
        held, _ = self._channel.look(now)
        middle = time, SEQ_END
        below = next(held.slices_down(low, min(high, middle)), None)
        above = next(held.slices(max(low, middle), high), None)
        found = nearer(time, below and below.last_time, above and above.first_time, tolerance)
        part = None if found is None else next(held.slices(max(low, (found, 0)), high), None)
        if found is None or part is None:
            return None
        one = Slice(part.run, part.lo, part.lo + 1)
        return NearestItem(found, one.first_seq, DeliveredSlice(one, held.next_time(found)))

    def forget_before(self, time: int) -> None:
        """Does nothing, because retention collects the items."""

    def one_by_one(self, low: ItemKey, now: int) -> Iterator[DeliveredSlice]:
        """The items from `low` on, one by one."""
        held, _ = self._channel.look(now)
        return one_by_one(held.slices(low), held.next_time)


class RemoteTrack:
    """The track of a member at another host. This host knows only the keys of the member's items.

    Holds at most TRACK_ITEMS_MAX keys. If there are more, the track drops the earliest keys. Items that would have
    matched these keys then count as unmatched.
    """

    def __init__(self) -> None:
        self._keys = KeyTrack()

    def __len__(self) -> int:
        return len(self._keys)

    def add(self, keys: Iterable[ItemKey]) -> None:
        """Add the keys of some items of the member."""
        self._keys.add(keys)
        self._keys.keep_last(TRACK_ITEMS_MAX)

    def nearest(
        self, time: int, tolerance: int, now: int, low: ItemKey = FIRST_KEY, high: ItemKey = LAST_KEY
    ) -> NearestItem | None:
        """See `Track`."""
        found = self._keys.nearest(time, tolerance, now, low, high)
        return None if found is None else NearestItem(*found, None)

    def forget_before(self, time: int) -> None:
        """See `Track`."""
        self._keys.forget_before(time)


def one_by_one(parts: Iterable[Slice], next_time: Callable[[int], int | None]) -> Iterator[DeliveredSlice]:
    """The items of the slices, one by one. `next_time` gives the time of the bucket after a time."""
    each = (Slice(part.run, at, at + 1) for part in parts for at in range(part.lo, part.hi))
    return (DeliveredSlice(one, next_time(one.first_time)) for one in each)
