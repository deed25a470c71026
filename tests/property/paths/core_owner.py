"""A channel of the core, with its waiting puts, gets and subscriptions, served as `core.channel` demands."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import stampede_rt as st
from stampede_rt.values.model import Policy
from stampede_rt_channel_host.core.channel import (
    AllCursor,
    ChannelCore,
    NewestCursor,
    PendingGet,
    Query,
    ReadAnswer,
    Slice,
    WakeAt,
)
from stampede_rt_channel_host.core.channel.values import NO_NEXT_TIMES
from stampede_rt_channel_host.core.dedup import RetryWindow
from tests.property.channel_pair import INCARNATION, ends_as_read, items_of
from tests.property.paths.core_calls import Call, WaitingPut, ack_of
from tests.property.paths.values import FollowedItems, Run

DELIVERED_BYTES_MAX = 300


class CoreOwner:
    """Serves one channel. `now` reads the host's clock. After each change of the clock call `time_has_passed`."""

    def __init__(self, name: str, policy: Policy, now: Callable[[], int]) -> None:
        self.policy = policy
        self.channel = ChannelCore(policy, incarnation=INCARNATION, name=name)
        self.gets: dict[Call, tuple[PendingGet, int | None]] = {}
        self.line: list[WaitingPut] = []
        self.followers: list[CoreSubscription] = []
        self._now = now
        self._payloads: dict[int, bytes] = {}
        self._retries = RetryWindow()

    # --- puts

    def put(self, run: Run) -> Call:
        """Put a run: the channel judges it, recognises it as a repetition, or lets it wait in line."""
        call = Call(lambda: self._give_up_put(put))
        put = WaitingPut(run, call)
        try:
            if not self._is_known(put) and (self.line or not self._offer(put)):
                self.line.append(put)
        except st.StampedeError as error:
            call.finish(error)
        self._deliver_all()
        return call

    def _is_known(self, put: WaitingPut) -> bool:
        run = put.run
        known = self._retries.find(run.producer_id, run.first_number, len(run.payloads), self._now())
        if known is None:
            return False
        put.resume(known, self._now())
        if known.is_whole:
            put.call.finish(ack_of(known))
        return known.is_whole

    def _offer(self, put: WaitingPut) -> bool:
        def seal(first_seq: int, kept: Sequence[int] | None, stamped_time: int | None) -> bytes:
            positions = range(len(put.payloads)) if kept is None else kept
            for seq, position in enumerate(positions, first_seq):
                self._payloads[seq] = put.payloads[position]
            put.progress.accept(put.progress.judged_items + positions[0], first_seq, len(positions), stamped_time)
            return b""

        outcome = self.channel.put(put.offer, self._now(), seal)
        is_done = put.take_outcome(outcome, self._now())
        if is_done:
            self._finish(put)
        elif outcome.run is not None:
            self._remember(put)
        if outcome.run is not None:
            self._announce()
        return is_done

    def _finish(self, put: WaitingPut) -> None:
        self._remember(put)
        put.call.finish(ack_of(put.progress.outcome(self._now())))

    def _remember(self, put: WaitingPut) -> None:
        self._retries.record(put.run.producer_id, put.run.first_number, put.progress.outcome(self._now()))

    def _give_up_put(self, put: WaitingPut) -> None:
        self.line.remove(put)
        self._refuse_rest(put)
        self._advance_line()

    def _refuse_rest(self, put: WaitingPut) -> None:
        put.take_outcome(self.channel.give_up_put(put.offer), self._now())
        self._finish(put)

    def withdraw(self, run: Run) -> None:
        """End the wait of a run. Its accepted items are remembered, because its producer may send it again."""
        (put,) = [one for one in self.line if one.run is run][:1]
        self.line.remove(put)
        self._remember(put)
        self._advance_line()

    def _advance_line(self) -> None:
        while self.line and self._is_done(self.line[0]):
            self.line.pop(0)
        self._deliver_all()

    def _is_done(self, put: WaitingPut) -> bool:
        try:
            return self._is_known(put) or self._offer(put)
        except st.StampedeError as error:  # the run overlaps a run that the channel has accepted meanwhile
            put.call.finish(error)
            return True

    # --- gets

    def read(self, query: Query, payloads: bool) -> st.Items:
        return self._items(self.channel.read(query, self._now()), query, payloads)

    def get(self, query: Query, payloads: bool) -> Call:
        """Begin a blocking get."""
        pending = self.channel.begin(query, self._now())
        call = Call(lambda: self._give_up_get(call))
        call.then(lambda answer: self._items(answer, query, payloads))
        self.gets[call] = pending, None
        self._poll(call)
        return call

    def _poll(self, call: Call) -> None:
        pending, _ = self.gets[call]
        found = self.channel.poll(pending, self._now())
        if isinstance(found, WakeAt):
            self.gets[call] = pending, found.instant
        else:
            del self.gets[call]
            call.finish(found)

    def _give_up_get(self, call: Call) -> None:
        pending, _ = self.gets.pop(call)
        call.finish(self.channel.give_up(pending, self._now()))

    def _items(self, answer: ReadAnswer, query: Query, payloads: bool) -> st.Items:
        items = self._decode(answer.slices, answer.next_time, answer.next_times)
        if not payloads:
            items = [one._replace(payload=None) for one in items]
        return st.Items(
            items[::-1] if query.newest_first else items,
            interval=answer.interval,
            complete=answer.complete,
            truncated=answer.truncated,
            more=answer.more,
            reason=answer.reason,
            incarnation=answer.incarnation,
        )

    def _decode(
        self, slices: Sequence[Slice], next_time: int | None, next_times: Mapping[tuple[int, int], int] = NO_NEXT_TIMES
    ) -> list[st.Item]:
        items = items_of(slices)
        ends = ends_as_read(items, next_time, self.policy.overlap_nanos or 0, next_times)
        return [
            st.Item(one.time, end, one.duration, one.seq, self._payloads[one.seq], {}, "", one.length, INCARNATION)
            for one, end in zip(items, ends, strict=True)
        ]

    # --- subscriptions

    def follow(self, cursor: AllCursor | NewestCursor) -> CoreSubscription:
        """Begin a subscription that gets items as they come."""
        subscription = CoreSubscription(self, cursor)
        self.followers.append(subscription)
        self._deliver(subscription)
        return subscription

    def _deliver_all(self) -> None:
        """Deliver to all subscriptions, after all other work of an event, as a host's writers do."""
        for subscription in self.followers:
            self._deliver(subscription)

    def _deliver(self, subscription: CoreSubscription) -> None:
        cursor, followed = subscription.cursor, subscription.followed
        if isinstance(cursor, NewestCursor):
            newest = self.channel.latest(cursor, self._now())
            if newest is not None:
                followed.items += self._decode([newest.slice], newest.next_time)
            return
        while not (part := self.channel.since(cursor, self._now(), DELIVERED_BYTES_MAX)).is_empty:
            for delivered in part.slices:
                followed.items += self._decode([delivered.slice], delivered.next_time)

    # --- changes

    def advance(self, instant: int) -> int:
        highest = self.channel.advance(instant, self._now())
        self._changed()
        return highest

    def configure(self, policy: Policy) -> None:
        self.channel.configure(policy, self._now())
        self.policy = policy
        self._changed()

    def consume(self, consumer_id: int, seqs: Sequence[int], lease_nanos: int) -> tuple[int, int]:
        consumed = self.channel.consume(consumer_id, seqs, self._now(), lease_nanos=lease_nanos)
        self._advance_line()
        return consumed.items, consumed.lease_nanos

    def time_has_passed(self) -> None:
        """Poll only the gets and puts whose instant has come."""
        now = self._now()
        for call, (_, instant) in list(self.gets.items()):
            if instant is not None and instant <= now:
                self._poll(call)
        if self.line and self.line[0].retry_at is not None and self.line[0].retry_at <= now:
            self._advance_line()

    def end(self, error: st.StampedeError) -> None:
        """End all gets and waiting puts with `error`."""
        for call in self.gets:
            call.finish(error)
        for put in self.line:
            put.fail(error, self._now())

    def _changed(self) -> None:
        self._announce()
        self._advance_line()

    def _announce(self) -> None:
        for call in list(self.gets):
            self._poll(call)


class CoreSubscription:
    """A subscription to the channel. `followed` collects its items."""

    def __init__(self, owner: CoreOwner, cursor: AllCursor | NewestCursor) -> None:
        self.cursor = cursor
        self.followed = FollowedItems()
        self.followed.subscription = self
        self._owner = owner

    @property
    def dropped(self) -> int:
        return self.cursor.dropped if isinstance(self.cursor, AllCursor) else 0

    def close(self) -> None:
        self._owner.followers.remove(self)
