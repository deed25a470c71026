"""A channel as a match looks at it: which item of it is the nearest to some instant. Pure."""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Iterable
from typing import NamedTuple, Protocol

from stampede_rt_channel_host.core.channel import ChannelCore, DeliveredSlice, Slice
from stampede_rt_channel_host.core.channel.index import FIRST_PLACE, LAST_PLACE, SEQ_END, Place

TRACK_ITEMS_MAX = 65_536


class Nearest(NamedTuple):
    """An item. `item` None: it is at another host."""

    time: int
    seq: int
    item: DeliveredSlice | None


class Track(Protocol):
    """A member, as a match needs it."""

    def nearest(
        self, time: int, tolerance: int, now: int, low: Place = FIRST_PLACE, high: Place = LAST_PLACE
    ) -> Nearest | None:
        """The nearest item at most `tolerance` away; of equally near ones the earlier, in a bucket the lower seq.

        Of those at or above `low` and below `high`.
        """

    def forget_before(self, time: int) -> None:
        """Earlier items are not asked for any more."""


class OwnTrack:
    """A member at this host."""

    def __init__(self, channel: ChannelCore) -> None:
        self._channel = channel

    def nearest(
        self, time: int, tolerance: int, now: int, low: Place = FIRST_PLACE, high: Place = LAST_PLACE
    ) -> Nearest | None:
        """See `Track`."""
        held, _ = self._channel.look(now)
        middle = time, SEQ_END
        below = next(held.slices_down(low, min(high, middle)), None)
        above = next(held.slices(max(low, middle), high), None)
        found = _nearer(time, below and below.last_time, above and above.first_time, tolerance)
        part = None if found is None else next(held.slices(max(low, (found, 0)), high), None)
        if found is None or part is None:
            return None
        one = Slice(part.run, part.lo, part.lo + 1)
        return Nearest(found, one.first_seq, DeliveredSlice(one, held.next_time(found)))

    def forget_before(self, time: int) -> None:
        """Retention does that."""


class FarTrack:
    """A member at another host, of which only places are told. Holds TRACK_ITEMS_MAX of them at the most: then the
    earliest go, and what would have matched them counts as unmatched."""

    def __init__(self) -> None:
        self._places: list[Place] = []

    def add(self, places: Iterable[Place]) -> None:
        """Items of the member, by time and seq."""
        for place in places:
            if not self._places or place > self._places[-1]:
                self._places.append(place)
            else:
                insort(self._places, place)
        if len(self._places) > TRACK_ITEMS_MAX:
            del self._places[:-TRACK_ITEMS_MAX]

    def nearest(
        self, time: int, tolerance: int, now: int, low: Place = FIRST_PLACE, high: Place = LAST_PLACE
    ) -> Nearest | None:
        """See `Track`."""
        places = self._places
        first, end = bisect_left(places, low), bisect_left(places, high)
        above = min(max(first, bisect_left(places, (time, SEQ_END))), end)
        earlier = places[above - 1][0] if above > first else None
        later = places[above][0] if above < end else None
        found = _nearer(time, earlier, later, tolerance)
        return None if found is None else Nearest(*places[bisect_left(places, max(low, (found, 0)))], None)

    def forget_before(self, time: int) -> None:
        """See `Track`."""
        del self._places[: bisect_left(self._places, (time, -1))]


def _nearer(time: int, earlier: int | None, later: int | None, tolerance: int) -> int | None:
    near = [one for one in (earlier, later) if one is not None and abs(one - time) <= tolerance]
    return min(near, key=lambda one: (abs(one - time), one), default=None)
