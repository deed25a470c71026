"""The facts that only the owner of a channel knows, in its feed: the runs of producers, and the places of consumers.

Pure.

A copy that may become the owner holds these facts, too (`OwnerFacts`). A proxy does not need them.

The feed keeps this order: a copy never has an item whose run it does not know. So a producer that repeats a run at the
next owner gets its former answer. A copy may know runs of items that it has not got yet. When it becomes the owner, it
forgets such runs, and accepts their items anew.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from typing import NamedTuple

from stampede_rt_channel_host.core.channel.channel import ChannelCore
from stampede_rt_channel_host.core.channel.consumer_places import ConsumerPlace, Place
from stampede_rt_channel_host.core.channel.consumption import Consumers
from stampede_rt_channel_host.core.channel.new_item import NewItem
from stampede_rt_channel_host.core.channel.values import Counters, GrowingCounts, OtherCounts
from stampede_rt_channel_host.core.dedup import KeptRun, RetryWindow
from stampede_rt_channel_host.core.window_feed import WindowFeed

RUNS_PER_PART = 1024  # about 60 KiB; a part has more if one producer has more
RANGES_PER_PART = 4096  # the most ranges of consumed seqs in one part: about 40 KiB
ROUND_NANOS = 200_000_000  # the feed sends the places again at most five times a second


class FedPlaces(NamedTuple):
    """A part of the consumer places.

    `begins`: this is the first part of a round, and replaces the places of earlier rounds. `ends`: it is the last part.
    If a place has the consumer id of the last place before it, its ranges continue.
    """

    begins: bool
    places: tuple[ConsumerPlace, ...]
    ends: bool


class OwnerPart(NamedTuple):
    """The owner's facts in one part of a feed.

    `runs`: the runs of producers, the earliest first. `places`: None if the places have not changed. `counters`: a
    `GrowingCounts` if only these counts have changed; then `runs` has one run, of which the owner has accepted all
    items. `complete_before`: with this part the copy has all runs that the owner judged before this time of its clock;
    None: more runs follow.
    """

    runs: tuple[KeptRun, ...]
    places: FedPlaces | None
    counters: Counters | GrowingCounts
    complete_before: int | None


class OwnerFactsFeed:
    """The source's side. `since`: the `complete_before` of the copy (see `OwnerPart`); None: the copy has no runs.

    `takes_puts`: the copy understands a `GrowingCounts`.
    """

    def __init__(self, source: ChannelCore, window: RetryWindow, since: int | None, *, takes_puts: bool) -> None:
        self._source = source
        self._window = WindowFeed(window, since)
        self._sent: tuple[Consumers | None, int] = None, 0  # the consumers and their changes as of the last round
        self._round: Iterator[ConsumerPlace] | None = None
        self._next_round = -(2**63)
        self._clock = 0
        self._takes_puts = takes_puts
        self._sent_counts: tuple[GrowingCounts, OtherCounts | Counters] | None = None  # as of the last part

    @property
    def is_caught_up(self) -> bool:
        """Whether the copy has all runs, so that it may get all items."""
        return self._window.is_caught_up

    def is_complete(self, now: int) -> bool:
        """Whether the copy has all facts. If places have changed since the last round, begins another round."""
        self._next_round = min(self._next_round, now)
        has_places = self._round is None and self._places_now() == self._sent
        return has_places and self._window.is_caught_up and self._counts_now() == self._sent_counts

    def take(self, now: int) -> OwnerPart | None:
        """The next part, or None if nothing has changed."""
        self._clock = now
        if self._takes_puts and (put := self._take_put(now)) is not None:
            return put
        was_caught_up = self._window.is_caught_up
        runs = tuple(self._window.take(RUNS_PER_PART))
        places = self._take_places(now)
        counts = self._counts_now()
        if was_caught_up and places is None and counts == self._sent_counts:
            return None
        self._sent_counts = counts
        return OwnerPart(runs, places, self._source.latest_counters(), now if self._window.is_caught_up else None)

    def _take_put(self, now: int) -> OwnerPart | None:
        """The part if one accepted run is the only change; otherwise None."""
        growth, others = counts = self._counts_now()
        is_only = self._sent_counts is not None and self._sent_counts[1] == others
        if not is_only or self._round is not None or self._places_now() != self._sent:
            return None
        run = self._window.take_put()
        if run is None:
            return None
        self._sent_counts = counts
        return OwnerPart((run,), None, growth, now)

    def pass_put(self, item: NewItem) -> bool:
        """Note that the copy gets the run, which the source is about to store, in another way.

        Returns False, and notes nothing, if the copy lacks other facts, or cannot compute all facts from the run.
        """
        has_all = self._round is None and self._places_now() == self._sent
        growth, others = counts = self._counts_now()
        if not (self._takes_puts and has_all and counts == self._sent_counts):
            return False
        if not self._window.pass_put(item.producer_id, item.caller_name, item.judged_at):
            return False
        self._sent_counts = GrowingCounts(growth.accepted + item.items, growth.accepted_bytes + item.length), others
        return True

    def _counts_now(self) -> tuple[GrowingCounts, OtherCounts | Counters]:
        """The counts that the copy must get. A copy that takes puts computes the other counts."""
        source = self._source
        return source.growth, source.other_counts if self._takes_puts else source.latest_counters()

    def _places_now(self) -> tuple[Consumers | None, int]:
        consumers = self._source.known_consumers
        return consumers, 0 if consumers is None else consumers.changes

    def _take_places(self, now: int) -> FedPlaces | None:
        begins = self._round is None
        if self._round is None:
            present = self._places_now()
            if present == self._sent or now < self._next_round:
                return None
            self._sent, self._next_round = present, now + ROUND_NANOS
            self._round = self._scan(present[0])
        found: list[ConsumerPlace] = []
        ranges = 0
        while (place := next(self._round, None)) is not None:
            found.append(place)
            ranges += 1 + len(place.consumed)
            if ranges >= RANGES_PER_PART:
                return FedPlaces(begins, tuple(found), ends=False)
        self._round = None
        return FedPlaces(begins, tuple(found), ends=True)

    def _scan(self, consumers: Consumers | None) -> Iterator[ConsumerPlace]:
        """The places, each in pieces of at most RANGES_PER_PART ranges. The places may change between two pieces."""
        for place in [] if consumers is None else consumers.table.in_order():
            if place.done is None:
                yield ConsumerPlace(place.consumer_id, 0, 1, (), place.caller_name)
                continue
            below, ranges = place.done.below, _ranges(place, 0)
            while True:
                lease = max(0, place.lease_end - self._clock)
                yield ConsumerPlace(place.consumer_id, lease, below, ranges, place.caller_name)
                if not ranges or not (ranges := _ranges(place, ranges[-1][1])):
                    break


def _ranges(place: Place, seq: int) -> tuple[tuple[int, int], ...]:
    """At most RANGES_PER_PART ranges of the place's consumed seqs, from `seq` on."""
    found: list[tuple[int, int]] = []
    while len(found) < RANGES_PER_PART and place.done is not None and (one := place.done.first_range(seq)) is not None:
        found.append(one)
        seq = one[1]
    return tuple(found)


