"""The items that each consumer of a channel has consumed (paper, section 3.4: a reference count). Pure.

Each `consume` renews the lease of the consumer's place (see `consumer_places`). While the lease is valid, the place
keeps in the channel the items that its consumer has not consumed. The other cases:

- A place that was never taken keeps every item. Its first consumer has still to consume all held items.
- A place whose lease has ended keeps no item until a consumer takes it again. That consumer has still to consume the
  newest item and all items accepted later.

Each place records the ranges of seqs that its consumer has consumed. When the consumer consumes, the place extends
these ranges by adjacent seqs of collected items. Held items outside the ranges are still to be consumed. A put or a
consume looks at few places, however many there are: the places are sorted by the seq below which their consumers have
consumed all items. When a call has found a place that keeps the oldest item, it looks at no other place.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from stampede_rt.errors import InvalidArgument
from stampede_rt_channel_host.core.channel import pieces
from stampede_rt_channel_host.core.channel.consumer_places import (
    CONSUMED_RANGE_BYTES,
    CONSUMER_BYTES,
    ConsumerPlace,
    ConsumerStanding,
    Place,
    PlaceTable,
)
from stampede_rt_channel_host.core.channel.oldest_items import CountOldest
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.run import Slice
from stampede_rt_channel_host.core.channel.seq_set import BLOCK_SEQS, CountedSeqs, SeqSet

LEASE_NANOS_MAX = 3_600_000_000_000
"""The longest lease that one `consume` may state."""
SEQS_MAX = 4096
"""The most seqs that one `consume` may name."""
RANGES_PER_LOOK_MAX = 256
"""The most ranges of consumed or collected seqs that one call joins to the seqs below `Place.below`."""
SEQS_PER_LOOK_MAX = 64 * BLOCK_SEQS
"""The most seqs that one call notes as collected."""
RANGE_STEPS = 4
"""The steps that `standings` adds for each range of consumed seqs: it must count the collected items in the range."""
CONSUMERS_CHECKED_MAX = 512
"""After this number of looks at single consumers, a call checks no further slice."""


class ConsumptionResult(NamedTuple):
    """The number of items that the consumer had not consumed before, and the lease of its place from now on."""

    items: int
    lease_nanos: int


class Consumers:
    """The consumers of one channel. `table` has their places. Call `table.expire` before other methods.

    The argument `clock` of the methods is the host's clock, which never goes back. The channel calls `note_collected`
    for every seq whose item it has collected. Before that call such a seq counts as not consumed. `looked_at` counts
    how often a method has examined one place. `changes` counts the calls that changed a place. The end of a lease does
    not count.
    """

    def __init__(self, places: int) -> None:
        self.looked_at = self.changes = 0
        self.table = PlaceTable(places)
        self._collected = CountedSeqs()
        self._holder: Place | None = None  # the place that kept the oldest item when a call last found such a place

    def wanted_bytes(self, consumer_id: int, seqs: Iterable[int]) -> int:
        """The most memory that the consumption of `seqs` adds.

        Seqs next to consumed or collected seqs add none. So a consumer that consumes in order needs no more memory.
        """
        own = self.table.find(consumer_id)
        done = SeqSet() if own is None or own.done is None else own.done
        below = max(done.below, self._collected.below)
        wanted = CONSUMER_BYTES if own is None and self.table.untaken else 0
        for first, end in _ranges(seqs):
            if first > below and not any(next(known.touching(first, end), None) for known in (done, self._collected)):
                wanted += CONSUMED_RANGE_BYTES
        return wanted

    def consume(
        self,
        consumer_id: int,
        seqs: Sequence[int],
        *,
        next_seq: int,
        newest_seq: int | None,
        clock: int,
        lease: int,
        caller_name: str = "",
    ) -> ConsumptionResult:
        """Note that a consumer has consumed `seqs`, and renew its place for `lease` nanoseconds.

        A lease of 0 gives the place up. `next_seq` is the seq of the next accepted item. `newest_seq` is the newest
        item's seq, or None if no item is held. Call `check_consumption` first: it refuses invalid arguments. If
        `caller_name` is empty, the number of the caller's places has no limit. Raises ChannelFull if all places are
        taken, and Overloaded if the caller has PLACES_OF_ONE_MAX places.
        """
        table = self.table
        if not lease and not seqs and not table.holds(consumer_id):
            return ConsumptionResult(0, 0)
        if caller_name and not table.holds(consumer_id):
            table.check_share(caller_name)
        restart_seq = next_seq if newest_seq is None else newest_seq
        place, done = table.take(consumer_id, self._collected.below, restart_seq)
        table.set_caller_name(place, caller_name)
        self.changes += 1
        items, ranges = 0, _ranges(seqs)
        for first, end in ranges:
            for low, high in self._collected.touching(first, end):
                done.add(max(low, first), min(high, end))
            items += done.add(first, end)
        self._join_collected(place, done, len(ranges) + 16)
        table.count_ranges(place)
        if lease:
            table.renew(place, clock + lease)
            self._move_up(place, done)
        else:
            table.give_up(place, clock)
        return ConsumptionResult(items, lease)

    def _move_up(self, place: Place, done: SeqSet) -> None:
        """Join collected seqs to the seqs below `done.below`, and sort the place anew.

        If very many ranges are to be joined, joins only a part of them.
        """
        left = RANGES_PER_LOOK_MAX
        while left > 0 and (end := self._collected.end_of(done.below)) > done.below:
            left -= 1 + _add_some(done, done.below, end, left)
        self.table.sort_again(place, done)

    def _join_collected(self, place: Place, done: SeqSet, ranges: int) -> None:
        """Join collected seqs to at most `ranges` of the place's ranges.

        So a place never has many more ranges than there are held items.
        """
        while ranges > 0:
            found = done.first_range(place.joined_to)
            if found is None:
                place.joined_to = 0
                return
            end = self._collected.end_of(found[1])
            place.joined_to = found[1] if end == found[1] else found[0]
            ranges -= 1 + _add_some(done, found[1], end, ranges)

    def note_collected(self, first: int, end: int) -> None:
        """Note the seqs of collected items, from `first` up to `end`, exclusive. No consumer has to consume them."""
        self._collected.add(first, end)

    def note_some_collected(self, first: int, end: int, ranges_max: int) -> int:
        """Note a bounded part of these seqs, from `first` on, like `note_collected`. Returns the end of the part."""
        end = min(self._collected.end_of_ranges(first, end, ranges_max), first + SEQS_PER_LOOK_MAX)
        self._collected.add(first, end)
        return end

    def done_with(self, part: Slice) -> int:
        """The number of items at the beginning of `part` that every consumer with a valid lease has consumed."""
        first, end = part.first_seq, part.end_seq
        if self._holder is not None and self._end_of(self._holder, first) == first:
            return 0
        for place in self.table.live_up_to(first):
            assert place.done is not None, "its lease is valid"
            self.looked_at += 1
            self._move_up(place, place.done)
            if place.below <= first:
                end = min(end, place.done.end_of(first))
            if end == first:
                self._holder = place
                return 0
        beyond = self.table.first_live_above(first)
        return (end if beyond is None else min(end, beyond.below)) - first

    def _end_of(self, place: Place, seq: int) -> int | None:
        """The first seq at or above `seq` that the place's consumer has not consumed. None if its lease has ended."""
        self.looked_at += 1
        return None if place.done is None else place.done.end_of(seq)

    def places(self, clock: int, next_seq: int) -> list[ConsumerPlace]:
        """Every taken place as a value, in the order of `standings`. Takes one step for each range of consumed seqs."""
        shown = []
        for place in self.table.in_order():
            done = SeqSet() if place.done is None else place.done
            for known in self._collected.touching(1, next_seq) if place.done is not None else ():
                done.add(*known)
            lease = 0 if place.done is None else place.lease_end - clock
            shown.append(ConsumerPlace(place.consumer_id, lease, done.below, done.ranges, place.caller_name))
        return shown

    def standings(self, clock: int, next_seq: int) -> Pieces[list[ConsumerStanding]]:
        """The state of every taken place, in the order of `PlaceTable.in_order`.

        Works in pieces, because the count takes long if consumers have consumed many items out of order.
        """
        shown, steps = [], 0
        for place in self.table.in_order():
            if place.done is None:
                shown.append(ConsumerStanding(place.consumer_id, 0, 0))
                continue
            lease, steps = place.lease_end - clock, steps + next_seq // BLOCK_SEQS // pieces.ITEMS_PER_STEP + 1
            waiting = next_seq - place.done.below - self._collected.count(place.done.below, next_seq)
            seq = place.done.below
            while place.done is not None and (found := place.done.first_range(seq)) is not None:
                waiting -= found[1] - found[0] - self._collected.count(*found)
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
        table = self.table
        self.changes += 1
        for former in table.in_order():
            table.drop(former)
        for one in places:
            if one.consumer_id and one.lease_nanos > 0:
                done = SeqSet(one.consumed_below, one.consumed)
                place = table.enter_live(one.consumer_id, done, clock + one.lease_nanos)
                table.set_caller_name(place, one.caller_name)
                self._move_up(place, done)
            elif one.consumer_id:
                table.enter_ended(one.consumer_id, clock - 1)
        table.trim()


