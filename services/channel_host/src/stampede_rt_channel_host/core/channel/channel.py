"""One channel: puts, reads, subscriptions and consumption, over values and `now` (paper, sections 3.1 to 3.4). Pure."""

from __future__ import annotations

from collections.abc import Iterable

from stampede_rt.errors import InFuture, InvalidArgument
from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Bound, format_duration
from stampede_rt_channel_host.core.channel.base_channel import FREED_ENTRIES_PER_CALL
from stampede_rt_channel_host.core.channel.consumed_channel import ConsumedChannel
from stampede_rt_channel_host.core.channel.former_incarnations import FormerIncarnation
from stampede_rt_channel_host.core.channel.item_keys import SEQ_END, ItemKey
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.channel.pieces import Pieces, run_to_end
from stampede_rt_channel_host.core.channel.reading import PendingGet
from stampede_rt_channel_host.core.channel.subscribing import (
    AllCursor,
    missing_from,
    open_all,
    resume_all,
    since,
)
from stampede_rt_channel_host.core.channel.subscribing_newest import NewestCursor, open_newest, resume_newest
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
"""A late item changes at most this many index entries: its own entry, and the two parts of the entry that it splits."""

PUTS_PER_AGING = 16
"""A put into a channel that is below its other limits does not apply the age limit.

The next read applies it, or the sixteenth such put. A channel that counts consumption applies it at each put.
"""


