"""The consumers of a channel, and the items that each has consumed (paper, section 3.4: a reference count with a known
number of consumers). Pure.

A channel with consumers has that many places. A consumer takes one with its first `consume`, keeps it by a lease that
each further one renews, and loses it when the lease ends. It holds back what it has not consumed:

- a place never taken holds back every item; its first taker owes everything that is held;
- a place whose lease has ended holds back nothing until it is taken again, and that taker owes the newest item and
  whatever is accepted later;
- a consumer finds its own place again; a new one gets the place that ended the longest ago, so that places which nobody
  took yet go on holding for those who are still to come, and otherwise one of these.

Kept for each place: the seqs that it has consumed; what is gone anyway is taken in when it consumes what adjoins that.
What is in neither is held and owed. However many consumers there are, a put or a consume looks at few of them: they
stand in the order of how far they have consumed everything, and one that holds the oldest item back answers for all.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from operator import attrgetter
from typing import Any, NamedTuple

from sortedcontainers import SortedKeyList

from stampede_rt.errors import ChannelFull, InvalidArgument
from stampede_rt.values.timeline import format_duration
from stampede_rt_channel_host.core.channel import pieces
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.run import Slice
from stampede_rt_channel_host.core.channel.seq_set import BLOCK_SEQS, CountedSeqs, SeqSet
from stampede_rt_channel_host.core.deadlines import Deadlines

LEASE_NANOS = 10_000_000_000
"""How long a place is kept after a `consume` that states nothing else."""

LEASE_NANOS_MAX = 3_600_000_000_000
SEQS_MAX = 4096
RANGES_PER_LOOK_MAX = 256
"""So many ranges of seqs one call goes on behind what a consumer has consumed."""
SEQS_PER_LOOK_MAX = 64 * BLOCK_SEQS
RANGE_STEPS = 4
"""To count what has gone within a range of consumed seqs takes as long as so many slices."""


class Consumed(NamedTuple):
    """How many items the consumer had not consumed before, and how long its place is kept from now on."""

    items: int
    lease_nanos: int


class ConsumerPlace(NamedTuple):
    """A place as a value; it moves with its channel. Times are durations, since two hosts' clocks differ.

    `consumer_id` 0: never taken. `lease_nanos` 0: the lease has ended. Consumed is everything below `consumed_below`
    and the `consumed` ranges (first and end, the end excluded); what is gone need not be in them.
    """

    consumer_id: int
    lease_nanos: int
    consumed_below: int
    consumed: Sequence[tuple[int, int]]


class ConsumerStanding(NamedTuple):
    """How a place stands. `lease_nanos` 0: the lease has ended. `waiting`: held items that it has not consumed."""

    consumer_id: int
    lease_nanos: int
    waiting: int


class _Place:
    """A place that was taken; `done` is None once its lease has ended, at `until`.

    `below`: every seq below it is done, as far as was looked; up to `tidied` its ranges were looked at in this round.
    `order` tells those apart that are otherwise alike; `due`
    belongs to `Deadlines`.
    """

    __slots__ = ("below", "consumer_id", "done", "due", "order", "tidied", "until")

    def __init__(self, consumer_id: int, order: int, done: SeqSet | None) -> None:
        self.consumer_id = consumer_id
        self.order = order
        self.done = done
        self.below = 1
        self.tidied = 0
        self.until = 0
        self.due: int | None = None


class Consumers:
    """The places of one channel. `clock` is the host's clock, which never goes back; `expire` is called before others.

    They hear from `let_go` of every seq that was given out and is not held; until they have heard of it, it counts as
    owed. `looked_at` counts looks at a place, and `arrivals` how often a consumer came that may owe what others do not.
    """

    def __init__(self, places: int) -> None:
        self.looked_at = self.arrivals = 0
        self._places = places
        self._gone = CountedSeqs()
        self._taken: dict[int, _Place] = {}
        self._live: Any = SortedKeyList(key=attrgetter("below", "order"))
        self._ended: Any = SortedKeyList(key=attrgetter("until", "order"))
        self._leases: Deadlines[_Place] = Deadlines()
        self._holder: _Place | None = None  # who was last found to hold the oldest item back
        self._orders = 0

    @property
    def untaken(self) -> int:
        """How many places were never taken."""
        return self._places - len(self._taken)

    @property
    def live(self) -> int:
        """How many places have a consumer whose lease holds."""
        return len(self._live)

    @property
    def next_lease_end(self) -> int | None:
        """When the next lease ends; None: nobody has one."""
        return self._leases.next()

    def expire(self, clock: int) -> None:
        """End the leases that are over."""
        while (place := self._leases.pop(clock)) is not None:
            self._end(place)

    def consume(
        self, consumer_id: int, seqs: Sequence[int], *, next_seq: int, newest_seq: int | None, clock: int, lease: int
    ) -> Consumed:
        """Note that a consumer has consumed `seqs`, and keep its place for `lease` more; 0 gives the place up.

        `newest_seq` is the newest item's. What makes no sense is for `check_consumption` to find before. Raises
        ChannelFull if all places are taken.
        """
        if not lease and not seqs and not self._holds_place(consumer_id):
            return Consumed(0, 0)
        place, done = self._take(consumer_id, next_seq if newest_seq is None else newest_seq)
        items, ranges = 0, _ranges(seqs)
        for first, end in ranges:
            for low, high in self._gone.touching(first, end):
                done.add(max(low, first), min(high, end))
            items += done.add(first, end)
        self._tidy(place, done, len(ranges) + 16)
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

    def _take(self, consumer_id: int, restart_seq: int) -> tuple[_Place, SeqSet]:
        """The consumer's own place, or one that it takes now, and what it has done there."""
        own = self._taken.get(consumer_id)
        if own is not None and own.done is not None:
            return own, own.done
        if own is None and not self._ended and not self.untaken:
            raise ChannelFull(
                f"the channel counts {self._places} consumers and all places are taken; the next one is free in "
                f"{format_duration(LEASE_NANOS)} at the latest after one of them stops, or raise consumers (configure)",
                metadata={"consumers": str(self._places)},
            )
        done = SeqSet(self._gone.below)
        former = own or (self._ended[0] if self._ended else None)  # the one that ended the longest ago
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
        return place

    def _drop(self, place: _Place) -> None:
        (self._ended if place.done is None else self._live).remove(place)
        self._leases.disarm(place)
        place.done = None
        del self._taken[place.consumer_id]

    def _end(self, place: _Place) -> None:
        self._live.remove(place)
        place.done = None
        self._ended.add(place)

    def _rank(self, place: _Place, done: SeqSet) -> None:
        """It has done more: it stands where that says, or, where it would go on for long, a part of the way there."""
        left = RANGES_PER_LOOK_MAX
        while left > 0 and (end := self._gone.end_of(done.below)) > done.below:
            left -= 1 + _go_on(done, done.below, end, left)
        if done.below != place.below:
            self._live.remove(place)
            place.below = done.below
            self._live.add(place)

    def _tidy(self, place: _Place, done: SeqSet, ranges: int) -> None:
        """Take in what has gone behind so many of its ranges: they never are many more than items are held."""
        while ranges > 0:
            found = done.first_range(place.tidied)
            if found is None:
                place.tidied = 0
                return
            end = self._gone.end_of(found[1])
            place.tidied = found[1] if end == found[1] else found[0]
            ranges -= 1 + _go_on(done, found[1], end, ranges)

    def let_go(self, first: int, end: int) -> None:
        """Items were collected, whatever for: nobody owes them any more."""
        self._gone.add(first, end)

    def let_go_some(self, first: int, end: int, ranges_max: int) -> int:
        """The same of a stretch of which much may be known to be gone: a bounded part. How far it came."""
        end = min(self._gone.until(first, end, ranges_max), first + SEQS_PER_LOOK_MAX)
        self._gone.add(first, end)
        return end

    def resize(self, places: int) -> None:
        """Another number of places. Of too many taken ones go first those that ended, then the soonest to end."""
        self._places = places
        for place in sorted(self._taken.values(), key=_worth)[: max(0, len(self._taken) - places)]:
            self._drop(place)

    def done_with(self, part: Slice) -> int:
        """How many of the first items of `part` every live consumer has consumed."""
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
        """The first seq at or above `seq` that it has not consumed; None: its lease has ended."""
        self.looked_at += 1
        return None if place.done is None else place.done.end_of(seq)

    def places(self, clock: int, next_seq: int) -> list[ConsumerPlace]:
        """Every place that was taken, as a value, in the order of `standings`. Takes as long as there are ranges."""
        shown = []
        for place in sorted(self._taken.values(), key=_worth):
            done = SeqSet() if place.done is None else place.done
            for known in self._gone.touching(1, next_seq) if place.done is not None else ():
                done.add(*known)
            lease = 0 if place.done is None else place.until - clock
            shown.append(ConsumerPlace(place.consumer_id, lease, done.below, done.ranges))
        return shown

    def standings(self, clock: int, next_seq: int) -> Pieces[list[ConsumerStanding]]:
        """Every place that was taken; first those whose leases have ended, the longest ago first.

        In pieces: where consumers have consumed much out of order, others count while the channel goes on.
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
        """Take over places that `places` told, instead of those that are there. Those of id 0 stay untaken."""
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
    """Put in seqs from `first` on, up to `end` at most: so many that about `ranges_max` ranges become one. How many."""
    before = done.range_count
    done.add(first, done.until(first, end, ranges_max))
    return max(0, before - done.range_count)


def _worth(place: _Place) -> tuple[bool, int]:
    """The least worth of places is the one that ended the longest ago."""
    return place.done is not None, place.until


def check_consumption(consumer_id: int, seqs: Sequence[int], next_seq: int, lease: int) -> None:
    """Raises InvalidArgument for what makes no sense, whoever has a place; `next_seq`: all below it were given out."""
    if not consumer_id:
        raise InvalidArgument("consumer_id is 0; choose a random number above 0, and keep it")
    if not 0 <= lease <= LEASE_NANOS_MAX:
        raise InvalidArgument(f"lease_nanos is {lease}; it is between 0, which gives the place up, and 1 h")
    if len(seqs) > SEQS_MAX:
        raise InvalidArgument(f"the request consumes {len(seqs)} seqs; the limit is {SEQS_MAX}: send several requests")
    if seqs and not (min(seqs) >= 1 and max(seqs) < next_seq):
        raise InvalidArgument(
            f"seqs from {min(seqs)} to {max(seqs)} cannot be consumed: the channel has given 1 to {next_seq - 1}"
        )


def _ranges(seqs: Iterable[int]) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    for seq in sorted(seqs):
        if found and seq <= found[-1][1]:
            found[-1] = (found[-1][0], max(found[-1][1], seq + 1))
        else:
            found.append((seq, seq + 1))
    return found
