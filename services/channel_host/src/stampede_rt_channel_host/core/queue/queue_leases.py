"""Gives and ends the leases of a queue's messages (paper, section 3.5). Pure.

Only acknowledgements consume a message. A message that is given back, or whose lease ends, returns to its former
position in the queue.
"""

from __future__ import annotations

from bisect import insort
from collections.abc import Iterable
from itertools import islice

from stampede_rt.errors import LeaseExpired
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.deadlines import Deadlines
from stampede_rt_channel_host.core.queue.acknowledged_deliveries import AcknowledgedDeliveries, AcknowledgedDelivery
from stampede_rt_channel_host.core.queue.chunked_map import ChunkedMap
from stampede_rt_channel_host.core.queue.items import (
    GIVEN_BACK,
    LEASE_EXPIRED,
    TERMINATED,
    FailedDelivery,
    TrackedItem,
)
from stampede_rt_channel_host.core.queue.queue_items import QueueItems
from stampede_rt_channel_host.core.queue.takers import TakerState
from stampede_rt_channel_host.core.queue.values import (
    Acknowledge,
    Extend,
    GiveBack,
    LeasedSlice,
    PendingDelivery,
    Settlement,
    SettlementResult,
    Terminate,
)


class Lease:
    """One delivery. The taker has a copy of `item` until `due`. `number` counts the deliveries of that copy, from 1.

    `order` is the delivery id.
    """

    __slots__ = ("due", "item", "leased_at", "number", "order", "taker")

    def __init__(self, delivery_id: int, item: TrackedItem, number: int, taker: TakerState, leased_at: int) -> None:
        self.order = delivery_id
        self.item = item
        self.number = number
        self.taker = taker
        self.leased_at = leased_at
        self.due: int | None = None

    def as_failed(self, ended: str, reason: str = "") -> FailedDelivery:
        """This delivery as a failed delivery. `ended` is the way in which it failed."""
        return FailedDelivery(self.number, self.taker.taker_id, self.taker.name, ended, reason)