class BoundedCount:
    """A `CountOldest` that counts like `count`, but stops at a limit of its work.

    The limits are `slices` slices, and about CONSUMERS_CHECKED_MAX looks at single consumers. `held_back`: the count
    has stopped at a limit.
    """

    __slots__ = ("_consumers", "_count", "_looks_max", "_slices_left", "held_back")

    def __init__(self, slices: int, count: CountOldest, consumers: Consumers) -> None:
        self._count = count
        self._slices_left = slices
        self._consumers = consumers
        self._looks_max = consumers.looked_at + CONSUMERS_CHECKED_MAX
        self.held_back = False

    def __call__(self, part: Slice) -> int:
        """See `CountOldest`."""
        self._slices_left -= 1
        self.held_back = self._slices_left < 0 or self._consumers.looked_at >= self._looks_max
        return 0 if self.held_back else self._count(part)


def _add_some(done: SeqSet, first: int, end: int, ranges_max: int) -> int:
    """Add seqs from `first` on, up to `end` at most, until about `ranges_max` ranges are joined.

    Returns the number of joined ranges.
    """
    before = done.range_count
    done.add(first, done.end_of_ranges(first, end, ranges_max))
    return max(0, before - done.range_count)


def check_consumption(consumer_id: int, seqs: Sequence[int], next_seq: int, lease: int) -> None:
    """Raises InvalidArgument for arguments that are invalid for any place. `next_seq`: the seq of the next item."""
    if not consumer_id:
        raise InvalidArgument("consumer_id is 0; choose a random number above 0, and keep it")
    if not 0 <= lease <= LEASE_NANOS_MAX:
        raise InvalidArgument(
            f"lease_nanos is {lease}; it must be between 0, which gives the place up, and 3600000000000 (1 h)"
        )
    if len(seqs) > SEQS_MAX:
        raise InvalidArgument(f"the request consumes {len(seqs)} seqs; the limit is {SEQS_MAX}: send several requests")
    if seqs and not (min(seqs) >= 1 and max(seqs) < next_seq):
        raise InvalidArgument(
            f"seqs from {min(seqs)} to {max(seqs)} cannot be consumed: the channel's next seq is {next_seq}; name seqs "
            "of items that you have read"
        )


def _ranges(seqs: Iterable[int]) -> list[tuple[int, int]]:
    """The seqs as ranges in ascending order: first seq and end, exclusive."""
    found: list[tuple[int, int]] = []
    for seq in sorted(seqs):
        if found and seq <= found[-1][1]:
            found[-1] = (found[-1][0], max(found[-1][1], seq + 1))
        else:
            found.append((seq, seq + 1))
    return found
