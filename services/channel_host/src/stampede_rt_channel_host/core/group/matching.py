"""For each item of one channel the nearest of every other: what pairs two cameras (paper, section 3.3). Pure.

Matching looks at all items, hidden ones too: it waits for what it needs by itself, and the cut says nothing about it.
"""

from __future__ import annotations

from bisect import bisect_left, insort
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import NamedTuple, Protocol

from stampede_rt.timeline import clamp
from stampede_rt_channel_host.core.channel import Channel, DeliveredSlice, Position, Slice
from stampede_rt_channel_host.core.channel.index import FIRST_PLACE, SEQ_END, Place
from stampede_rt_channel_host.core.channel.selection import behind
from stampede_rt_channel_host.core.group.ledger import Ledger

TRACK_ITEMS_MAX = 65_536


class Nearest(NamedTuple):
    """An item of another member. `item` None: it is at another host."""

    time: int
    seq: int
    item: DeliveredSlice | None


class Track(Protocol):
    """Another member, as a match needs it."""

    def nearest(self, time: int, tolerance: int, now: int) -> Nearest | None:
        """The nearest item at most `tolerance` away; of equally near ones the earlier, in a bucket the lower seq."""

    def forget_before(self, time: int) -> None:
        """Earlier items are not asked for any more."""


@dataclass(frozen=True, kw_only=True, slots=True)
class Matched:
    """One item, and what goes with it. `missing`: members that have nothing within the tolerance."""

    item: DeliveredSlice
    matched: Mapping[bytes, Nearest]
    missing: tuple[bytes, ...]


class OwnTrack:
    """A member at this host."""

    def __init__(self, channel: Channel) -> None:
        self._channel = channel

    def nearest(self, time: int, tolerance: int, now: int) -> Nearest | None:
        """See `Track`."""
        held, _ = self._channel.look(now)
        earlier = held.floor_time(time)
        later = held.next_time(time) if earlier is not None else held.oldest
        found = _nearer(time, earlier, later, tolerance)
        part = None if found is None else next(held.slices((found, 0), (found, SEQ_END)), None)
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

    def nearest(self, time: int, tolerance: int, now: int) -> Nearest | None:
        """See `Track`."""
        places = self._places
        above = bisect_left(places, (time + 1, -1))
        earlier = places[above - 1][0] if above else None
        later = places[above][0] if above < len(places) else None
        found = _nearer(time, earlier, later, tolerance)
        return None if found is None else Nearest(*places[bisect_left(places, (found, -1))], None)

    def forget_before(self, time: int) -> None:
        """See `Track`."""
        del self._places[: bisect_left(self._places, (time, -1))]


def _nearer(time: int, earlier: int | None, later: int | None, tolerance: int) -> int | None:
    near = [one for one in (earlier, later) if one is not None and abs(one - time) <= tolerance]
    return min(near, key=lambda one: (abs(one - time), one), default=None)


class Matcher:
    """Matches one channel's items in time order. It keeps a place and no items: what waits, waits in the channel.

    `unmatched`: items for which some member had nothing. `dropped`: items that went before they could be matched, or
    came after their place had been settled; as of the last `take`.
    """

    def __init__(
        self, channel: Channel, tracks: Mapping[bytes, Track], tolerance_nanos: int, now: int,
        after: Position | None = None, next_seq: int | None = None,
    ) -> None:  # fmt: skip
        """From the items accepted from now on, or behind `after`, with what has `next_seq` or a later one in mind.

        Are they of another incarnation, then all that this one had came since.
        """
        held, _ = channel.look(now)
        self._channel = channel
        self._tracks = dict(tracks)
        self._tolerance = tolerance_nanos
        self._place = behind(after) if after is not None else _end(held.newest, channel.next_seq)
        known = channel.next_seq if next_seq is None else min(next_seq, channel.next_seq)
        if next_seq is not None and after is not None and after.incarnation not in (0, channel.incarnation):
            known = 1
        self._ledger = Ledger(held, self._place, known)
        self.unmatched = 0
        self.dropped = 0

    @property
    def place(self) -> Position:
        """Everything up to it is settled: begun `after` this, another goes on."""
        time, end_seq = self._place
        return Position(clamp(time), end_seq - 1 if end_seq else None, self._channel.incarnation)

    @property
    def next_seq(self) -> int:
        """Of the items with a lower seq those below `place` are settled; it goes with that."""
        return self._ledger.next_seq

    @property
    def earliest(self) -> int:
        """No earlier time of another member is asked for any more."""
        return clamp(self._place[0] - self._tolerance)

    def set_tracks(self, tracks: Mapping[bytes, Track]) -> None:
        """Members came, went, or moved to another host."""
        self._tracks = dict(tracks)

    def take(self, has_passed: Callable[[bytes, int], bool], now: int, items_max: int) -> list[Matched]:
        """What is settled and not taken yet, `items_max` at the most.

        `has_passed(member, instant)`: nothing that comes in order can be nearer than what is there up to `instant`; see
        `ChannelTimes.has_passed`. A member that is not to be waited for has passed everything.
        """
        held, _ = self._channel.look(now)
        taken: list[Matched] = []
        for one in _ones(held.slices(self._place)):
            time = one.first_time
            if len(taken) >= items_max or not self._is_settled(time, has_passed):
                break
            taken.append(self._match(DeliveredSlice(one, held.next_time(time)), time, now))
            self._place = time, one.end_seq
        self.dropped += self._ledger.settle(
            held, self._place, self._channel.next_seq, given_above=len(taken), given_below=0
        )
        for track in self._tracks.values():
            track.forget_before(self._place[0] - self._tolerance)
        return taken

    def _is_settled(self, time: int, has_passed: Callable[[bytes, int], bool]) -> bool:
        return all(has_passed(channel_id, time + self._tolerance) for channel_id in self._tracks)

    def _match(self, item: DeliveredSlice, time: int, now: int) -> Matched:
        found = {member: track.nearest(time, self._tolerance, now) for member, track in self._tracks.items()}
        matched = {member: near for member, near in found.items() if near is not None}
        missing = tuple(sorted(found.keys() - matched.keys()))
        self.unmatched += bool(missing)
        return Matched(item=item, matched=matched, missing=missing)


def _end(newest: int | None, next_seq: int) -> Place:
    return FIRST_PLACE if newest is None else (newest, next_seq)


def _ones(parts: Iterable[Slice]) -> Iterable[Slice]:
    return (Slice(part.run, at, at + 1) for part in parts for at in range(part.lo, part.hi))
