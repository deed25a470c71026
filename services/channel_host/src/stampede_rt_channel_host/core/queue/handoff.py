"""A whole queue as values, for a host that takes the queue over (paper, section 4.1: queues migrate). Pure.

Seqs, delivery ids and counters continue. Takers, and runs that wait for room, do not move: the former host tells their
streams the address of the new host. Durations replace instants, because two hosts' clocks differ. The values follow
`HandoffRecord` of the contract.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import NamedTuple

from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.dedup import KeptRun
from stampede_rt_channel_host.core.queue.acknowledged_deliveries import AcknowledgedDelivery
from stampede_rt_channel_host.core.queue.changes import ItemChange
from stampede_rt_channel_host.core.queue.chunked_map import ChunkedMap
from stampede_rt_channel_host.core.queue.enqueue_line import EnqueueLine
from stampede_rt_channel_host.core.queue.items import FailedDelivery, QueuedRun, TrackedItem
from stampede_rt_channel_host.core.queue.message_ids import KnownMessage
from stampede_rt_channel_host.core.queue.queue_items import QueueItems, QueueTally
from stampede_rt_channel_host.core.queue.queue_leases import Lease, QueueLeases
from stampede_rt_channel_host.core.queue.takers import TakerState

FREED_PER_PIECE = 1024


class LeaseState(NamedTuple):
    """A lease. It lasts for `lease_nanos` from the export on. It began `leased_ago_nanos` before the export."""

    delivery_id: int
    taker_id: int
    taker_name: str
    lease_nanos: int
    leased_ago_nanos: int


class ItemState(NamedTuple):
    """A message with a history: it is leased, held back or leaving, or was delivered or acknowledged before.

    `deliveries` has an entry for each copy that was delivered and not acknowledged: how often it was delivered. The
    leased copies come first, in the order of `leases`. The queue holds the message back for `delay_nanos`.
    `is_leaving`: it waits for its move to the dead-letter queue. `last` is its last failed delivery. `acknowledged` has
    the ids of the takers that acknowledged a copy.

    `ended` None: this is the whole state. Otherwise this is a change: `leases` and `acknowledged` have only the new and
    the changed entries, and the leases of the deliveries `ended` are over.
    """

    seq: int
    deliveries: Sequence[int]
    acknowledged: Sequence[int]
    leases: Sequence[LeaseState]
    delay_nanos: int
    is_leaving: bool
    last: FailedDelivery | None
    ended: Sequence[int] | None = None


class SeqRange(NamedTuple):
    """The seqs from `first` to `last`, both inclusive."""

    first: int
    last: int


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueHandoff:
    """The whole queue.

    `runs` and `held` ascend. Each run has at least one held message. Held messages without an entry in `items` have no
    history. In `runs` (`accepted_at`), `acknowledged`, `producers` and `message_ids` each time is replaced by an age in
    nanoseconds.
    """

    next_seq: int
    next_delivery_id: int
    tally: QueueTally
    runs: Sequence[QueuedRun]
    held: Sequence[SeqRange]
    items: Sequence[ItemState]
    acknowledged: Sequence[AcknowledgedDelivery]
    producers: Sequence[KeptRun]
    message_ids: Sequence[KnownMessage]


def freeing(state: QueueHandoff) -> Pieces[None]:
    """Free the memory, in pieces. Nobody may use `state` any more."""
    for values in (state.runs, state.items, state.producers, state.message_ids, state.acknowledged):
        assert isinstance(values, list), "the values are in lists"
        while values:
            del values[-FREED_PER_PIECE:]
            yield


def restore(
    state: QueueHandoff, queue_items: QueueItems, queue_leases: QueueLeases, enqueue_line: EnqueueLine, now: int
) -> None:
    """Fill an empty queue with `state`. The next `QueueCore.tick` ends the expired leases and delays."""
    queue_items.tally = state.tally.copied()
    queue_leases.next_delivery_id = state.next_delivery_id
    states: ChunkedMap[ItemState] = ChunkedMap()
    for item_state in state.items:
        states[item_state.seq] = item_state
    fresh_from = _fresh_from(state)
    runs = iter(state.runs)
    run: QueuedRun | None = None
    for seq in chain.from_iterable(range(first, last + 1) for first, last in state.held):
        while run is None or seq >= run.end_seq:
            run = fresh_run_of(next(runs), now)
        queue_items.put_back(run, seq - run.first_seq, is_fresh=seq >= fresh_from)
        found = states.get(seq)
        if found is not None:
            enter(queue_items, queue_leases, found, now)
        elif seq < fresh_from:
            queue_items.refresh(queue_items.tracked[seq])
    queue_items.next_seq = state.next_seq
    for seq in [one.seq for one in state.items if one.is_leaving]:  # in the order in which these messages will leave
        queue_items.leaving.move_to_end(seq)
    for one in state.acknowledged:
        queue_leases.acknowledged.record(one.delivery_id, one.taker_id, now - one.time)
    for kept in state.producers:
        enqueue_line.retries.record(kept.producer_id, kept.first_number, aged(kept, now).outcome, kept.caller_name)
    for known in state.message_ids:
        enqueue_line.message_ids.record(known.message_id, known.seq, now - known.time, known.caller_name)
    for _ in states.emptying():  # in one step the interpreter would run no other thread meanwhile
        pass


def run_with_age(run: QueuedRun, now: int) -> QueuedRun:
    """The run with its age in place of its time of acceptance."""
    return QueuedRun(run.first_seq, run.lengths, now - run.accepted_at, run.body)


def fresh_run_of(aged_run: QueuedRun, now: int) -> QueuedRun:
    """The run of `run_with_age` at another host, whose clock shows `now`. None of its messages is held yet."""
    run = QueuedRun(aged_run.first_seq, aged_run.lengths, now - aged_run.accepted_at, aged_run.body)
    run.held = 0
    return run


def aged(kept: KeptRun, now: int) -> KeptRun:
    """The run with its age in place of its time for another host, or its time in place of its age for `restore`."""
    return kept._replace(outcome=kept.outcome._replace(time=now - kept.outcome.time))


def _fresh_from(state: QueueHandoff) -> int:
    """The first seq of the messages that become fresh messages: the queue holds all of these, and none has a history.

    An older message becomes a tracked message, even if it has no history. An example is a message whose delivery the
    queue took back before the host sent it.
    """
    if not state.held or state.held[-1].last != state.next_seq - 1:
        return state.next_seq
    return max(state.held[-1].first, max((one.seq for one in state.items), default=0) + 1)


def state_of(item: TrackedItem, queue_leases: QueueLeases, now: int) -> ItemState:
    """A tracked message as a value."""
    leases = [queue_leases.leases[delivery_id] for delivery_id in item.leases.values()]
    return ItemState(
        seq=item.seq,
        deliveries=[*(lease.number for lease in leases), *item.returned],
        acknowledged=item.acknowledged,
        leases=[_lease_state(lease, queue_leases.end_of(lease), now) for lease in leases],
        delay_nanos=0 if item.due is None else item.due - now,
        is_leaving=item.is_leaving,
        last=item.last,
    )


def change_of(item: TrackedItem, change: ItemChange, queue_leases: QueueLeases, now: int) -> ItemState:
    """The change of a tracked message as a value."""
    found = {delivery_id: queue_leases.leases.get(delivery_id) for delivery_id in change.deliveries}
    leases = [lease for lease in found.values() if lease is not None]
    return ItemState(
        seq=item.seq,
        deliveries=[*(lease.number for lease in leases), *item.returned],
        acknowledged=item.acknowledged[change.acknowledged_before :],
        leases=[_lease_state(lease, queue_leases.end_of(lease), now) for lease in leases],
        delay_nanos=0 if item.due is None else item.due - now,
        is_leaving=item.is_leaving,
        last=item.last,
        ended=[delivery_id for delivery_id, lease in found.items() if lease is None],
    )


def _lease_state(lease: Lease, end: int, now: int) -> LeaseState:
    taker = lease.taker
    return LeaseState(lease.order, taker.taker_id, taker.name, end - now, now - lease.leased_at)


def enter(queue_items: QueueItems, queue_leases: QueueLeases, state: ItemState, now: int) -> None:
    """Replace the history of a tracked message by `state` of another host. If `state` is a change, apply the change."""
    item = queue_items.tracked[state.seq]
    former = {one.delivery_id: queue_leases.leases.get(one.delivery_id) for one in state.leases}
    if state.ended is None:
        queue_leases.void(item)
        item.acknowledged = tuple(state.acknowledged)
    else:
        queue_leases.end(state.ended)
        item.acknowledged += tuple(state.acknowledged)
    item.last = state.last
    item.returned = sorted(state.deliveries[len(state.leases) :])
    queue_items.delays.disarm(item)
    for lease, number in zip(state.leases, state.deliveries, strict=False):
        taker = TakerState(lease.taker_id, name=lease.taker_name)
        # A lease that this host has keeps its object, because the deadlines must not have two leases with one id.
        leased = former[lease.delivery_id]
        leased = leased or Lease(lease.delivery_id, item, number, taker, now - lease.leased_ago_nanos)
        queue_leases.enter(leased, now + lease.lease_nanos)
    if state.delay_nanos > 0:
        queue_items.delays.set_due(item, now + state.delay_nanos)
    if state.is_leaving:
        queue_items.set_leaving(item)
    queue_items.refresh(item)
