"""The consumers of a channel, and the items that each has consumed (paper, section 3.4: a reference count). Pure.

A channel with consumers has a stated number of places. A consumer takes a place with its first `consume`. Each further
`consume` renews the place's lease. While the lease is valid, the place keeps in the channel the items that its consumer
has not consumed. The other cases:

- A place that was never taken keeps every item. Its first consumer has still to consume all held items.
- A place whose lease has ended keeps no item until a consumer takes it again. That consumer has still to consume the
  newest item and all items accepted later.
- A consumer whose lease has ended gets its former place again, unless another consumer has taken it. A new consumer
  gets the place whose lease ended first. If no lease has ended, it gets a place that was never taken.

Each place records the ranges of seqs that its consumer has consumed. When the consumer consumes, the place extends
these ranges by adjacent seqs of collected items. All other held items are still to be consumed. A put or a consume
looks at few places, however many there are: the places are sorted by the seq below which their consumers have consumed
all items. Once a place is found that keeps the oldest item, no other place needs a look.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

from sortedcontainers import SortedKeyList

from stampede_rt.errors import ChannelFull, InvalidArgument, Overloaded
from stampede_rt.values.timeline import format_duration
from stampede_rt_channel_host.core.channel import pieces
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.run import Slice
from stampede_rt_channel_host.core.channel.seq_set import BLOCK_SEQS, CountedSeqs, SeqSet
from stampede_rt_channel_host.core.deadlines import Deadlines

LEASE_NANOS = 10_000_000_000
"""How long a `consume` keeps a place if it states no other lease."""

LEASE_NANOS_MAX = 3_600_000_000_000
PLACES_OF_ONE_MAX = 768
"""The most places with a valid lease for one caller, of the 1024 that a channel may have."""
SEQS_MAX = 4096
"""The most seqs that one `consume` may name."""
RANGES_PER_LOOK_MAX = 256
"""The most ranges of consumed or collected seqs that one call joins to a consumer's unbroken sequence."""
SEQS_PER_LOOK_MAX = 64 * BLOCK_SEQS
"""The most seqs that one call notes as collected."""
CONSUMER_BYTES = 700
CONSUMED_RANGE_BYTES = 130
"""The memory of a place, and of a range of consumed seqs, as measured."""
RANGE_STEPS = 4
"""The count of the collected items in one range of consumed seqs takes as long as the work on this number of slices."""


class Consumed(NamedTuple):
    """The number of items that the consumer had not consumed before, and the lease of its place from now on."""

    items: int
    lease_nanos: int


class ConsumerPlace(NamedTuple):
    """A place as a value, which moves with its channel. Its times are durations, because two hosts' clocks differ.

    `consumer_id` 0: never taken. `lease_nanos` 0: the lease has ended. The consumer has consumed all seqs below
    `consumed_below`, and the seqs in the ranges `consumed` (first and end, the end excluded). Collected items need not
    be in the ranges.
    """

    consumer_id: int
    lease_nanos: int
    consumed_below: int
    consumed: Sequence[tuple[int, int]]


class ConsumerStanding(NamedTuple):
    """The state of a place. `lease_nanos` 0: the lease has ended. `waiting`: held items still to be consumed there."""

    consumer_id: int
    lease_nanos: int
    waiting: int


class _Place:
    """A place that was taken. Its lease ends at `until`.

    `done`: the seqs that its consumer has consumed, and collected seqs next to them; None once the lease has ended.
    `below`: all lower seqs are in `done`. Places with a valid lease are sorted by `below`. `tidied`: the seq at which
    `Consumers._tidy` continues. `ranges`: how many ranges of `done` were last counted. `order` decides between places
    that are otherwise equal. `due` belongs to `Deadlines`. `owner`: the caller that took it; empty: not known.
    """

    __slots__ = ("below", "consumer_id", "done", "due", "order", "owner", "ranges", "tidied", "until")

    def __init__(self, consumer_id: int, order: int, done: SeqSet | None) -> None:
        self.owner = ""
        self.consumer_id = consumer_id
        self.order = order
        self.done = done
        self.below = 1
        self.tidied = 0
        self.ranges = 0
        self.until = 0
        self.due: int | None = None