class OwnerFacts:
    """The copy's side: the facts as of the last parts of the feed. `window` becomes the window of the new owner."""

    def __init__(self) -> None:
        self.window = RetryWindow()
        self.complete_before: int | None = None
        self.counters: Counters | None = None
        self._places: tuple[ConsumerPlace, ...] = ()
        self._arrived = 0
        self._arriving: dict[int, tuple[ConsumerPlace, int]] = {}  # by consumer, with the time of its first part

    @classmethod
    def of_owner(cls, window: RetryWindow, counters: Counters, places: Iterable[ConsumerPlace], now: int) -> OwnerFacts:
        """The facts of a former owner, as of `now`. The feed of the new owner sends all of them again."""
        facts = cls()
        facts.window, facts.counters = window, counters
        facts._places, facts._arrived = tuple(places), now
        return facts

    def apply(self, part: OwnerPart, now: int) -> None:
        """Take over a part. Safe to repeat for the last part."""
        for run in part.runs:
            self.window.adopt(run)
        if isinstance(part.counters, Counters):
            self.counters = part.counters
        elif self.counters is not None:
            self.counters = replace(self.counters, **part.counters._asdict())
        if part.complete_before is not None:
            self.complete_before = part.complete_before
        if part.places is not None:
            self._take_places(part.places, now)

    def part_of(self, item: NewItem, now: int) -> OwnerPart | None:
        """The facts that follow from a run of the feed. None: the feed has brought no facts before."""
        known, producer = self.counters, self.window.producers.get(item.producer_id)
        if known is None:
            return None
        run = item.kept_run(now, "" if producer is None else producer.caller_name)
        growth = GrowingCounts(known.accepted + item.items, known.accepted_bytes + item.length)
        return OwnerPart((run,), None, growth, item.judged_at)

    def places(self, now: int) -> list[ConsumerPlace]:
        """The consumer places, with the rest of their leases at `now`."""
        return [_aged(one, now - self._arrived) for one in self._places]

    def _take_places(self, part: FedPlaces, now: int) -> None:
        if part.begins:
            self._arriving = {}
        for place in part.places:
            first, arrived = self._arriving.get(place.consumer_id, (None, now))
            if first is None:
                self._arriving[place.consumer_id] = place, now
            elif tuple(place.consumed[:1]) > tuple(first.consumed[-1:]):  # not a repeated part
                whole = first._replace(consumed=(*first.consumed, *place.consumed))
                self._arriving[place.consumer_id] = whole, arrived
        if part.ends:
            self._places = tuple(_aged(one, now - arrived) for one, arrived in self._arriving.values())
            self._arrived = now


def _aged(place: ConsumerPlace, passed: int) -> ConsumerPlace:
    """The place with the rest of its lease after `passed` nanoseconds."""
    return place._replace(lease_nanos=max(0, place.lease_nanos - max(0, passed)))
