"""A whole queue at one moment, for another host. It is taken in pieces, while the queue changes. Pure.

A message with a history takes some microseconds to copy, and a queue may have hundreds of thousands of them. So each
piece copies some of them. It also copies messages once more that have changed since. The last piece finds only a few
messages to copy, and takes everything else, such as references to the fresh messages, which do not change. The snapshot
shows the queue as it is at that moment.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from itertools import chain, islice
from typing import NamedTuple

from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.dedup import KeptRun, KnownProducer, kept_runs
from stampede_rt_channel_host.core.queue.acknowledged_deliveries import AcknowledgedDelivery
from stampede_rt_channel_host.core.queue.changes import QueueChanges
from stampede_rt_channel_host.core.queue.chunked_map import ChunkedMap
from stampede_rt_channel_host.core.queue.enqueue_line import EnqueueLine
from stampede_rt_channel_host.core.queue.handoff import (
    FREED_PER_PIECE,
    ItemState,
    QueueHandoff,
    SeqRange,
    aged,
    run_with_age,
    state_of,
)
from stampede_rt_channel_host.core.queue.items import QueuedRun, TrackedItem
from stampede_rt_channel_host.core.queue.message_ids import KnownMessage, latest_of
from stampede_rt_channel_host.core.queue.queue_items import QueueItems
from stampede_rt_channel_host.core.queue.queue_leases import QueueLeases

MESSAGES_PER_PIECE = 256
"""The messages and producers that one piece copies, or more if the queue has changed more since the last piece."""


class _CopiedMessage(NamedTuple):
    """A tracked message. The durations of `state` are instants of the host's clock; see `_with_durations`."""

    run: QueuedRun
    state: ItemState


class QueueSnapshot:
    """Call `take_some` until it returns True; then the snapshot is as of this call. Call `changed` for each step.

    Then a thread may read `runs`, `held` and the other values, which `QueueHandoff` explains. They are made anew at
    each use.
    """

    def __init__(self, queue_items: QueueItems, queue_leases: QueueLeases, enqueue_line: EnqueueLine) -> None:
        self._queue_items = queue_items
        self._queue_leases = queue_leases
        self._enqueue_line = enqueue_line
        self._copied: ChunkedMap[_CopiedMessage] = ChunkedMap()
        self._next_seq = 0  # the pieces have copied all tracked messages with lower seqs
        self._outdated: set[int] = set()  # the seqs of copied messages that have changed or left since
        self._producers: dict[int, KnownProducer] = {}
        self._new_producers = {*enqueue_line.retries.producers}  # the ids of producers to copy, perhaps once more
        self._changes = 0  # the changes since the last piece
        self._fresh: list[QueuedRun] = []
        self.next_step = 0
        """The number of the next step of the queue; 0 if the queue has no journal."""

    def changed(self, changes: QueueChanges) -> None:
        """Note the changes of a step."""
        seqs = [seq for seq in (*changes.items, *changes.removed) if seq < self._next_seq]
        self._outdated.update(seqs)
        self._new_producers.update(kept.producer_id for kept in changes.producers)
        self._changes += len(seqs) + len(changes.producers)

    def take_some(self, now: int, chunks_max: int | None = None) -> bool:
        """Take a piece. Returns True for the last one. All changes of the queue must be in steps.

        `now`: the host's clock. `chunks_max`: see `AcknowledgedDeliveries.latest`.
        """
        # Twice the changes, so that the pieces come to an end however fast the queue changes.
        changes_left, self._changes = max(MESSAGES_PER_PIECE, 2 * self._changes), 0
        for item in [*islice(self._queue_items.tracked.values(self._next_seq), changes_left)]:
            self._copy(item)
            self._next_seq = item.seq + 1
            changes_left -= 1
        while changes_left and self._outdated:
            seq = self._outdated.pop()
            changed = self._queue_items.tracked.get(seq)
            if changed is None:
                del self._copied[seq]
            else:
                self._copy(changed)
            changes_left -= 1
        while changes_left and self._new_producers:
            self._copy_producer(self._new_producers.pop())
            changes_left -= 1
        if not changes_left:
            return False
        self._take_rest(now, chunks_max)
        return True

    def _copy(self, item: TrackedItem) -> None:
        self._copied[item.seq] = _CopiedMessage(item.run, state_of(item, self._queue_leases, 0))

    def _copy_producer(self, producer_id: int) -> None:
        producer = self._enqueue_line.retries.producers.get(producer_id)
        if producer is not None:  # if None, it was forgotten
            self._producers[producer_id] = producer.copied()

    def _take_rest(self, now: int, chunks_max: int | None) -> None:
        queue_items, line = self._queue_items, self._enqueue_line
        self._now = now
        self.next_seq = queue_items.next_seq
        self.next_delivery_id = self._queue_leases.next_delivery_id
        self.tally = queue_items.tally.copied()
        self._fresh, self._fresh_position = queue_items.fresh_runs()
        self._leaving = [*queue_items.leaving]
        self._acknowledged = self._queue_leases.acknowledged.latest(chunks_max)
        self._producers = {producer_id: self._producers[producer_id] for producer_id in line.retries.producers}
        self._message_ids = line.message_ids.copied()

    @property
    def runs(self) -> Iterator[QueuedRun]:
        """See `QueueHandoff`."""
        last: QueuedRun | None = None
        for run in chain((one.run for one in self._copied.values()), self._fresh):
            if run is not last:
                last = run
                yield run_with_age(run, self._now)

    @property
    def held(self) -> Iterator[SeqRange]:
        """See `QueueHandoff`."""
        tracked = _ranges(one.state.seq for one in self._copied.values())
        position = self._fresh_position
        firsts = chain(
            (run.first_seq + position for run in self._fresh[:1]), (run.first_seq for run in self._fresh[1:])
        )
        fresh = (SeqRange(first, run.end_seq - 1) for first, run in zip(firsts, self._fresh, strict=True))
        return _joined(chain(tracked, fresh))

    @property
    def items(self) -> Iterator[ItemState]:
        """See `QueueHandoff`."""
        for _, state in self._copied.values():
            has_history = state.deliveries or state.acknowledged or state.delay_nanos
            if has_history and not state.is_leaving:
                yield _with_durations(state, self._now)
        for seq in self._leaving:
            yield _with_durations(self._copied[seq].state, self._now)

    @property
    def acknowledged(self) -> Iterator[AcknowledgedDelivery]:
        """See `QueueHandoff`."""
        return (one._replace(time=self._now - one.time) for one in self._acknowledged.all(self._now))

    @property
    def producers(self) -> Iterator[KeptRun]:
        """See `QueueHandoff`."""
        return (aged(kept, self._now) for kept in kept_runs(self._producers, self._now))

    @property
    def message_ids(self) -> Iterator[KnownMessage]:
        """See `QueueHandoff`."""
        return (known._replace(time=self._now - known.time) for known in latest_of(self._message_ids, self._now))

    def freeing(self) -> Pieces[None]:
        """Free the memory, in pieces."""
        yield from self._copied.emptying()
        while self._fresh:
            del self._fresh[-FREED_PER_PIECE:]
            yield