class Consumers:
    """The places of one channel. `clock` is the host's clock, which never goes back. Call `expire` before other
    methods.

    The channel calls `let_go` for every seq that it has given out and no longer holds. Before that call such a seq
    counts as not consumed. `looked_at` counts looks at a place. `arrivals` counts how often a consumer took a place
    with a valid lease. Such a consumer may have more to consume than the others.
    """

    def __init__(self, places: int) -> None:
        self.looked_at = self.arrivals = 0
        self._places = places
        self._gone = CountedSeqs()  # the collected seqs
        self._taken: dict[int, _Place] = {}  # by consumer id
        self._live: Any = SortedKeyList(key=attrgetter("below", "order"))  # the places with a valid lease
        self._ended: Any = SortedKeyList(key=attrgetter("until", "order"))  # the places whose lease has ended
        self._leases: Deadlines[_Place] = Deadlines()
        self._holder: _Place | None = None  # the place last found to keep the oldest item
        self._orders = 0  # the last `order` given to a place
        self._ranges = 0  # of all places together

    @property
    def footprint_bytes(self) -> int:
        """The memory of the places that were taken, and of what their consumers have consumed."""
        return CONSUMER_BYTES * len(self._taken) + CONSUMED_RANGE_BYTES * self._ranges

    def wanted_bytes(self, consumer_id: int, seqs: Iterable[int]) -> int:
        """The most memory that the consumption of `seqs` adds.

        Seqs next to consumed or collected ones add none, so that a consumer which consumes in order needs none.
        """
        own = self._taken.get(consumer_id)
        done = SeqSet() if own is None or own.done is None else own.done
        below = max(done.below, self._gone.below)
        wanted = CONSUMER_BYTES if own is None and self.untaken else 0
        for first, end in _ranges(seqs):
            if first > below and not any(next(known.touching(first, end), None) for known in (done, self._gone)):
                wanted += CONSUMED_RANGE_BYTES
        return wanted

    def _count(self, place: _Place) -> None:
        """Count the ranges of the place anew."""
        ranges = 0 if place.done is None else place.done.range_count
        self._ranges += ranges - place.ranges
        place.ranges = ranges

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
        """The time of the next lease end; None: no place has a lease."""
        return self._leases.next()

    def expire(self, clock: int) -> None:
        """End the leases whose time is over."""
        while (place := self._leases.pop(clock)) is not None:
            self._end(place)

    def consume(
        self,
        consumer_id: int,
        seqs: Sequence[int],
        *,
        next_seq: int,
        newest_seq: int | None,
        clock: int,
        lease: int,
        owner: str = "",
    ) -> Consumed:
        """Note that a consumer has consumed `seqs`, and renew its place for `lease` nanoseconds; 0 gives the place up.

        `next_seq` is the seq of the next accepted item. `newest_seq` is the newest item's seq, None without items. Call
        `check_consumption` first: it refuses invalid arguments. `owner`: the name of the caller; empty if its places
        have no limit. Raises ChannelFull if all places are taken, Overloaded if the caller has PLACES_OF_ONE_MAX.
        """
        if not lease and not seqs and not self._holds_place(consumer_id):
            return Consumed(0, 0)
        if owner and not self._holds_place(consumer_id):
            self._check_share(owner)
        place, done = self._take(consumer_id, next_seq if newest_seq is None else newest_seq)
        place.owner = owner
        items, ranges = 0, _ranges(seqs)
        for first, end in ranges:
            for low, high in self._gone.touching(first, end):
                done.add(max(low, first), min(high, end))
            items += done.add(first, end)
        self._tidy(place, done, len(ranges) + 16)
        self._count(place)
        place.until = clock + lease
        if lease:
            self._leases.arm(place, place.until)
            self._rank(place, done)
        else:
            self._leases.disarm(place)
            self._end(place)
        return Consumed(items, lease)

    def _holds_place(self, consumer_id: int) -> bool:
        own = self._taken.get(consumer_id)
        return own is not None and own.done is not None

    def _check_share(self, owner: str) -> None:
        if len(self._live) < PLACES_OF_ONE_MAX:
            return
        held = sum(place.owner == owner for place in self._live)
        if held >= PLACES_OF_ONE_MAX:
            raise Overloaded(
                f"{owner} has {held} of the channel's {self._places} consumer places, and {PLACES_OF_ONE_MAX} is the "
                "most for one caller; give some up with a lease of 0, or use fewer consumers",
                metadata={"subject": owner, "used": str(held), "limit": str(PLACES_OF_ONE_MAX)},
            )

    def _take(self, consumer_id: int, restart_seq: int) -> tuple[_Place, SeqSet]:
        """The consumer's place, which it takes now if it has none, and the seqs that are done there."""
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
        done = SeqSet(self._gone.below)
        former = own or (self._ended[0] if self._ended else None)  # the place whose lease ended first
        if former is not None:
            self._drop(former)
            done.add(1, restart_seq)
        return self._enter(consumer_id, done), done

    def _enter(self, consumer_id: int, done: SeqSet | None) -> _Place:
        self._orders += 1
        place = self._taken[consumer_id] = _Place(consumer_id, self._orders, done)
        if done is None:
            self._ended.add(place)
        else:
            place.below = done.below
            self._live.add(place)
            self.arrivals += 1
        self._count(place)
        return place

    def _drop(self, place: _Place) -> None:
        (self._ended if place.done is None else self._live).remove(place)
        self._leases.disarm(place)
        place.done = None
        self._count(place)
        del self._taken[place.consumer_id]

    def _end(self, place: _Place) -> None:
        self._live.remove(place)
        place.done = None
        self._count(place)
        self._ended.add(place)

    def _rank(self, place: _Place, done: SeqSet) -> None:
        """Sort the place anew by the seq below which each item is consumed here or collected.

        If very many ranges lie below that seq, the place moves only a part of the way.
        """
        left = RANGES_PER_LOOK_MAX
        while left > 0 and (end := self._gone.end_of(done.below)) > done.below:
            left -= 1 + _go_on(done, done.below, end, left)
        self._count(place)
        if done.below != place.below:
            self._live.remove(place)
            place.below = done.below
            self._live.add(place)

    def _tidy(self, place: _Place, done: SeqSet, ranges: int) -> None:
        """Add collected seqs to at most `ranges` of the place's ranges.

        So a place never has many more ranges than there are held items.
        """
        while ranges > 0:
            found = done.first_range(place.tidied)
            if found is None:
                place.tidied = 0
                return
            end = self._gone.end_of(found[1])
            place.tidied = found[1] if end == found[1] else found[0]
            ranges -= 1 + _go_on(done, found[1], end, ranges)

    def let_go(self, first: int, end: int) -> None:
        """Note collected seqs: no consumer has to consume them any more."""
        self._gone.add(first, end)

    def let_go_some(self, first: int, end: int, ranges_max: int) -> int:
        """As `let_go`, for a bounded part of these seqs, from `first` on. Returns the end of that part, exclusive."""
        end = min(self._gone.until(first, end, ranges_max), first + SEQS_PER_LOOK_MAX)
        self._gone.add(first, end)
        return end

    def resize(self, places: int) -> None:
        """Set another number of places. Removes surplus places, those with the earliest lease ends first."""
        self._places = places
        for place in sorted(self._taken.values(), key=_worth)[: max(0, len(self._taken) - places)]:
            self._drop(place)

    def done_with(self, part: Slice) -> int:
        """How many items at the beginning of `part` every consumer with a valid lease has consumed."""
        first, end = part.first_seq, part.end_seq
        if self._holder is not None and self._end_of(self._holder, first) == first:
            return 0
        for place in list(self._live.irange_key(max_key=(first, self._orders))):
            assert place.done is not None, "it is live"
            self.looked_at += 1
            self._rank(place, place.done)
            if place.below <= first:
                end = min(end, place.done.end_of(first))
            if end == first:
                self._holder = place
                return 0
        beyond = next(self._live.irange_key(min_key=(first + 1, 0)), None)
        return (end if beyond is None else min(end, beyond.below)) - first

    def _end_of(self, place: _Place, seq: int) -> int | None:
        """The first seq at or above `seq` that the place has not consumed; None: its lease has ended."""
        self.looked_at += 1
        return None if place.done is None else place.done.end_of(seq)

    def places(self, clock: int, next_seq: int) -> list[ConsumerPlace]:
        """Every taken place as a value, in the order of `standings`. Takes one step for each range of consumed seqs."""
        shown = []
        for place in sorted(self._taken.values(), key=_worth):
            done = SeqSet() if place.done is None else place.done
            for known in self._gone.touching(1, next_seq) if place.done is not None else ():
                done.add(*known)
            lease = 0 if place.done is None else place.until - clock
            shown.append(ConsumerPlace(place.consumer_id, lease, done.below, done.ranges))
        return shown

    def standings(self, clock: int, next_seq: int) -> Pieces[list[ConsumerStanding]]:
        """The state of every taken place. Places with an ended lease come first, in the order of their ends.

        Works in pieces, because the count takes long if consumers have consumed many items out of order.
        """
        shown, steps = [], 0
        for place in sorted(self._taken.values(), key=_worth):
            if place.done is None:
                shown.append(ConsumerStanding(place.consumer_id, 0, 0))
                continue
            lease, steps = place.until - clock, steps + next_seq // BLOCK_SEQS // pieces.ITEMS_PER_STEP + 1
            waiting = next_seq - place.done.below - self._gone.count(place.done.below, next_seq)
            seq = place.done.below
            while place.done is not None and (found := place.done.first_range(seq)) is not None:
                waiting -= found[1] - found[0] - self._gone.count(*found)
                seq, steps = found[1], steps + RANGE_STEPS
                if steps >= pieces.STEPS_PER_PIECE:
                    steps = 0
                    yield
            shown.append(ConsumerStanding(place.consumer_id, lease, max(0, waiting)))
            if steps >= pieces.STEPS_PER_PIECE:
                steps = 0
                yield
        return shown

    def restore(self, places: Iterable[ConsumerPlace], clock: int) -> None:
        """Replace all places by `places`, which another host's `places` method returned.

        A place with consumer id 0 stays untaken.
        """
        for former in list(self._taken.values()):
            self._drop(former)
        for one in places:
            if not one.consumer_id:
                continue
            done = SeqSet(one.consumed_below, one.consumed) if one.lease_nanos > 0 else None
            place = self._enter(one.consumer_id, done)
            if done is None:
                self._ended.remove(place)
                place.until = clock - 1
                self._ended.add(place)
            else:
                place.until = clock + one.lease_nanos
                self._leases.arm(place, place.until)
                self._rank(place, done)
        self.resize(self._places)


