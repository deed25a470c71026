"""Who has consumed what (paper, section 3.4: reference count with a known number of consumers). Pure.

A channel with consumers has that many places. A consumer takes one with its first `consume`, keeps it by a lease that
each further one renews, and loses it when the lease ends. It holds back what it has not consumed:

- a place never taken holds back every item; its first taker owes everything that is held;
- a place whose lease has ended holds back nothing until it is taken again, and that taker owes the newest item and
  whatever is accepted later;
- a consumer finds its own place again; a new one gets the place that ended the longest ago, so that places which nobody
  took yet go on holding for those who are still to come, and otherwise one of these.

Kept for each place: the seqs that it has consumed or that are gone anyway. What is not in this set is held and owed, so
its ranges are never more than the held items, and one for a consumer that goes in order.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import NamedTuple

from stampede_rt.errors import ChannelFull, InvalidArgument
from stampede_rt.timeline import format_duration
from stampede_rt_channel_host.core.channel.run import Slice
from stampede_rt_channel_host.core.channel.seq_set import SeqSet

LEASE_NANOS = 10_000_000_000
"""How long a place is kept after a `consume` that states nothing else."""

LEASE_NANOS_MAX = 3_600_000_000_000
SEQS_MAX = 4096


class Consumed(NamedTuple):
    """How many items the consumer had not consumed before, and how long its place is kept from now on."""

    items: int
    lease_nanos: int


class ConsumerPlace(NamedTuple):
    """A place as a value; it moves with its channel. Times are durations, since two hosts' clocks differ.

    `consumer_id` 0: never taken. `lease_nanos` 0: the lease has ended. Consumed is everything below `consumed_below`
    and the `consumed` ranges (first and end, the end excluded). `waiting`: held items that it has not consumed.
    """

    consumer_id: int
    lease_nanos: int
    consumed_below: int
    consumed: Sequence[tuple[int, int]]
    waiting: int = 0


class _Place:
    """A place that was taken; `done` is None once its lease has ended, at `until`."""

    __slots__ = ("done", "until")

    def __init__(self, until: int, done: SeqSet | None) -> None:
        self.until = until
        self.done = done


class Consumers:
    """The places of one channel. `clock` is the host's clock, which never goes back; `expire` is called before others.

    `gone`: every seq below `next_seq` that is not held.
    """

    def __init__(self, places: int, gone: SeqSet) -> None:
        self._places = places
        self._gone = gone
        self._taken: dict[int, _Place] = {}
        self._live: list[SeqSet] = []  # what those with a lease have done
        self.next_lease_end: int | None = None

    @property
    def untaken(self) -> int:
        """How many places were never taken."""
        return self._places - len(self._taken)

    @property
    def live(self) -> int:
        """How many places have a consumer whose lease holds."""
        return len(self._live)

    def expire(self, clock: int) -> None:
        """End the leases that are over."""
        if self.next_lease_end is None or clock < self.next_lease_end:
            return
        for place in self._taken.values():
            if place.until <= clock:
                place.done = None
        self._note_leases()

    def consume(
        self, consumer_id: int, seqs: Sequence[int], *, next_seq: int, newest_seq: int | None, clock: int, lease: int
    ) -> Consumed:
        """Note that a consumer has consumed `seqs`, and keep its place for `lease` more; 0 gives the place up.

        `newest_seq` is the newest item's. Raises InvalidArgument, and ChannelFull if all places are taken.
        """
        _check(consumer_id, seqs, next_seq, lease)
        if not lease and not seqs and not self._holds_place(consumer_id):
            return Consumed(0, 0)
        done = self._take(consumer_id, next_seq if newest_seq is None else newest_seq)
        items = sum(done.add(first, end) for first, end in _ranges(seqs))
        place = self._taken[consumer_id]
        place.until = clock + lease
        place.done = done if lease else None
        self._note_leases()
        return Consumed(items, lease)

    def _holds_place(self, consumer_id: int) -> bool:
        own = self._taken.get(consumer_id)
        return own is not None and own.done is not None

    def _take(self, consumer_id: int, restart_seq: int) -> SeqSet:
        """What the consumer has done, in its own place or in one that it takes now."""
        own = self._taken.get(consumer_id)
        if own is not None and own.done is not None:
            return own.done
        ended = len(self._live) < len(self._taken)
        if own is None and not ended and not self.untaken:
            raise ChannelFull(
                f"the channel counts {self._places} consumers and all places are taken; the next one is free in "
                f"{format_duration(LEASE_NANOS)} at the latest after one of them stops, or raise consumers (configure)",
                metadata={"consumers": str(self._places)},
            )
        done = self._gone.copy()
        if own is not None or ended:
            former = consumer_id if own is not None else min(self._taken.items(), key=_worth)[0]
            del self._taken[former]
            done.add(1, restart_seq)
        self._taken[consumer_id] = _Place(0, done)
        return done

    def let_go(self, first: int, end: int) -> None:
        """Items were collected, whatever for: nobody owes them any more."""
        self._gone.add(first, end)
        for done in self._live:
            done.add(first, end)

    def resize(self, places: int) -> None:
        """Another number of places. Of too many taken ones go first those that ended, then the soonest to end."""
        self._places = places
        for known, _ in sorted(self._taken.items(), key=_worth)[: max(0, len(self._taken) - places)]:
            del self._taken[known]
        self._note_leases()

    def done_with(self, part: Slice) -> int:
        """How many of the first items of `part` every live consumer has consumed."""
        first = part.first_seq
        end = min((done.end_of(first) for done in self._live), default=part.end_seq)
        return min(end, part.end_seq) - first

    def places(self, clock: int, next_seq: int) -> list[ConsumerPlace]:
        """Every place that was taken, as a value; first those whose leases have ended, the longest ago first."""
        shown = []
        for consumer_id, place in sorted(self._taken.items(), key=_worth):
            done = place.done or self._gone
            lease, waiting = (place.until - clock, next_seq - 1 - done.size) if place.done else (0, 0)
            shown.append(ConsumerPlace(consumer_id, lease, done.below, done.ranges, waiting))
        return shown

    def restore(self, places: Iterable[ConsumerPlace], clock: int) -> None:
        """Take over places that `places` told, instead of those that are there. Those of id 0 stay untaken."""
        self._taken = {}
        for one in places:
            if one.consumer_id:
                done = SeqSet(one.consumed_below, one.consumed) if one.lease_nanos > 0 else None
                if done is not None:
                    done.add(1, self._gone.below)
                    for first, end in self._gone.ranges:
                        done.add(first, end)
                self._taken[one.consumer_id] = _Place(clock + (one.lease_nanos or -1), done)
        self.resize(self._places)

    def _note_leases(self) -> None:
        live = [place for place in self._taken.values() if place.done is not None]
        self._live = [place.done for place in live if place.done is not None]
        self.next_lease_end = min((place.until for place in live), default=None)


def _worth(taken: tuple[int, _Place]) -> tuple[bool, int]:
    """The least worth of places is the one that ended the longest ago."""
    return taken[1].done is not None, taken[1].until


def _check(consumer_id: int, seqs: Sequence[int], next_seq: int, lease: int) -> None:
    if not consumer_id:
        raise InvalidArgument("consumer_id is 0; choose a random number and keep it")
    if not 0 <= lease <= LEASE_NANOS_MAX:
        raise InvalidArgument(f"lease_nanos is {lease}; it is between 0, which gives the place up, and 1 h")
    if len(seqs) > SEQS_MAX:
        raise InvalidArgument(f"{len(seqs)} seqs are to be consumed; {SEQS_MAX} at once are the most")
    if seqs and not (min(seqs) >= 1 and max(seqs) < next_seq):
        raise InvalidArgument(
            f"seqs from {min(seqs)} to {max(seqs)} are to be consumed, but the channel gave out 1 to {next_seq - 1}"
        )


def _ranges(seqs: Iterable[int]) -> list[tuple[int, int]]:
    found: list[tuple[int, int]] = []
    for seq in sorted(seqs):
        if found and seq <= found[-1][1]:
            found[-1] = (found[-1][0], max(found[-1][1], seq + 1))
        else:
            found.append((seq, seq + 1))
    return found