class ChannelCore(ConsumedChannel):
    """The items of one channel, in memory. Not thread-safe. Each call is atomic and never waits.

    The caller is the shell of channels. It passes `now`, the host's clock (`HostTime`) in nanoseconds since the epoch,
    to every call. A `now` before the latest one counts as the latest. After each put, advance and configure the caller
    polls its blocked gets, offers waiting puts again and serves its subscriptions. After each consume it offers waiting
    puts again. Seqs start at 1.
    """

    def put(self, offer: Offer, now: int, seal: Seal) -> PutOutcome:
        """Accept or refuse each item of `offer`, in order, and store the accepted items as a run.

        The result is the same as if each item had a put of its own, all at one instant. If the channel accepts any
        item, it calls `seal` once. The channel neither changes nor keeps the offer. PutOutcome says which items have to
        wait. Until the channel has judged these items, the caller offers no later put, so that a run has consecutive
        seqs.
        """
        clock, counts_consumption = self._tick(now), self._retention.consumers is not None
        if counts_consumption:
            self._age_and_free(clock)
        outcome = self._acceptance.put(offer, clock, seal)
        self._puts_since_aging += 1
        self._entries_to_free += ENTRIES_PER_ITEM_MAX * len(offer.lengths)
        if self._puts_since_aging >= PUTS_PER_AGING or counts_consumption or not self._retention.has_room(0, 0):
            self._apply_limits_after_puts(clock)
        return outcome

    def give_up_put(self, offer: Offer) -> PutOutcome:
        """Refuse items whose wait for room is over, each with ChannelFull, and count them."""
        full = self._acceptance.full()
        rejections: list[Rejection] = [self._acceptance.refuse(index, full) for index in range(len(offer.lengths))]
        return PutOutcome(rejections=rejections)

    def reject_malformed(self, items: int) -> None:
        """Count items that the caller refused before they became an offer."""
        self._acceptance.count_rejected("MALFORMED_RUN", items)

    def reject_overloaded(self, items: int) -> None:
        """Count items that the caller refused because a limit of the host is reached."""
        self._acceptance.count_rejected("OVERLOADED", items)

    def read(self, query: Query, now: int) -> ReadAnswer:
        """The held items that the query selects. Changes nothing that another reader could see.

        Raises IncarnationLost if a position comes from another incarnation.
        """
        return run_to_end(self.reading(query, now))

    def reading(self, query: Query, now: int) -> Pieces[ReadAnswer]:
        """Like `read`, but in pieces. The answer is as of `now`."""
        self.check_positions(query)
        clock = self._age_and_free(self._tick(now))
        return self._reading.answer(query, self._reading.resolve(query, clock), clock)

    def at(self, time: int, now: int) -> ReadAnswer | None:
        """The answer to a read at an instant, if one item is all of it; None: `read` finds it."""
        return self._reading.at(time, self._age_and_free(self._tick(now)))

    def begin(self, query: Query, now: int) -> PendingGet:
        """Begin a blocking get. The caller calls `poll` right afterwards.

        Resolves the meta-times of the interval now. If they need an item and the channel has none, the first poll with
        an item resolves them. Raises IncarnationLost if a position comes from another incarnation.
        """
        self.check_positions(query)
        clock = self._age_and_free(self._tick(now))
        return PendingGet(query, self._reading.resolve(query, clock))

    def poll(self, pending: PendingGet, now: int) -> ReadAnswer | WakeAt:
        """The blocking get's answer, or when to poll again.

        Without `complete` the first matching item ends the wait. In any case the wait ends when no more items can come
        into the interval: an item or an advance has passed its end, or it is empty or below the frontier.
        """
        return run_to_end(self.polling(pending, now))

    def polling(self, pending: PendingGet, now: int) -> Pieces[ReadAnswer | WakeAt]:
        """Like `poll`, but in pieces. The result is as of `now`."""
        clock = self._age_and_free(self._tick(now))
        found = yield from self._reading.poll(pending, clock)
        return WakeAt(found.instant, self._reading.needs(pending)) if isinstance(found, WakeAt) else found

    def give_up(self, pending: PendingGet, now: int) -> ReadAnswer:
        """The answer when the get's waiting time is over. Its reason says why the answer is empty or partial."""
        return run_to_end(self.giving_up(pending, now))

    def giving_up(self, pending: PendingGet, now: int) -> Pieces[ReadAnswer]:
        """Like `give_up`, but in pieces. The answer is as of `now`."""
        clock = self._age_and_free(self._tick(now))
        return self._reading.answer(pending.query, pending.interval, clock)

    def subscribe_all(
        self, now: int, *, start: Bound | None = None, start_exclusive: bool = False, after: Position | None = None,
        saved: SavedCursor | None = None,
    ) -> AllCursor:  # fmt: skip
        """Begin a subscription in seq order, or continue a saved one.

        With `start` the subscription has the held items from that bound on, or with `start_exclusive` the held items
        later than that bound, and then all new items. With `after` it has all items accepted after that position, which
        must have a seq. With `saved` it continues from that cursor, and ignores the other arguments. Without any of
        them it has only new items. Raises InvalidArgument for `start` together with `after`, for `after` without a seq,
        and for a cursor that comes from a group. Raises IncarnationLost if `after` or `saved` is of another
        incarnation.
        """
        return run_to_end(
            self.subscribing_all(now, start=start, start_exclusive=start_exclusive, after=after, saved=saved)
        )

    def subscribing_all(
        self, now: int, *, start: Bound | None = None, start_exclusive: bool = False, after: Position | None = None,
        saved: SavedCursor | None = None, archived_from: int | None = None, lost_at: Iterable[int] = (),
    ) -> Pieces[AllCursor]:  # fmt: skip
        """Like `subscribe_all`, but in pieces. The cursor is as of `now`. `archived_from`: see `open_all`.

        `lost_at`: the first seqs of owners that followed a lost one. Beginning at `start` or `saved`, the reader has
        not learned of these losses yet.
        """
        archived = tuple(FormerIncarnation(self.incarnation, seq) for seq in lost_at)
        if saved is not None:
            self._check_saved(saved)
            self._age_and_free(self._tick(now))
            is_present = saved.incarnation == self.incarnation
            losses = archived if is_present else self._losses_since(saved.incarnation)
            return resume_all(self._held, saved, losses, is_present=is_present)
        after_key = self._resume_key(start, after)
        low = self._start_key(start, start_exclusive, now)
        after_seq = None if after_key is None else after_key[1]
        losses = archived if after is None else self._losses_since(after.incarnation)
        return open_all(self._held, low, after_seq, archived_from, losses)

    def missing(self, cursor: AllCursor, now: int) -> tuple[int, int] | None:
        """The next seqs of a subscription if memory does not have them: the first one, and the end, exclusive."""
        self._age_and_free(self._tick(now))
        return missing_from(self._held, cursor)

    def since(self, cursor: AllCursor, now: int, limit_bytes: int, *, joins: bool = False) -> SubscriptionBatch:
        """Take the next part of a subscription, and move the cursor.

        The part has about `limit_bytes`, counted as payload and ITEM_OVERHEAD_BYTES for each item, and at least one
        item if there is one. If retention collected items before the reader took them, a gap reports each of them once.
        `joins`: the reader is a copy of the channel (see `_joined` in `subscribing`).
        """
        self._age_and_free(self._tick(now))
        return since(self._held, self._retention.limits, cursor, limit_bytes, joins=joins)

    def subscribe_newest(
        self, now: int, *, start: Bound | None = None, start_exclusive: bool = False, after: Position | None = None,
        saved: SavedCursor | None = None,
    ) -> NewestCursor:  # fmt: skip
        """Begin a subscription to the latest item.

        With `start` the newest held item comes first, unless it is earlier than `start`. With `after` or `saved` the
        newest held item comes first if it is later than that position or cursor. Otherwise the first item of the
        subscription is the next one that is later than all held items. Raises the errors of `subscribe_all`.
        """
        if saved is not None:
            self._check_saved(saved)
            self._age_and_free(self._tick(now))
            return resume_newest(self._held, saved, self._losses_since(saved.incarnation))
        after_key = self._resume_key(start, after)
        return open_newest(self._held, self._start_key(start, start_exclusive, now), after_key)

    def latest(self, cursor: NewestCursor, now: int) -> DeliveredSlice | None:
        """Take the newest item if it is later than the last item taken; otherwise return None.

        Moves the cursor and counts the skipped items.
        """
        self._age_and_free(self._tick(now))
        return cursor.take(self._held)

    def advance(self, instant: int, now: int) -> int:
        """Note a producer's promise that no item before `instant` will come. Returns the highest promise so far.

        Raises InFuture if `instant` is more than max_future ahead of the host's clock.
        """
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
        """Replace the whole policy. Collects the items that the new policy outdates.

        Raises InvalidArgument if the policy is not possible, and then changes nothing. If the new policy has fewer
        places than consumers have taken, the channel removes the places with the earliest lease ends.
        """
        limits = ChannelLimits.of(policy)
        clock = self._age_and_free(self._tick(now))
        self._policy = policy
        self._retention.set_limits(limits)
        self._age_and_free(clock)
        self._retention.drop_excess(clock)

    def _apply_limits_after_puts(self, clock: int) -> None:
        """Apply the limits after puts, and free as many entries as these puts may have added.

        Frees more entries while the outdated items are charged with more than max_bytes.
        """
        self._outdate(clock)
        self._retention.drop_excess(clock)
        self._held.free(FREED_ENTRIES_PER_CALL + self._entries_to_free, self._retention.limits.max_bytes)
        self._entries_to_free = 0

    def check_positions(self, query: Query) -> None:
        """Raises IncarnationLost if a position of the query comes from another incarnation."""
        self._reading.check_position(query.after)
        self._reading.check_position(query.newer_than)

    def _losses_since(self, incarnation: int) -> tuple[FormerIncarnation, ...]:
        return self.losses.from_incarnation(incarnation) if self._reading.former else ()

    def _check_saved(self, saved: SavedCursor) -> None:
        if saved.cut is not None:
            raise InvalidArgument("the cursor comes from a subscription through a group; name that group")
        self._reading.check_position(Position(0, None, saved.incarnation))

    def _resume_key(self, start: Bound | None, after: Position | None) -> ItemKey | None:
        """The key of the position `after`. Raises an error if a subscription cannot begin there."""
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
        """The key at which a subscription's held items begin.

        Returns None if the subscription has no held items: without `start`, or if `start` is a meta-time that the empty
        channel cannot resolve.
        """
        clock = self._age_and_free(self._tick(now))
        time = None if start is None else self._reading.resolve_bound(start, clock)
        return None if time is None else (time, SEQ_END if exclusive else 0)
