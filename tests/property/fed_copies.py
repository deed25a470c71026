"""Copies of a scenario's channel, fed by the core or by another copy. Their feeds break, repeat parts and lag."""

from __future__ import annotations

from dataclasses import dataclass, field

import pytest

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.copies.messages import run_of_item
from stampede_rt_channel_host.core.channel import (
    ChannelCore,
    ChannelFeed,
    FedChannel,
    FedItem,
    FeedPart,
    NewItem,
    Query,
    SavedCursor,
    Slice,
)
from stampede_rt_channel_host.core.channel.run import Run, make_run
from stampede_rt_channel_host.core.dedup import RetryWindow
from tests.oracle import Item
from tests.property.channel_pair import INCARNATION, ChannelPair, facts, items_of


def stored(part: Slice) -> Run:
    """The run that a copy stores for a slice of the feed, as if it came over the wire."""
    run = part.run
    durations = None if run.durations is None else run.durations[part.lo : part.hi]
    lengths = run.lengths[part.lo : part.hi]
    return make_run(part.first_seq, run.times[part.lo : part.hi], durations, lengths, run.body)


def held_by(channel: ChannelCore, clock: int) -> list[Item]:
    return items_of([*channel.look(clock)[0].slices()])


@dataclass
class FedCopy:
    """One copy, and the open feed from its source."""

    pair: ChannelPair
    upstream: FedCopy | None = None
    window: RetryWindow | None = None  # the owner's window, if the copy may become the owner
    source: ChannelCore = field(init=False)
    channel: FedChannel = field(init=False)
    feed: ChannelFeed | None = None
    last: FeedPart | None = None
    last_at: int = 0
    begun_anew: int = 0
    takes: int = 0
    single_runs: int = 0  # the runs of `ChannelFeed.take_newest`

    def __post_init__(self) -> None:
        self.source = self._present_source()
        self._drop_items()

    def _present_source(self) -> ChannelCore:
        return self.pair.core if self.upstream is None else self.upstream.channel

    def _drop_items(self) -> None:
        self.channel = FedChannel(
            self.pair.core.policy, incarnation=INCARNATION, name="pair", knows_owner=self.window is not None
        )
        self.channel.take_losses(self.pair.core.losses)

    def break_stream(self) -> None:
        """Close the feed, as if its stream had broken."""
        if self.feed is not None:
            self.feed.close()
        self.feed = None

    def take(self, limit_bytes: int) -> bool:
        """Open a feed if there is none, and apply its next part. Returns whether anything came."""
        clock = self.pair.clock
        if self.source is not self._present_source():  # the source copy began again, so its channel is another object
            self.break_stream()
            self.source = self._present_source()
        if self.feed is None:
            try:
                follows = self.upstream is not None
                self.feed = ChannelFeed(
                    self.source, self.channel.place, clock, self.window, follows=follows, takes_puts=True
                )
            except Unavailable:
                assert self.source is not self.pair.core, "an owner is never behind"
                return False
            if self.feed.begins_anew:
                self.begun_anew += 1
                self._drop_items()
        if self.channel.policy != self.source.policy:
            self.channel.configure(self.source.policy, clock)
        if self._take_newest(self.feed, limit_bytes):
            return True
        self.last, self.last_at = self.feed.take(clock, limit_bytes), clock
        if self.last is not None:
            self.apply(self.last)
            self.check_part()
        return self.last is not None

    def _take_newest(self, feed: ChannelFeed, limit_bytes: int) -> bool:
        """Two times out of three, apply the last run if the copy lacks nothing else. Returns whether it did."""
        self.takes += 1
        fed = feed.take_newest(limit_bytes) if self.takes % 3 else None
        if fed is None:
            return False
        [part] = self.source.held.slices_by_seq(fed.item.seq, fed.item.end_seq)
        run, charge_bytes = stored(part), part.charge_bytes
        assert (fed.item.seq, fed.item.time, fed.item.charge_bytes) == (run.first_seq, run.times[0], charge_bytes)
        self.channel.check_item(fed)
        self.channel.apply_item(fed, run_of_item(fed.item) if fed.item.items == 1 else run, self.pair.clock)
        self.last = None
        self.single_runs += 1
        self.check_part()
        return True

    def take_ahead(self, item: NewItem) -> FedItem | None:
        """The item, if the copy may get it before the owner stores it."""
        has_owner = self.source is self.pair.core and self.feed is not None and self.window is not None
        return self.feed.take_ahead(item) if has_owner and self.feed is not None else None

    def apply_item(self, fed: FedItem, run: Run) -> None:
        """Apply a run that the owner has sent ahead. The items that the owner has collected meanwhile stay here."""
        self.channel.check_item(fed)
        self.channel.apply_item(fed, run, self.pair.clock)
        self.last = None  # a run comes once
        here = held_by(self.channel, self.pair.clock)
        assert self.channel.next_seq == self.source.next_seq
        assert {item.seq for item in here} >= {item.seq for item in held_by(self.source, self.pair.clock)}
        counters = self.channel.counters(self.pair.clock)
        assert counters.accepted == counters.held + sum(counters.collected.values())

    def apply(self, part: FeedPart) -> None:
        self.channel.apply(
            first_seq=part.first_seq,
            cleared=part.cleared,
            runs=[stored(one) for one in part.slices],
            next_seq=part.next_seq,
            collection=part.collection,
            advance=part.advance,
            now=self.pair.clock,
            owner_part=part.owner_part,
        )

    def repeat(self) -> None:
        """Apply the last part a second time. This changes nothing.

        If time has passed, without the consumer places: their leases would last longer.
        """
        if self.last is not None and self.feed is not None:
            if self.last.owner_part is not None and self.last_at != self.pair.clock:
                self.last = self.last._replace(owner_part=self.last.owner_part._replace(places=None))
            before = held_by(self.channel, self.pair.clock), self.channel.place, self.channel.counters(0)
            self.apply(self.last)
            assert before == (held_by(self.channel, self.pair.clock), self.channel.place, self.channel.counters(0))

    def check_part(self) -> None:
        """Check that the copy holds the items of its source that lie before its place, and no others."""
        clock, place = self.pair.clock, self.channel.next_seq
        expected = [item for item in held_by(self.source, clock) if item.seq < place]
        assert facts(held_by(self.channel, clock)) == facts(expected)
        counters = self.channel.counters(clock)
        assert counters.accepted == counters.held + sum(counters.collected.values())
        assert counters.held == len(expected)
        assert counters.held_bytes == sum(item.length for item in expected)
        assert counters.accepted + self.channel.missed == place - 1

    def catch_up(self) -> None:
        if self.upstream is not None:
            self.upstream.catch_up()
        while self.take(10**6):
            pass

    def check_equal(self, query: Query) -> None:
        """Check that a copy without lag gives the answers of its owner."""
        clock, core = self.pair.clock, self.pair.core
        core.read(query, clock)  # so that both have applied the present time
        self.catch_up()
        mine, its = self.channel.read(query, clock), core.read(query, clock)
        assert facts(items_of(mine.slices)) == facts(items_of(its.slices))
        assert mine[1:] == its[1:]
        assert (self.channel.newest, self.channel.oldest) == (core.newest, core.oldest)
        assert (self.channel.frontier, self.channel.advanced_to) == (core.frontier, core.advanced_to)


@dataclass
class MovingSubscription:
    """A subscription that moves from host to host, each time with its last cursor."""

    saved: SavedCursor
    seen: list[int] = field(default_factory=list)
    missing: list[int] = field(default_factory=list)

    def visit(self, channel: ChannelCore, clock: int, limit_bytes: int) -> None:
        """Take one batch from a host, unless the host lags behind the cursor."""
        if channel.next_seq < self.saved.next_seq:
            return
        cursor = channel.subscribe_all(clock, saved=self.saved)
        batch = channel.since(cursor, clock, limit_bytes)
        if batch.gap is not None:
            self.missing += range(batch.gap.first_seq, batch.gap.last_seq + 1)
        self.seen += [item.seq for item in items_of([one.slice for one in batch.slices])]
        self.saved = cursor.saved(INCARNATION)
        assert sorted(self.seen + self.missing) == [*range(1, self.saved.next_seq)]


def check_refusal(source: FedChannel, place: FedChannel, clock: int) -> None:
    """Check that `source` refuses to feed a copy that has more items."""
    with pytest.raises(Unavailable):
        ChannelFeed(source, place.place, clock, follows=True)
