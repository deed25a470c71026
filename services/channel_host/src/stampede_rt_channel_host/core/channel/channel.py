"""One channel: puts, reads, retention and subscriptions over values and `now` (paper, sections 3.1 to 3.4). Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from stampede_rt.errors import InFuture, InvalidArgument
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Bound, format_duration
from stampede_rt_channel_host.core.channel import pieces
from stampede_rt_channel_host.core.channel.acceptance import Acceptance
from stampede_rt_channel_host.core.channel.consumption import (
    LEASE_NANOS,
    Consumed,
    ConsumerPlace,
    ConsumerStanding,
    check_consumption,
)
from stampede_rt_channel_host.core.channel.holdings import COUNT, Cut, Holdings
from stampede_rt_channel_host.core.channel.index import SEQ_END, ItemKey
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.channel.moment import Moment
from stampede_rt_channel_host.core.channel.pieces import Pieces, run_to_end
from stampede_rt_channel_host.core.channel.reading import Pending, Reading
from stampede_rt_channel_host.core.channel.retention import Retention
from stampede_rt_channel_host.core.channel.subscribing import (
    AllCursor,
    NewestCursor,
    open_all,
    open_newest,
    resume_all,
    resume_newest,
    since,
)
from stampede_rt_channel_host.core.channel.values import (
    Counters,
    DeliveredSlice,
    Offer,
    Position,
    PutOutcome,
    Query,
    ReadAnswer,
    Rejection,
    SavedCursor,
    Seal,
    SubscriptionBatch,
    WakeAt,
)

FREED_ENTRIES_PER_CALL = 32
"""How much memory of outdated items one put or read frees beside its own work."""

ENTRIES_PER_ITEM_MAX = 3
"""A late item makes at most so many entries of the index: its own, and the two ends of the one that it splits."""

PUTS_PER_SETTLING = 16
"""Puts that change nothing but the newest end leave ageing to the next read, or to every so many puts."""


class ChannelCore:
    """The items of one channel, in memory. Not thread-safe: one owner calls it, each call is atomic and never blocks.

    Every call takes `now`, the host's clock (`HostTime`), in nanoseconds since the epoch; an earlier one than before
    counts as the latest seen. After each put, advance and configure the owner polls its blocked gets, offers waiting
    puts again and looks after its subscriptions; after each consume it offers waiting puts again. Seqs start at 1.
    """

    def __init__(
        self,
        policy: Policy,
        *,
        incarnation: int,
        name: str = "",
        lost_before: int | None = None,
        cut: Cut | None = None,
    ) -> None:
        """An empty channel. Raises InvalidArgument if the policy cannot hold (see `ChannelLimits.of`).

        `lost_before`: when this incarnation began, if one before it was lost with its host; readers of the time before
        are told. `cut` gives the body of some items of a run, from the run's; without it a run is kept as long as any
        item of it.
        """
        self._policy = policy
        self._incarnation = incarnation
        self.lost_before = lost_before
        self._held = Holdings(cut)
        self._retention = Retention(ChannelLimits.of(policy), self._held)
        self.name = name
        self._acceptance = Acceptance(self._held, self._retention, name)
        self._reading = Reading(self._held, self._retention, incarnation, lost_before)
        self._clock: int | None = None
        self._puts_unsettled = 0
        self._settled: int | None = None
        self._entries_to_free = 0  # what puts may have brought in since they last freed

    def put(self, offer: Offer, now: int, seal: Seal) -> PutOutcome:
        """Accept or refuse each item of `offer`, in order, as so many puts at one instant; store the accepted as a run.

        `seal` is called once if any item was accepted. Nothing of the offer is changed or kept. See PutOutcome for
        items that have to wait. Puts that arrive while one waits are to wait behind it, so that a run's seqs follow
        each other.
        """
        clock, counts_consumption = self._tick(now), self._retention.consumers is not None
        if counts_consumption:
            self._settle(clock)
        outcome = self._acceptance.put(offer, clock, seal)
        self._puts_unsettled += 1
        self._entries_to_free += ENTRIES_PER_ITEM_MAX * len(offer.lengths)
        if self._puts_unsettled >= PUTS_PER_SETTLING or counts_consumption or not self._retention.has_room(0, 0):
            self._settle_puts(clock)
        return outcome

    def give_up_put(self, offer: Offer) -> PutOutcome:
        """Refuse the items that waited in vain, each with ChannelFull, and count them."""
        full = self._acceptance.full()
        rejections: list[Rejection] = [self._acceptance.refuse(index, full) for index in range(len(offer.lengths))]
        return PutOutcome(rejections=rejections)

    def reject_malformed(self, items: int) -> None:
        """Count items that the shell refused before they became an offer."""
        self._acceptance.rejected["MALFORMED_RUN"] += items

    def reject_overloaded(self, items: int) -> None:
        """Count items that the shell refused because a bound of the host is reached."""
        self._acceptance.rejected["OVERLOADED"] += items

    def read(self, query: Query, now: int) -> ReadAnswer:
        """The items of the query that the channel holds now. Changes nothing that another reader could see.

        Raises IncarnationLost if a position comes from another incarnation.
        """
        return run_to_end(self.reading(query, now))

    def reading(self, query: Query, now: int) -> Pieces[ReadAnswer]:
        """The same in pieces, all as of now."""
        self._check_positions(query)
        clock = self._settle(self._tick(now))
        return self._reading.answer(query, self._reading.resolve(query, clock), clock)

    def begin(self, query: Query, now: int) -> Pending:
        """Begin a blocking get: anchors are resolved now, or at the first poll when they can be. Then poll at once.

        Raises IncarnationLost if a position comes from another incarnation.
        """
        self._check_positions(query)
        clock = self._settle(self._tick(now))
        return Pending(query, self._reading.resolve(query, clock))

    def poll(self, pending: Pending, now: int) -> ReadAnswer | WakeAt:
        """The blocking get's answer, or when to poll again.

        Released by the first matching item, with `complete` when the interval is finished, and in any case once
        nothing can come: the interval lies below the frontier, is empty, or is finished.
        """
        return run_to_end(self.polling(pending, now))

    def polling(self, pending: Pending, now: int) -> Pieces[ReadAnswer | WakeAt]:
        """The same in pieces, all as of now."""
        clock = self._settle(self._tick(now))
        found = yield from self._reading.poll(pending, clock)
        return WakeAt(found.instant, self._reading.needs(pending)) if isinstance(found, WakeAt) else found

    def give_up(self, pending: Pending, now: int) -> ReadAnswer:
        """The answer when the time of the get is over, with its reason."""
        return run_to_end(self.giving_up(pending, now))

    def giving_up(self, pending: Pending, now: int) -> Pieces[ReadAnswer]:
        """The same in pieces, all as of now."""
        clock = self._settle(self._tick(now))
        return self._reading.answer(pending.query, pending.interval, clock)

    def subscribe_all(
        self, now: int, *, start: Bound | None = None, start_exclusive: bool = False, after: Position | None = None,
        saved: SavedCursor | None = None,
    ) -> AllCursor:  # fmt: skip
        """Begin a subscription in seq order: held items from `start` on, or all accepted behind `after`, then new ones;
        or go on from where one stood that was `saved`.

        None of them: only new ones. Several: InvalidArgument. `after` needs its seq. Raises IncarnationLost.
        """
        return run_to_end(
            self.subscribing_all(now, start=start, start_exclusive=start_exclusive, after=after, saved=saved)
        )

    def subscribing_all(
        self, now: int, *, start: Bound | None = None, start_exclusive: bool = False, after: Position | None = None,
        saved: SavedCursor | None = None,
    ) -> Pieces[AllCursor]:  # fmt: skip
        """The same in pieces, all as of now."""
        if saved is not None:
            self._check_saved(saved)
            self._settle(self._tick(now))
            return resume_all(self._held, saved)
        after_key = self._resume_key(start, after)
        low = self._start_key(start, start_exclusive, now)
        return open_all(self._held, low, None if after_key is None else after_key[1])

    def since(self, cursor: AllCursor, now: int, limit_bytes: int) -> SubscriptionBatch:
        """Take the next part, about `limit_bytes` (payload and overhead; at least one slice). Moves the cursor.

        What retention collected before it was taken is reported once, as a gap. Empty: wait for the next put.
        """
        self._settle(self._tick(now))
        return since(self._held, self._retention.limits, cursor, limit_bytes)

    def subscribe_newest(
        self, now: int, *, start: Bound | None = None, start_exclusive: bool = False, after: Position | None = None,
        saved: SavedCursor | None = None,
    ) -> NewestCursor:  # fmt: skip
        """Begin a subscription to the latest item. With `start` the present newest comes first, if it is not earlier.

        Raises like `subscribe_all`.
        """
        if saved is not None:
            self._check_saved(saved)
            self._settle(self._tick(now))
            return resume_newest(self._held, saved)
        after_key = self._resume_key(start, after)
        return open_newest(self._held, self._start_key(start, start_exclusive, now), after_key)

    def latest(self, cursor: NewestCursor, now: int) -> DeliveredSlice | None:
        """Take the newest item if it is later than the last one taken. Moves the cursor and counts what it skipped."""
        self._settle(self._tick(now))
        return cursor.take(self._held)

    def advance(self, instant: int, now: int) -> int:
        """Promise that nothing earlier than `instant` will come; gives the highest promise. Raises InFuture."""
        clock = self._tick(now)
        if instant > clock + self._retention.limits.max_future_nanos:
            raise InFuture(
                f"the advance is {format_duration(instant - clock)} ahead of the host's clock; at most "
                f"{format_duration(self._retention.limits.max_future_nanos)} (max_future) is taken: set the clock"
            )
        highest = instant if self.advanced_to is None else max(self.advanced_to, instant)
        self._acceptance.advance = self._reading.advance = highest
        return highest

    def configure(self, policy: Policy, now: int) -> None:
        """Set another policy, whole; what it outdates goes at once. Raises InvalidArgument and changes nothing.

        Walks the index once if it outdates much. Fewer consumers end the places whose leases end first.
        """
        limits = ChannelLimits.of(policy)
        clock = self._settle(self._tick(now))
        self._policy = policy
        self._retention.set_limits(limits)
        self._settle(clock)
        self._retention.drop_excess(clock)

    def consume(self, consumer_id: int, seqs: Sequence[int], now: int, *, lease_nanos: int = LEASE_NANOS) -> Consumed:
        """Use items up for one consumer; what all consumers have used up goes, the oldest first. Safe to repeat.

        Takes the consumer's place if it has none, and keeps it for `lease_nanos` from now (see `Consumers`); 0 gives it
        up. `seqs` may be none. Raises InvalidArgument, and ChannelFull if all places are taken.
        """
        run_to_end(self.catching_up(now))
        clock = self._settle(self._tick(now))
        self.check_consumption(consumer_id, seqs, lease_nanos)
        consumers = self._retention.consumers
        assert consumers is not None, "it is checked"
        newest_seq = self._held.newest_seq
        consumed = consumers.consume(
            consumer_id, seqs, next_seq=self.next_seq, newest_seq=newest_seq, clock=clock, lease=lease_nanos
        )
        self._settle(clock)
        return consumed

    def check_consumption(self, consumer_id: int, seqs: Sequence[int], lease_nanos: int) -> None:
        """Raises InvalidArgument if `consume` would for any of these, whatever happens meanwhile."""
        if self._retention.consumers is None:
            raise InvalidArgument(
                "the channel counts no consumption: it was created without consumers; create it with consumers=, or "
                "add them with configure()"
            )
        check_consumption(consumer_id, seqs, self.next_seq, lease_nanos)

    def catching_up(self, now: int) -> Pieces[None]:
        """Let consumers know all that was collected, in pieces: do it before `consume` and `restore_consumers`, which
        otherwise do it at once."""
        self._settle(self._tick(now))
        while self._retention.learn_gone(pieces.STEPS_PER_PIECE // 4):  # each takes longer than to look at a slice
            yield

    def consumers(self, now: int) -> list[ConsumerStanding]:
        """How the places stand that were taken."""
        return run_to_end(self.counting_consumers(now))

    def counting_consumers(self, now: int) -> Pieces[list[ConsumerStanding]]:
        """The same in pieces. What a consumer has waiting is as of when it was counted."""
        yield from self.catching_up(now)
        clock = self._settle(self._tick(now))
        consumers = self._retention.consumers
        return [] if consumers is None else (yield from consumers.standings(clock, self.next_seq))

    def consumer_places(self, now: int) -> list[ConsumerPlace]:
        """The places that were taken, as values: what moves with the channel."""
        run_to_end(self.catching_up(now))
        clock = self._settle(self._tick(now))
        consumers = self._retention.consumers
        return [] if consumers is None else consumers.places(clock, self.next_seq)

    def restore_consumers(self, places: Iterable[ConsumerPlace], now: int) -> None:
        """Take over the places that `consumer_places` told elsewhere. Without consumers= nothing."""
        run_to_end(self.catching_up(now))
        clock = self._settle(self._tick(now))
        if self._retention.consumers is not None:
            self._retention.consumers.restore(places, clock)
            self._settle(clock)

    def collect(self, now: int, entries_max: int = 128) -> bool:
        """Free memory of outdated items, a bounded part; True if more is left. Puts and reads do a little of it too."""
        self._settle(self._tick(now))
        knows_less = self._retention.learn_gone(entries_max // 2)  # which takes longer
        self._retention.ask_on()
        return self._held.free(entries_max) or knows_less or self._retention.has_more

    def emptying(self) -> Pieces[None]:
        """Let go of all items, in pieces: the channel is not used any more, and is no good afterwards."""
        self._held.tell(None)
        self._held.outdate(self._held.front_of_items(self._held.items), COUNT, self._clock or 0)
        while self._held.free(pieces.STEPS_PER_PIECE):
            yield

    def next_deadline(self, now: int) -> int | None:
        """When `collect` is next useful: now, if memory is left to free; else when time takes items; None: never."""
        clock = self._settle(self._tick(now))
        due = self._retention.next_due()
        return clock if self._held.has_backlog or self._retention.has_more else due

    def counters(self, now: int) -> Counters:
        """Counts of all items by what became of them, at this moment."""
        self._settle(self._tick(now))
        held = self._held
        return Counters(
            accepted=held.accepted,
            held=held.items,
            collected=dict(held.collected),
            rejected=dict(self._acceptance.rejected),
            accepted_bytes=held.accepted_bytes,
            held_bytes=held.payload_bytes,
        )

    def look(self, now: int) -> tuple[Holdings, Retention]:
        """The held items, aged to `now`, and their limits. Views of the channel read them and do not change them."""
        self._settle(self._tick(now))
        return self._held, self._retention

    def moment(self, now: int) -> Moment:
        """The channel as it is now, to be read later. Close it soon: nothing that it shows is freed before."""
        held, retention = self.look(now)
        return Moment(held, retention, self._incarnation, self.lost_before, self.advanced_to, self._tick(now))

    @property
    def footprint_bytes(self) -> int:
        """The memory that the channel keeps, as of the last call: whole runs, and items that are not freed yet."""
        return self._held.footprint_bytes

    @property
    def freed_entries(self) -> int:
        """How many entries of the index were freed so far: a measure of the work that was done."""
        return self._held.freed_entries

    @property
    def policy(self) -> Policy:
        """The policy as stated."""
        return self._policy

    @property
    def incarnation(self) -> int:
        """Which life of the channel the seqs belong to."""
        return self._incarnation

    @property
    def next_seq(self) -> int:
        """The seq that the next accepted item gets."""
        return self._held.next_seq

    @property
    def newest(self) -> int | None:
        """The newest item's time, as of the last call that took `now`."""
        return self._held.newest

    @property
    def oldest(self) -> int | None:
        """The oldest held item's time, as of the last call that took `now`."""
        self._age()
        return self._held.oldest

    @property
    def frontier(self) -> int | None:
        """The latest span end that age, count or bytes have collected, not above the oldest held item's time."""
        self._age()
        return self._held.frontier

    @property
    def advanced_to(self) -> int | None:
        """The highest promise that nothing earlier will come."""
        return self._acceptance.advance

    def _tick(self, now: int) -> int:
        self._clock = now if self._clock is None else max(self._clock, now)
        return self._clock

    def _age(self) -> None:
        """As of the last call; what was settled at that time already is left as it is."""
        if self._clock is not None and (self._puts_unsettled or self._settled != self._clock):
            self._retention.apply_time(self._clock)

    def _settle(self, clock: int) -> int:
        """Let go what time has outdated, and free a little."""
        self._puts_unsettled, self._settled = 0, clock
        if self._retention.consumers is None:
            self._retention.age_out(clock)
        else:
            self._retention.apply_time(clock)
            self._reading.consumed_up_to = self._held.newest_consumed
        self._held.free(FREED_ENTRIES_PER_CALL)
        return clock

    def _settle_puts(self, clock: int) -> None:
        """Keep the limits after puts. Freeing keeps pace with them, and outdated items never exceed max_bytes."""
        self._settle(clock)
        self._retention.drop_excess(clock)
        self._held.free(self._entries_to_free, self._retention.limits.max_bytes)
        self._entries_to_free = 0

    def _check_positions(self, query: Query) -> None:
        self._reading.check_position(query.after)
        self._reading.check_position(query.newer_than)

    def _check_saved(self, saved: SavedCursor) -> None:
        if saved.cut is not None:
            raise InvalidArgument("the cursor comes from a subscription through a group; name that group")
        self._reading.check_position(Position(0, None, saved.incarnation))

    def _resume_key(self, start: Bound | None, after: Position | None) -> ItemKey | None:
        if after is None:
            return None
        self._reading.check_position(after)
        if start is not None:
            raise InvalidArgument("a subscription has both start and after; give start to begin, after to resume")
        if after.seq is None:
            raise InvalidArgument(
                "a subscription resumes after an item, but the position has no seq; use start instead"
            )
        return after.time, after.seq

    def _start_key(self, start: Bound | None, exclusive: bool, now: int) -> ItemKey | None:
        """Where a subscription's held items begin; None if it wants none, or an empty channel cannot tell."""
        clock = self._settle(self._tick(now))
        time = None if start is None else self._reading.resolve_bound(start, clock)
        return None if time is None else (time, SEQ_END if exclusive else 0)
