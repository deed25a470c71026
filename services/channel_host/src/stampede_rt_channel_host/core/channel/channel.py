"""One channel: puts, reads, subscriptions and consumption over values and `now` (paper, sections 3.1 to 3.4). Pure."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

from stampede_rt.errors import InFuture, InvalidArgument
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Bound, format_duration
from stampede_rt_channel_host.core.channel import pieces
from stampede_rt_channel_host.core.channel.aged_channel import AgedChannel
from stampede_rt_channel_host.core.channel.consumption import (
    LEASE_NANOS,
    Consumed,
    ConsumerPlace,
    ConsumerStanding,
    check_consumption,
)
from stampede_rt_channel_host.core.channel.index import SEQ_END, ItemKey
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.channel.pieces import Pieces, run_to_end
from stampede_rt_channel_host.core.channel.reading import Pending
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

ENTRIES_PER_ITEM_MAX = 3
"""A late item makes at most so many entries of the index: its own, and the two ends of the one that it splits."""

PUTS_PER_SETTLING = 16
"""Puts that change nothing but the newest end leave ageing to the next read, or to every so many puts."""


class ChannelCore(AgedChannel):
    """The items of one channel, in memory. Not thread-safe: one owner calls it, each call is atomic and never blocks.

    Every call takes `now`, the host's clock (`HostTime`), in nanoseconds since the epoch; an earlier one than before
    counts as the latest seen. After each put, advance and configure the owner polls its blocked gets, offers waiting
    puts again and looks after its subscriptions; after each consume it offers waiting puts again. Seqs start at 1.
    """

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
