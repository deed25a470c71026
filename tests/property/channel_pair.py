"""A channel of the core and one of the oracle. Each step runs on both, and all their visible results must agree."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace

import pytest

from stampede_rt.errors import ChannelFull, InFuture, InvalidArgument
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Bound
from stampede_rt_channel_host.core.channel import (
    AllCursor,
    ChannelCore,
    NewestCursor,
    Offer,
    PendingGet,
    Position,
    PutOutcome,
    Query,
    Reach,
    ReachTracker,
    ReadAnswer,
    Slice,
    WakeAt,
)
from stampede_rt_channel_host.core.channel.values import NO_NEXT_TIMES
from tests.oracle import (
    Item,
    OracleAnswer,
    OracleChannel,
    OracleGet,
    OracleNewest,
    OracleReader,
    OracleSubscription,
    RefusedItem,
    put_run,
)

INCARNATION = 7
TIED_ITEMS_MAX = 3  # hardly any bucket of a scenario has more items


def items_of(slices: Sequence[Slice]) -> list[Item]:
    """The items of slices, read from the columns of their runs."""
    found = []
    for part in slices:
        for at in range(part.lo, part.hi):
            durations = part.run.durations
            duration = None if durations is None or durations[at] < 0 else durations[at]
            found.append(Item(part.run.times[at], part.run.first_seq + at, duration, part.run.lengths[at]))
    return found


def facts(items: Sequence[Item]) -> list[tuple[int, int, int | None, int]]:
    return [(item.time, item.seq, item.duration, item.length) for item in items]


def _may_release(wake: WakeAt, reach: Reach, clock: int) -> bool:
    """Whether the host had to poll the get again: one of its needs is met, or its instant has come."""
    assert wake.needs is not None, "a blocked get knows its condition"
    pairs = zip(wake.needs, reach, strict=True)
    is_met = any(need is not None and reached is not None and need <= reached for need, reached in pairs)
    return is_met or (wake.instant is not None and wake.instant <= clock)


def ends_as_read(
    items: Sequence[Item],
    next_time: int | None,
    overlap: int,
    next_times: Mapping[tuple[int, int], int] = NO_NEXT_TIMES,
) -> list[int | None]:
    """The ends of the items' spans as a reader computes them, from durations and the next later items.

    `next_time` is the time of the next item after the last one. `next_times`: see `ReadAnswer`.
    """
    ends: list[int | None] = []
    for at, item in enumerate(items):
        bounds = [other.time for other in items if other.time > item.time][:1]
        same_bucket = [other for other in items[at:] if other.time == item.time]
        bounds = [next_times[key] for one in same_bucket if (key := (one.time, one.seq + 1)) in next_times] or bounds
        if not bounds and next_time is not None:
            bounds = [next_time]
        if item.duration is not None:
            bounds = [item.time + item.duration, *(max(bound, item.time + overlap) for bound in bounds)]
        ends.append(min(bounds, default=None))
    return ends


def check_causes(collected: Mapping[str, int], expected: Mapping[str, int]) -> None:
    """Check the numbers of collected items by cause.

    Items that two limits outdate at the same moment may count for either cause. The core collects the excess of a whole
    run in one step. The oracle collects it item by item, so the rest of a bucket may become too old between two items.
    """
    assert collected.keys() == expected.keys()
    assert sum(collected.values()) == sum(expected.values())
    differing = [cause for cause in collected if collected[cause] != expected[cause]]
    assert not differing or "age" in differing
    assert all(abs(collected[cause] - expected[cause]) <= TIED_ITEMS_MAX for cause in differing)


@dataclass
class ChannelPair:
    """One channel in the core and in the oracle, with its gets, waiting puts and subscriptions."""

    policy: Policy
    clock: int
    lost_before: int | None = None
    core: ChannelCore = field(init=False)
    oracle: OracleChannel = field(init=False)
    gets: list[tuple[PendingGet, OracleGet]] = field(default_factory=list)
    woken: dict[PendingGet, WakeAt] = field(default_factory=dict)
    waiting: list[Offer] = field(default_factory=list)
    all_subscriptions: list[tuple[AllCursor, OracleSubscription]] = field(default_factory=list)
    newest_subscriptions: list[tuple[NewestCursor, OracleNewest]] = field(default_factory=list)
    # Items that the cursors before a resumption skipped.
    skipped_before: dict[OracleNewest, int] = field(default_factory=dict)
    # The gaps of these subscriptions may count items that `start` excluded.
    may_count_more: set[OracleSubscription] = field(default_factory=set)

    def __post_init__(self) -> None:
        self.core = ChannelCore(self.policy, incarnation=INCARNATION, name="pair", lost_before=self.lost_before)
        self.oracle = OracleChannel(self.policy, self.lost_before)
        self.tracker = ReachTracker(self.core)

    def put(
        self, offer: Offer, on_seal: Callable[[int, Sequence[int] | None, int | None], None] | None = None
    ) -> tuple[PutOutcome, Sequence[Item | RefusedItem]]:
        """Put an offer into both. Keeps the items that have to wait, for `retry_put`. Returns both outcomes.

        Calls `on_seal` with the arguments of `seal` when the core calls it.
        """
        sealed: list[tuple[int, Sequence[int] | None, int | None]] = []

        def seal(first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> bytes:
            sealed.append((first_seq, None if kept is None else list(kept), stamped_time))
            if on_seal is not None:
                on_seal(first_seq, kept, stamped_time)
            return b"body"

        outcome = self.core.put(offer, self.clock, seal)
        taken = put_run(self.oracle, offer, self.clock)
        stamp = taken.stamp if offer.times is None else None
        assert outcome.stamped_time == stamp
        accepted = {at: one for at, one in enumerate(taken.verdicts) if isinstance(one, Item)}
        refused = [(at, one.reason) for at, one in enumerate(taken.verdicts) if isinstance(one, RefusedItem)]
        assert [(one.index, one.error.reason) for one in outcome.rejections] == refused
        waits = (None, None) if taken.waits is None else (len(taken.verdicts), taken.waits.retry_at)
        assert (outcome.waiting, outcome.retry_at) == waits
        if not accepted:
            assert outcome.run is None
            assert sealed == []
        else:
            assert outcome.run is not None
            assert outcome.run.body == b"body"
            assert facts(items_of([Slice(outcome.run, 0, len(outcome.run))])) == facts(list(accepted.values()))
            kept = None if len(accepted) == len(offer.lengths) else list(accepted)
            assert sealed == [(outcome.run.first_seq, kept, stamp)]
        if outcome.waiting is not None:
            self.waiting.append(offer.rest(outcome.waiting, self.clock))
        return outcome, taken.verdicts

    def move_to(self, core: ChannelCore) -> None:
        """Move the channel to another owner. Its readers continue there with their cursors."""
        self.core, self.tracker = core, ReachTracker(core)
        for which in range(len(self.all_subscriptions)):
            self.resume(which)

    def retry_put(self, which: int) -> None:
        if self.waiting:
            self.put(self.waiting.pop(which % len(self.waiting)))

    def give_up_put(self, which: int) -> None:
        if self.waiting:
            offer = self.waiting.pop(which % len(self.waiting))
            outcome = self.core.give_up_put(offer)
            self.oracle.rejected["CHANNEL_FULL"] += len(offer.lengths)
            assert [one.error.reason for one in outcome.rejections] == ["CHANNEL_FULL"] * len(offer.lengths)

    def tick(self, nanos: int) -> None:
        self.clock += nanos

    def advance(self, instant: int) -> None:
        if self.oracle.advance(instant, self.clock):
            assert self.core.advance(instant, self.clock) == self.oracle.advanced_to
        else:
            with pytest.raises(InFuture, match="max_future"):
                self.core.advance(instant, self.clock)

    def configure(self, policy: Policy) -> None:
        """Change the policy, except `overlap`, which never changes."""
        policy = replace(policy, overlap_nanos=self.oracle.policy.overlap_nanos)
        self.core.configure(policy, self.clock)
        self.oracle.configure(policy, self.clock)

    def consume(self, consumer_id: int, seqs: Sequence[int], lease: int) -> None:
        """Consume for one consumer. A channel without consumers must refuse the call."""
        if self.oracle.consumers is None:
            with pytest.raises(InvalidArgument, match="counts no consumption"):
                self.core.consume(consumer_id, seqs, self.clock, lease_nanos=lease)
            self.oracle.age(self.clock)
            return
        expected = self.oracle.consume(consumer_id, list(seqs), self.clock, lease)
        if expected is None:
            with pytest.raises(ChannelFull, match="all places are taken"):
                self.core.consume(consumer_id, seqs, self.clock, lease_nanos=lease)
        else:
            assert self.core.consume(consumer_id, seqs, self.clock, lease_nanos=lease).items == expected

    def carry_consumers(self) -> None:
        """Export the consumer places as values, and restore them, as for a move to another host."""
        self.oracle.age(self.clock)
        places, held = self.core.consumer_places(self.clock), len(self.oracle.held)
        assert all(len(one.consumed) <= held for one in places), "reports are bounded by the held items"
        self.core.restore_consumers(places, self.clock)
        if self.oracle.consumers is not None:
            self.oracle.consumers.move(self.clock)

    def read(self, query: Query) -> None:
        reader = OracleReader(self.oracle, self.clock)
        self._agree(self.core.read(query, self.clock), reader.read(query, reader.resolve(query)))

    def begin(self, query: Query) -> None:
        blocked = OracleGet(query)
        blocked.interval = OracleReader(self.oracle, self.clock).resolve(query)
        self.gets.append((self.core.begin(query, self.clock), blocked))

    def poll_all(self) -> None:
        """Poll all gets, as a host does after each change and at the instants of the gets."""
        still, reach = [], self.tracker.reach(self.clock)
        for pending, blocked in self.gets:
            reader = OracleReader(self.oracle, self.clock)
            expected = blocked.poll(reader)
            answer = self.core.poll(pending, self.clock)
            if isinstance(answer, WakeAt):
                assert expected is None
                assert answer.instant == blocked.wake_at(reader)
                still.append((pending, blocked))
                self.woken[pending] = answer
            else:
                assert expected is not None
                assert pending not in self.woken or _may_release(self.woken[pending], reach, self.clock)
                self._agree(answer, expected)
        self.gets = still

    def give_up_get(self, which: int) -> None:
        if self.gets:
            pending, blocked = self.gets.pop(which % len(self.gets))
            expected = blocked.give_up(OracleReader(self.oracle, self.clock))
            self._agree(self.core.give_up(pending, self.clock), expected)

    def _agree(self, answer: ReadAnswer, expected: OracleAnswer) -> None:
        items = items_of(answer.slices)
        assert facts(items) == facts(expected.items)
        assert ends_as_read(items, answer.next_time, self.oracle.overlap, answer.next_times) == expected.ends
        assert (answer.interval, answer.complete, answer.truncated, answer.more) == (
            expected.interval,
            expected.complete,
            expected.truncated,
            expected.more,
        )
        assert answer.reason == expected.reason
        assert answer.reason is None or answer.reason.detail
        assert answer.incarnation == INCARNATION

    def subscribe(self, start: Bound | None, exclusive: bool, after: Position | None) -> None:
        """Begin a subscription in each of the two modes, from the same position."""
        all_items = self.core.subscribe_all(self.clock, start=start, start_exclusive=exclusive, after=after)
        newest = self.core.subscribe_newest(self.clock, start=start, start_exclusive=exclusive, after=after)
        reader = OracleReader(self.oracle, self.clock)
        last = max(((item.time, item.seq) for item in self.oracle.held), default=None)
        owed: list[int] = []
        if after is not None and after.seq is not None:
            owed = [seq for seq in self.oracle.log if seq > after.seq]
            last = (after.time, after.seq)
        elif start is not None:
            from_instant = reader.instant_of(start)
            if from_instant is not None:
                low = (from_instant, 2**64 if exclusive else 0)
                owed = [item.seq for item in self.oracle.held if (item.time, item.seq) > low]
                last = low
        self.all_subscriptions.append((all_items, OracleSubscription(self.oracle, owed)))
        predictor = OracleNewest(self.oracle, last, owed)
        self.newest_subscriptions.append((newest, predictor))
        if after is None:  # with `after`, a late item can make the number of skipped items negative at first
            self.skipped_before[predictor] = 0

    def resume(self, which: int) -> None:
        """Replace a subscription by one from its saved cursor. No item may be left out or counted twice."""
        if not self.all_subscriptions:
            return
        place = which % len(self.all_subscriptions)
        cursor, subscription = self.all_subscriptions[place]
        saved = cursor.saved(INCARNATION)
        self.all_subscriptions[place] = self.core.subscribe_all(self.clock, saved=saved), subscription
        if saved.low is not None:
            self.may_count_more.add(subscription)
        newest_cursor, newest = self.newest_subscriptions[place]
        if newest in self.skipped_before:
            resumed = self.core.subscribe_newest(self.clock, saved=newest_cursor.saved(INCARNATION))
            self.skipped_before[newest] += newest_cursor.skipped
            self.newest_subscriptions[place] = resumed, newest

    def deliver(self, limit_bytes: int) -> None:
        """Let every subscription take its next part."""
        for cursor, subscription in self.all_subscriptions:
            self._deliver(cursor, subscription, limit_bytes)
        for newest_cursor, newest in self.newest_subscriptions:
            given = self.core.latest(newest_cursor, self.clock)
            self.oracle.age(self.clock)
            expected = newest.take()
            assert facts([expected] if expected else []) == facts(items_of([given.slice] if given else []))
            assert self.skipped_before.get(newest, 0) + newest_cursor.skipped == newest.skipped

    def _deliver(self, cursor: AllCursor, subscription: OracleSubscription, limit_bytes: int) -> None:
        delivery = self.core.since(cursor, self.clock, limit_bytes)
        self.oracle.age(self.clock)
        if delivery.gap is not None:
            gap = delivery.gap
            missing = [seq for seq in subscription.owed() if gap.first_seq <= seq <= gap.last_seq]
            assert len(missing) == gap.items or (subscription in self.may_count_more and len(missing) < gap.items)
            assert not any(subscription.is_held(seq) for seq in missing)
            subscription.settle(missing)
        items = items_of([delivered.slice for delivered in delivery.slices])
        expected = [self.oracle.log[item.seq] for item in items]
        assert facts(items) == facts(expected)
        assert all(subscription.is_held(item.seq) for item in items)
        subscription.settle([item.seq for item in items])
        for delivered in delivery.slices:
            part = items_of([delivered.slice])
            assert ends_as_read(part, delivered.next_time, self.oracle.overlap) == [
                self.oracle.end(self.oracle.log[i.seq]) for i in part
            ]
        assert delivery.is_empty <= (subscription.owed() == [])
        assert cursor.delivered + cursor.dropped <= len(self.oracle.log)

    def collect(self, entries_max: int) -> None:
        self.core.collect(self.clock, entries_max)

    def check(self) -> None:
        """Compare the counters, times and deadlines."""
        self.oracle.age(self.clock)
        counters = self.core.counters(self.clock)
        assert counters.accepted == counters.held + sum(counters.collected.values()) == len(self.oracle.log)
        check_causes(counters.collected, self.oracle.collected)
        assert counters.rejected == self.oracle.rejected
        assert counters.held_bytes == sum(item.length for item in self.oracle.held)
        assert counters.accepted_bytes == sum(item.length for item in self.oracle.log.values())
        assert (self.core.newest, self.core.oldest) == (self.oracle.newest, self.oracle.oldest)
        assert (self.core.frontier, self.core.advanced_to) == (self.oracle.frontier, self.oracle.advanced_to)
        while self.core.next_deadline(self.clock) == self.clock:
            self.core.collect(self.clock)
        assert self.core.next_deadline(self.clock) == self.oracle.next_due()
        assert self.core.next_seq == len(self.oracle.log) + 1
        self._check_places()

    def _check_places(self) -> None:
        places = self.oracle.consumers.taken if self.oracle.consumers else []
        held = {item.seq for item in self.oracle.held}
        shown = {place.consumer_id: place for place in self.core.consumers(self.clock)}
        assert shown.keys() == {place.consumer_id for place in places}
        for place in places:
            one = shown[place.consumer_id]
            assert one.lease_nanos == (0 if place.ended else place.until - self.clock)
            assert one.waiting == sum(place.owes(seq) for seq in held)
