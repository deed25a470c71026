"""The consumer places of a channel: which consumer has which place, and until when. Pure.

A channel with consumers has a stated number of places. A consumer takes a place with its first `consume`, and holds it
by a lease. A consumer whose lease has ended gets its former place again, unless another consumer has taken that place.
A new consumer gets the place whose lease ended first. If no lease has ended, it gets a place that was never taken.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from operator import attrgetter
from typing import Any, NamedTuple

from sortedcontainers import SortedKeyList

from stampede_rt.errors import ChannelFull, Overloaded
from stampede_rt.values.timeline import format_duration
from stampede_rt_channel_host.core.channel.seq_set import SeqSet
from stampede_rt_channel_host.core.deadlines import Deadlines

LEASE_NANOS = 10_000_000_000
"""The time that a `consume` keeps a place if it states no other lease."""

PLACES_OF_ONE_MAX = 768
"""The most places with a valid lease for one caller, of the 1024 that a channel may have."""
CONSUMER_BYTES = 700
CONSUMED_RANGE_BYTES = 130
"""The memory of a place, and of a range of consumed seqs, as measured."""


class ConsumerPlace(NamedTuple):
    """A place as a value, which moves with its channel. Its times are durations, because two hosts' clocks differ.

    `consumer_id` is 0 if the place was never taken. `lease_nanos` is the rest of the lease, or 0 if it has ended. The
    consumer has consumed all seqs below `consumed_below`, and the seqs in the ranges `consumed` (first seq and end,
    exclusive). The ranges may lack seqs of collected items. `caller_name`: the caller that took the place.
    """

    consumer_id: int
    lease_nanos: int
    consumed_below: int
    consumed: Sequence[tuple[int, int]]
    caller_name: str = ""


class ConsumerStanding(NamedTuple):
    """The state of a place. `lease_nanos` is the rest of the lease, or 0 if it has ended.

    `waiting` is the number of held items that the consumer has still to consume. It is 0 if the lease has ended.
    """

    consumer_id: int
    lease_nanos: int
    waiting: int


class Place:
    """A place that a consumer has taken. Its lease ends at `lease_end`.

    `done` has the seqs that the consumer has consumed, and collected seqs next to them. It is None after the lease has
    ended. All seqs lower than `below` are in `done`; the table sorts the places with a valid lease by `below`.
    `joined_to` is the seq at which `Consumers._join_collected` continues. `ranges` is the last counted number of ranges
    of `done`. `order` decides between places that are otherwise equal. `due` belongs to `Deadlines`. `caller_name`
    names the caller that took the place; empty if it is not known.
    """

    __slots__ = ("below", "caller_name", "consumer_id", "done", "due", "joined_to", "lease_end", "order", "ranges")

    def __init__(self, consumer_id: int, order: int, done: SeqSet | None, lease_end: int = 0) -> None:
        self.caller_name = ""
        self.consumer_id = consumer_id
        self.order = order
        self.done = done
        self.below = 1
        self.joined_to = 0
        self.ranges = 0
        self.lease_end = lease_end
        self.due: int | None = None


class PlaceTable:
    """The places of one channel. `clock` is the host's clock, which never goes back. Call `expire` before other
    methods.

    `arrivals` counts how often a consumer has taken a place. A consumer that has just taken a place may have more to
    consume than the others.
    """

    def __init__(self, places: int) -> None:
        self.arrivals = 0
        self._places = places
        self._taken: dict[int, Place] = {}  # by consumer id
        self._live: Any = SortedKeyList(key=attrgetter("below", "order"))  # the places with a valid lease
        self._ended: Any = SortedKeyList(key=attrgetter("lease_end", "order"))  # the places whose lease has ended
        self._leases: Deadlines[Place] = Deadlines()
        self._orders = 0  # the last `order` given to a place
        self._ranges = 0  # the number of ranges of consumed seqs, of all places together
        self._bytes_of: Counter[str] = (
            Counter()
        )  # the memory of places by `Place.caller_name`; without places that have none

    @property
    def footprint_bytes(self) -> int:
        """The memory of the taken places, and of the ranges that their consumers have consumed."""
        return CONSUMER_BYTES * len(self._taken) + CONSUMED_RANGE_BYTES * self._ranges

    def footprint_bytes_of(self, caller_name: str) -> int:
        """The bytes of the places of one caller."""
        return self._bytes_of[caller_name]

    @property
    def untaken(self) -> int:
        """The number of places that were never taken."""
        return self._places - len(self._taken)

    @property
    def live(self) -> int:
        """The number of places with a valid lease."""
        return len(self._live)

    @property
    def next_lease_end(self) -> int | None:
        """The time of the next lease end, or None if no place has a valid lease."""
        return self._leases.next()

    def find(self, consumer_id: int) -> Place | None:
        """The place of a consumer, or None if the consumer has none. The lease of the place may have ended."""
        return self._taken.get(consumer_id)

    def holds(self, consumer_id: int) -> bool:
        """Whether the consumer has a place with a valid lease."""
        own = self._taken.get(consumer_id)
        return own is not None and own.done is not None

    def in_order(self) -> list[Place]:
        """The taken places: first the places with an ended lease, then the places with a valid lease.

        In each group the place with the earliest lease end comes first.
        """
        return sorted(self._taken.values(), key=lambda place: (place.done is not None, place.lease_end))

    def live_up_to(self, seq: int) -> list[Place]:
        """The places with a valid lease whose `below` is at most `seq`, in the order of `below`."""
        return list(self._live.irange_key(max_key=(seq, self._orders)))

    def first_live_above(self, seq: int) -> Place | None:
        """The place with the lowest `below` above `seq`, of the places with a valid lease; None if there is none."""
        return next(self._live.irange_key(min_key=(seq + 1, 0)), None)

    def expire(self, clock: int) -> None:
        """End the leases whose time is over."""
        while (end := self._leases.next()) is not None and end <= clock:
            place = self._leases.pop(clock)
            if place is not None:  # None: there were too many changed deadlines for one call
                self._end(place)

    def take(self, consumer_id: int, done_below: int, restart_seq: int) -> tuple[Place, SeqSet]:
        """The consumer's place, and the seqs that are done there. If the consumer has no place, it takes one now.

        The consumer of a place that was never taken is done with all seqs below `done_below`. The consumer of a place
        whose lease has ended is also done with all seqs below `restart_seq`. Raises ChannelFull if all places are
        taken.
        """
        own = self._taken.get(consumer_id)
        if own is not None and own.done is not None:
            return own, own.done
        if own is None and not self._ended and not self.untaken:
            raise ChannelFull(
                f"the channel counts {self._places} consumers and all places are taken; a place becomes free when the "
                f"lease of a stopped consumer ends, by default after {format_duration(LEASE_NANOS)}: try again, or "
                "raise consumers (configure)",
                metadata={"consumers": str(self._places)},
            )
        done = SeqSet(done_below)
        former = own or (self._ended[0] if self._ended else None)  # the place whose lease ended first
        if former is not None:
            self.drop(former)
            done.add(1, restart_seq)
        return self._enter(consumer_id, done), done

    def check_share(self, caller_name: str) -> None:
        """Raises Overloaded if the caller `caller_name` has PLACES_OF_ONE_MAX places with a valid lease."""
        if len(self._live) < PLACES_OF_ONE_MAX:
            return
        held = sum(place.caller_name == caller_name for place in self._live)
        if held >= PLACES_OF_ONE_MAX:
            raise Overloaded(
                f"{caller_name} has {held} of the channel's {self._places} consumer places, and {PLACES_OF_ONE_MAX} is "
                "the most for one caller; give some up with a lease of 0, or use fewer consumers",
                metadata={"subject": caller_name, "used": str(held), "limit": str(PLACES_OF_ONE_MAX)},
            )

    def renew(self, place: Place, lease_end: int) -> None:
        """Let the valid lease of a place end at `lease_end`."""
        place.lease_end = lease_end
        self._leases.set_due(place, lease_end)

    def set_caller_name(self, place: Place, caller_name: str) -> None:
        """Set the name of the caller that has the place; empty if it is not known.

        The memory of the place counts for this caller.
        """
        if place.caller_name != caller_name:
            place_bytes = CONSUMER_BYTES + CONSUMED_RANGE_BYTES * place.ranges
            self._add_bytes(place.caller_name, -place_bytes)
            self._add_bytes(caller_name, place_bytes)
            place.caller_name = caller_name

    def _add_bytes(self, caller_name: str, more_bytes: int) -> None:
        """Add `more_bytes`, which may be below 0, to the memory of the places of a caller."""
        if caller_name:
            self._bytes_of[caller_name] += more_bytes
            if not self._bytes_of[caller_name]:
                del self._bytes_of[caller_name]

    def give_up(self, place: Place, clock: int) -> None:
        """End the valid lease of a place now."""
        place.lease_end = clock
        self._leases.disarm(place)
        self._end(place)

    def sort_again(self, place: Place, done: SeqSet) -> None:
        """Sort a place with a valid lease anew, after `done` has got more seqs."""
        self.count_ranges(place)
        if done.below != place.below:
            self._live.remove(place)
            place.below = done.below
            self._live.add(place)

    def count_ranges(self, place: Place) -> None:
        """Count the ranges of the place anew."""
        ranges = 0 if place.done is None else place.done.range_count
        self._ranges += ranges - place.ranges
        self._add_bytes(place.caller_name, CONSUMED_RANGE_BYTES * (ranges - place.ranges))
        place.ranges = ranges

    def enter_ended(self, consumer_id: int, lease_end: int) -> None:
        """Add a place whose lease ended at `lease_end`."""
        self._enter(consumer_id, None, lease_end)

    def enter_live(self, consumer_id: int, done: SeqSet, lease_end: int) -> Place:
        """Add a place whose lease ends at `lease_end`. The consumer has consumed the seqs in `done`."""
        place = self._enter(consumer_id, done)
        self.renew(place, lease_end)
        return place

    def _enter(self, consumer_id: int, done: SeqSet | None, lease_end: int = 0) -> Place:
        """Add a place of a consumer. If `done` is None, the lease of the place has ended at `lease_end`."""
        self._orders += 1
        place = self._taken[consumer_id] = Place(consumer_id, self._orders, done, lease_end)
        if done is None:
            self._ended.add(place)
        else:
            place.below = done.below
            self._live.add(place)
            self.arrivals += 1
        self.count_ranges(place)
        return place

    def drop(self, place: Place) -> None:
        """Remove a taken place."""
        (self._ended if place.done is None else self._live).remove(place)
        self._leases.disarm(place)
        place.done = None
        self.count_ranges(place)
        self.set_caller_name(place, "")
        del self._taken[place.consumer_id]

    def _end(self, place: Place) -> None:
        """Move a place to the places whose lease has ended. `lease_end` is the end of the lease."""
        self._live.remove(place)
        place.done = None
        self.count_ranges(place)
        self._ended.add(place)

    def resize(self, places: int) -> None:
        """Set another number of places, and remove the surplus places."""
        self._places = places
        self.trim()

    def trim(self) -> None:
        """Remove surplus places: first places with an ended lease, then the places with the earliest lease ends."""
        for place in self.in_order()[: max(0, len(self._taken) - self._places)]:
            self.drop(place)