def _go_on(done: SeqSet, first: int, end: int, ranges_max: int) -> int:
    """Add seqs from `first` on, up to `end` at most, until about `ranges_max` ranges are joined.

    Returns the number of joined ranges.
    """
    before = done.range_count
    done.add(first, done.until(first, end, ranges_max))
    return max(0, before - done.range_count)


def _worth(place: _Place) -> tuple[bool, int]:
    """The sort key of places: ended leases first, then valid ones, in each group the earliest lease end first."""
    return place.done is not None, place.until


def check_consumption(consumer_id: int, seqs: Sequence[int], next_seq: int, lease: int) -> None:
    """Raises InvalidArgument for arguments that are invalid for any place. All seqs below `next_seq` were given out."""
    if not consumer_id:
        raise InvalidArgument("consumer_id is 0; choose a random number above 0, and keep it")
    if not 0 <= lease <= LEASE_NANOS_MAX:
        raise InvalidArgument(f"lease_nanos is {lease}; it is between 0, which gives the place up, and 1 h")
    if len(seqs) > SEQS_MAX:
        raise InvalidArgument(f"the request consumes {len(seqs)} seqs; the limit is {SEQS_MAX}: send several requests")
    if seqs and not (min(seqs) >= 1 and max(seqs) < next_seq):
        raise InvalidArgument(
            f"seqs from {min(seqs)} to {max(seqs)} cannot be consumed: the channel's next seq is {next_seq}; name seqs "
            "of items that you have read"
        )


def _ranges(seqs: Iterable[int]) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    for seq in sorted(seqs):
        if found and seq <= found[-1][1]:
            found[-1] = (found[-1][0], max(found[-1][1], seq + 1))
        else:
            found.append((seq, seq + 1))
    return found