def _with_durations(state: ItemState, now: int) -> ItemState:
    leases = [
        one._replace(lease_nanos=one.lease_nanos - now, leased_ago_nanos=one.leased_ago_nanos + now)
        for one in state.leases
    ]
    return state._replace(leases=leases, delay_nanos=state.delay_nanos - now if state.delay_nanos else 0)


def _ranges(seqs: Iterable[int]) -> Iterator[SeqRange]:
    """The ranges of ascending seqs."""
    first = last = 0
    for seq in seqs:
        if first and seq == last + 1:
            last = seq
            continue
        if first:
            yield SeqRange(first, last)
        first = last = seq
    if first:
        yield SeqRange(first, last)


def _joined(ranges: Iterable[SeqRange]) -> Iterator[SeqRange]:
    """The ranges, ascending. Ranges without a gap between them are joined."""
    former: SeqRange | None = None
    for one in ranges:
        if former is not None and former.last + 1 == one.first:
            one = SeqRange(former.first, one.last)
        elif former is not None:
            yield former
        former = one
    if former is not None:
        yield former


def export(
    queue_items: QueueItems,
    queue_leases: QueueLeases,
    enqueue_line: EnqueueLine,
    now: int,
    chunks_max: int | None = None,
) -> QueueHandoff:
    """The queue as of `now`. The result shares no mutable object with the queue."""
    taken = QueueSnapshot(queue_items, queue_leases, enqueue_line)
    while not taken.take_some(now, chunks_max):
        pass
    return QueueHandoff(
        next_seq=taken.next_seq,
        next_delivery_id=taken.next_delivery_id,
        tally=taken.tally,
        runs=[*taken.runs],
        held=[*taken.held],
        items=[*taken.items],
        acknowledged=[*taken.acknowledged],
        producers=[*taken.producers],
        message_ids=[*taken.message_ids],
    )