class QueueLeases:
    """All leases of a queue. Delivery ids start at `first_delivery_id`, and each delivery has the next one.

    The `due` of a lease, and the deadlines, leave out the times in which no host served the queue; see `end_of`.
    """

    def __init__(self, queue_items: QueueItems, queue_name: str, first_delivery_id: int) -> None:
        self._queue_items = queue_items
        self._queue = queue_name
        self._deadlines: Deadlines[Lease] = Deadlines()
        self._unserved_nanos = 0  # the times in which no host served the queue
        self._unnoted_from: int | None = None  # the next delivery id for `note_some`; None: all leases are noted
        self.leases: ChunkedMap[Lease] = ChunkedMap()  # by delivery id
        # The takers that let a lease end, and have sent nothing since that lease began. The caller empties the list.
        self.silent: list[TakerState] = []
        self.next_delivery_id = first_delivery_id
        self.acknowledged = AcknowledgedDeliveries()

    def deliver(self, item: TrackedItem, taker: TakerState, now: int, expires: int) -> tuple[int, int]:
        """Lease a free copy of the message. Returns the delivery's id and its number among the copy's deliveries.

        Of the copies that takers returned, the one that was delivered most often is delivered first. So a message that
        no taker can process reaches max_deliveries soon.
        """
        number = 1 + (item.returned.pop() if item.returned else 0)
        delivery_id = self.next_delivery_id
        self.next_delivery_id += 1
        self.enter(Lease(delivery_id, item, number, taker, now), expires)
        self._queue_items.refresh(item)
        self._queue_items.tally.delivered += 1
        return delivery_id, number

    def enter(self, lease: Lease, expires: int) -> None:
        """Add a lease that ends at `expires`."""
        self._queue_items.leased += not lease.item.leases
        lease.item.leases[lease.taker.taker_id] = lease.order
        self.leases[lease.order] = lease
        self._deadlines.set_due(lease, expires - self._unserved_nanos)
        self._queue_items.note_change(lease.item, lease.order)

    def settle(self, taker_id: int, settlement: Settlement, now: int) -> SettlementResult:
        """Perform a taker's settlement of a delivery.

        The result has an error if the taker does not have the lease any more. A repeated acknowledgement succeeds.
        """
        delivery_id, verdict = settlement
        lease = self.leases.get(delivery_id)
        if lease is None or lease.taker.taker_id != taker_id or self.end_of(lease) <= now:
            repeated = isinstance(verdict, Acknowledge) and self.acknowledged.knows(delivery_id, taker_id, now)
            return SettlementResult(delivery_id, None if repeated else self._stale(delivery_id))
        lease.taker.last_request_at = now
        if isinstance(verdict, Acknowledge):
            self._acknowledge(lease, now)
        elif isinstance(verdict, GiveBack):
            self._queue_items.tally.given_back += 1
            lease.number -= verdict.uncounted
            ended = None if verdict.uncounted else GIVEN_BACK
            self._take_back(lease, ended, now + verdict.delay_nanos if verdict.delay_nanos else None)
        elif isinstance(verdict, Terminate):
            self._terminate(lease, verdict.reason)
        else:
            return self._extend(lease, verdict, now)
        return SettlementResult(delivery_id)

    def expire_one(self, now: int) -> bool:
        """Take back the message of the lease that ended first. Returns False if no lease has ended."""
        lease = self._deadlines.pop(now - self._unserved_nanos)
        if lease is None:
            return False
        self._queue_items.tally.leases_expired += 1
        taker = lease.taker
        if taker.credit and not taker.is_silent and taker.last_request_at <= lease.leased_at:
            taker.is_silent = True
            self.silent.append(taker)
        self._take_back(lease, LEASE_EXPIRED)
        return True

    def pending(self, after_delivery_id: int, limit: int) -> list[PendingDelivery]:
        """The leases with delivery ids above `after_delivery_id`, in the order of the ids, at most `limit`."""
        return [
            _pending(lease, self.end_of(lease)) for lease in islice(self.leases.values(after_delivery_id + 1), limit)
        ]

    def next_deadline(self) -> int | None:
        """The time of the next lease end, or None if there is no lease."""
        due = self._deadlines.next()
        return None if due is None else due + self._unserved_nanos

    def end_of(self, lease: Lease) -> int:
        """The time at which the lease ends."""
        return (lease.due or 0) + self._unserved_nanos

    def recall(self, slices: Iterable[LeasedSlice]) -> None:
        """Take back deliveries that the host has not begun to send, as if the taker had not got them."""
        for one in slices:
            for delivery_id in one.delivery_ids:
                lease = self.leases.get(delivery_id)
                if lease is not None:
                    self._queue_items.tally.delivered -= 1
                    self._end(lease)
                    if lease.number > 1:
                        insort(lease.item.returned, lease.number - 1)
                    if self.is_exhausted(lease.item):  # the limit may have been lowered meanwhile
                        self.give_up(lease.item)
                    else:
                        self._put_back(lease.item)

    def settle_copies(self, item: TrackedItem) -> bool:
        """Remove the message as consumed if enough takers have acknowledged it. Returns True if it was removed."""
        if len(item.acknowledged) < self._queue_items.limits.copies:
            return False
        self.void(item)
        self._queue_items.tally.consumed += 1
        self._queue_items.remove(item)
        return True

    def check_again(self, item: TrackedItem) -> None:
        """Apply the present limits to a tracked message, after the limits have changed."""
        if item.is_leaving and not self._queue_items.limits.dead_letters:
            self.expel(item)
        elif not self.settle_copies(item):
            if self.is_exhausted(item) and not item.is_leaving:
                self.give_up(item)
            else:
                self._put_back(item)

    def is_exhausted(self, item: TrackedItem) -> bool:
        """Whether the queue has delivered one of the returned copies as often as the limit allows."""
        most = self._queue_items.limits.max_deliveries
        return most is not None and bool(item.returned) and item.returned[-1] >= most

    def give_up(self, item: TrackedItem) -> None:
        """End the leases of the message. Let it move to the dead-letter queue or, if there is none, remove it."""
        if self._queue_items.limits.dead_letters:
            self.void(item)
            self._queue_items.set_leaving(item)
        else:
            self.expel(item)

    def expel(self, item: TrackedItem) -> None:
        """End the leases of the message and remove it, without a move to a dead-letter queue."""
        self.void(item)
        self._queue_items.tally.expelled += 1
        self._queue_items.remove(item)

    def _acknowledge(self, lease: Lease, now: int) -> None:
        item = lease.item
        self._end(lease)
        item.acknowledged = (*item.acknowledged, lease.taker.taker_id)
        self.acknowledged.record(lease.order, lease.taker.taker_id, now)
        if self._queue_items.changes is not None:
            self._queue_items.changes.acknowledged.append(AcknowledgedDelivery(lease.order, lease.taker.taker_id, now))
        if not self.settle_copies(item):
            self._queue_items.refresh(item)

    def _extend(self, lease: Lease, verdict: Extend, now: int) -> SettlementResult:
        self._deadlines.set_due(lease, now + verdict.lease_nanos - self._unserved_nanos)
        self._queue_items.note_change(lease.item, lease.order)
        return SettlementResult(lease.order, None, verdict.lease_nanos)

    def _terminate(self, lease: Lease, reason: str) -> None:
        """End the lease as the taker asked, and give the message up."""
        self._queue_items.tally.terminated += 1
        self._end(lease)
        lease.item.last = lease.as_failed(TERMINATED, reason)
        self.give_up(lease.item)

    def _take_back(self, lease: Lease, ended: str | None, not_before: int | None = None) -> None:
        """End a delivery that failed as `ended` says, or that does not count if `ended` is None.

        If max_deliveries is reached, gives the message up. Otherwise the message is not delivered again before
        `not_before`.
        """
        item = lease.item
        self._end(lease)
        if lease.number:
            insort(item.returned, lease.number)
        if ended is not None:
            item.last = lease.as_failed(ended)
        if self.is_exhausted(item):
            self.give_up(item)
            return
        if not_before is not None and (item.due is None or item.due < not_before):
            self._queue_items.delays.set_due(item, not_before)
        self._put_back(item)

    def _put_back(self, item: TrackedItem) -> None:
        """Make a message whose lease has ended available to takers again, unless the queue holds it back."""
        self._queue_items.refresh(item)
        self._queue_items.log_return(item)

    def postpone(self, nanos: int) -> None:
        """Let all leases last `nanos` longer, because no host has served the queue for this time.

        The copies learn this by `note_some`.
        """
        self._unserved_nanos += nanos
        self._unnoted_from = 0

    @property
    def has_unnoted(self) -> bool:
        """Whether `note_some` has more to do."""
        return self._unnoted_from is not None

    def note_some(self, limit: int) -> None:
        """Note the ends of at most `limit` leases as changes, after `postpone`."""
        if self._unnoted_from is None:
            return
        leases = [*islice(self.leases.values(self._unnoted_from), limit)]
        for lease in leases:
            self._queue_items.note_change(lease.item, lease.order)
        self._unnoted_from = leases[-1].order + 1 if len(leases) == limit else None

    def emptying(self) -> Pieces[None]:
        """Free the entries of the deadlines, which also keep ended leases, in pieces. The caller must not use this
        object any more.
        """
        yield from self._deadlines.emptying()

    def void(self, item: TrackedItem) -> None:
        """End all leases of the message."""
        for delivery_id in list(item.leases.values()):
            self._end(self.leases[delivery_id])

    def end(self, delivery_ids: Iterable[int]) -> None:
        """End the leases of these deliveries, if there are any."""
        for delivery_id in delivery_ids:
            lease = self.leases.get(delivery_id)
            if lease is not None:
                self._end(lease)

    def _end(self, lease: Lease) -> None:
        """Remove a lease."""
        del self.leases[lease.order], lease.item.leases[lease.taker.taker_id]
        self._queue_items.leased -= not lease.item.leases
        self._deadlines.disarm(lease)
        self._queue_items.note_change(lease.item, lease.order)

    def _stale(self, delivery_id: int) -> LeaseExpired:
        """The error of a settlement of a delivery that the taker does not have any more."""
        return LeaseExpired(
            f"delivery {delivery_id} of {self._queue} is not leased to this taker now: its lease has ended, or "
            "it was settled; the message may have gone to another taker: settle sooner, extend, or lease for longer"
        )


def _pending(lease: Lease, expires: int) -> PendingDelivery:
    taker = lease.taker
    return PendingDelivery(
        lease.order, lease.item.seq, taker.taker_id, taker.name, lease.number, lease.leased_at, expires
    )
