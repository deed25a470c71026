"""Converts a whole queue to and from the parts of `MigrationService.HandOverQueue`.

Times are durations on the wire, because the clocks of two hosts differ.
"""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import fields
from itertools import chain, groupby
from typing import Any

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.v1 import queue_pb2, replica_service_pb2, subject_pb2
from stampede_rt_channel_host.copies.message_histories import entries_of, items_of
from stampede_rt_channel_host.copies.owner_messages import outcome_of, run_to
from stampede_rt_channel_host.core.channel.pieces import Pieces, run_to_end
from stampede_rt_channel_host.core.dedup import KeptRun
from stampede_rt_channel_host.core.queue import (
    AcknowledgedDelivery,
    KnownMessage,
    QueuedRun,
    QueueHandoff,
    QueueTally,
    SeqRange,
)
from stampede_rt_channel_host.core.queue.queue_snapshot import QueueSnapshot

QueueValues = QueueHandoff | QueueSnapshot
PART_BYTES = 2**17  # half of the longest message that a host takes over gRPC
_COUNTS = tuple(one.name for one in fields(QueueTally))


def parts_of(
    state: QueueValues, permit: bytes = b"", next_step: int = 0, *, steps_follow: bool = False
) -> Iterator[pb.HandOverQueueResponse]:
    """The queue in parts of about PART_BYTES. The first one has the facts, and the last one `ends` with the permit.

    `next_step`: the number of its next step, or 0 if it has no replicas. `steps_follow`: the host sends the steps from
    `next_step` on, too.
    """
    counters = queue_pb2.QueueCounters(**{name: getattr(state.tally, name) for name in _COUNTS})
    facts = pb.HandedQueueFacts(
        next_seq=state.next_seq, next_delivery_id=state.next_delivery_id, counters=counters, next_step=next_step
    )
    yield pb.HandOverQueueResponse(facts=facts)
    for is_long, runs in groupby(state.runs, lambda run: len(run.body) > PART_BYTES):
        parts = _parts_of_long_runs if is_long else _parts_of_runs
        yield from parts(runs)
    yield from (pb.HandOverQueueResponse(held=some) for some in _some(map(_range_to, state.held)))
    yield from (pb.HandOverQueueResponse(messages=some) for some in _some(entries_of(state.items)))
    acknowledged = map(_acknowledgement_to, state.acknowledged)
    yield from (pb.HandOverQueueResponse(acknowledged=some) for some in _some(acknowledged))
    by_producer = (runs for _, runs in groupby(state.producers, lambda run: run.producer_id))
    producers = (entry for runs in by_producer for entry in _producer_to([*runs]))
    yield from (pb.HandOverQueueResponse(producers=some) for some in _some(producers))
    yield from (pb.HandOverQueueResponse(message_ids=some) for some in _some(map(_id_to, state.message_ids)))
    yield pb.HandOverQueueResponse(ends=True, permit=permit, steps_follow=steps_follow)


class ArrivingQueue:
    """The parts of a queue that have arrived. `size_bytes`: the size of these parts."""

    def __init__(self) -> None:
        self._facts: pb.HandedQueueFacts | None = None
        self._parts: list[pb.HandOverQueueResponse] = []  # in one message, they would take long to free in one step
        self._last = pb.HandOverQueueResponse()
        self.size_bytes = 0

    def add(self, part: pb.HandOverQueueResponse) -> None:
        """Take the next part."""
        self.size_bytes += part.ByteSize()
        if part.HasField("facts"):
            self._facts = part.facts
        self._parts.append(part)
        self._last = part

    @property
    def is_whole(self) -> bool:
        """Whether the last part has come."""
        return self._last.ends

    @property
    def steps_follow(self) -> bool:
        """Whether the former owner still serves the queue, and sends the steps from `next_step` on."""
        return self._last.steps_follow

    @property
    def permit(self) -> bytes:
        """The former owner's permit for the directory. It came with the last part."""
        return self._last.permit

    @property
    def next_step(self) -> int:
        """The number of the next step, or 0 if the queue has no replicas."""
        return 0 if self._facts is None else self._facts.next_step

    def state(self) -> QueueHandoff:
        """The whole queue, after the last part. Call this once: it frees the parts. Raises InvalidArgument if the queue
        contradicts itself.
        """
        state = self.values()
        run_to_end(self.freeing())  # in one step the interpreter would run no other thread meanwhile
        _check(state)
        return state

    def freeing(self) -> Pieces[None]:
        """Free the parts, in pieces, because nobody needs the queue any more."""
        while self._parts:
            self._parts.pop()
            yield

    def values(self) -> QueueHandoff:
        """Like `state`, but the parts need not be a whole queue. Raises InvalidArgument if some are missing."""
        if self._facts is None or not self._last.ends:
            raise _nonsense("no facts, or no end")
        counters = self._facts.counters
        return QueueHandoff(
            next_seq=self._facts.next_seq,
            next_delivery_id=self._facts.next_delivery_id,
            tally=QueueTally(**{name: getattr(counters, name) for name in _COUNTS}),
            runs=[*self._runs()],
            held=[SeqRange(one.first_seq, one.first_seq + one.items - 1) for one in self._all("held")],
            items=[*items_of(self._all("messages"))],
            acknowledged=[
                AcknowledgedDelivery(one.delivery_id, one.taker_id, one.ago_nanos) for one in self._all("acknowledged")
            ],
            producers=[*chain.from_iterable(map(_runs_of, self._all("producers")))],
            message_ids=[
                KnownMessage(one.message_id, one.seq, one.ago_nanos, one.owner) for one in self._all("message_ids")
            ],
        )

    def _runs(self) -> Iterator[QueuedRun]:
        """The runs. Raises InvalidArgument for bytes without a run."""
        last: pb.HandedRun | None = None
        more: list[bytes] = []  # the rest of the body of `last`
        for part in self._parts:
            if part.more_body and last is None:
                raise _nonsense("bytes that belong to no run")
            if part.more_body:
                more.append(part.more_body)
            for run in part.runs:
                if last is not None:
                    yield _run_of(last, more)
                last, more = run, []
        if last is not None:
            yield _run_of(last, more)

    def _all(self, field: str) -> Iterator[Any]:
        """The entries of a list in all parts."""
        return chain.from_iterable(getattr(part, field) for part in self._parts)


def _check(state: QueueHandoff) -> None:
    """Raises InvalidArgument for a message without a run, or a delivery history without a message."""
    ends = [run.end_seq for run in state.runs]
    runs_ascend = all(run.first_seq >= end for run, end in zip(state.runs[1:], ends, strict=False))
    held_ascend = all(later.first > one.last for one, later in zip(state.held, state.held[1:], strict=False))
    stored = [SeqRange(run.first_seq, run.end_seq - 1) for run in state.runs]
    if not (runs_ascend and held_ascend and all(_are_in(stored, one) for one in state.held)):
        raise _nonsense("messages without a run, or not in the order of seqs")
    if not all(_are_in(state.held, SeqRange(one.seq, one.seq)) for one in state.items):
        raise _nonsense("a history of a message that it does not hold")
    is_of_future = bool(state.held) and state.held[-1].last >= state.next_seq
    if is_of_future or any(len(one.deliveries) < len(one.leases) for one in state.items):
        raise _nonsense("leases without a delivery, or a message of the future")


def _are_in(ranges: Sequence[SeqRange], wanted: SeqRange) -> bool:
    """Whether ascending ranges have all seqs of `wanted`. A set of all seqs would take long to free in one step."""
    at = bisect_right(ranges, wanted.first, key=lambda one: one.first) - 1
    seq = wanted.first
    while 0 <= at < len(ranges) and ranges[at].first <= seq <= ranges[at].last:
        seq = ranges[at].last + 1
        if seq > wanted.last:
            return True
        at += 1
    return False


def _nonsense(what: str) -> InvalidArgument:
    return InvalidArgument(f"the handed queue has {what}; install the same release on both hosts")


def seq_ranges(seqs: Iterable[int]) -> list[SeqRange]:
    """The ranges of seqs in any order."""
    found: list[SeqRange] = []
    for seq in sorted(seqs):
        if found and found[-1].last + 1 == seq:
            found[-1] = SeqRange(found[-1].first, seq)
        else:
            found.append(SeqRange(seq, seq))
    return found


def _some(entries: Iterable[Any]) -> Iterator[list[Any]]:
    """The messages, in lists of PART_BYTES at most, or of one message."""
    some, some_bytes = list[Any](), 0
    for one in entries:
        one_bytes = one.ByteSize() + 4  # with its tag and length
        if some and some_bytes + one_bytes > PART_BYTES:
            yield some
            some, some_bytes = [], 0
        some.append(one)
        some_bytes += one_bytes
    if some:
        yield some


def _range_to(held: SeqRange) -> subject_pb2.SeqRange:
    first, last = held
    return subject_pb2.SeqRange(first_seq=first, items=last - first + 1)


def _acknowledgement_to(one: AcknowledgedDelivery) -> pb.HandedAcknowledgement:
    return pb.HandedAcknowledgement(delivery_id=one[0], taker_id=one[1], ago_nanos=one[2])


def _id_to(one: KnownMessage) -> pb.HandedMessageId:
    return pb.HandedMessageId(message_id=one.message_id, seq=one.seq, ago_nanos=one.time, owner=one.caller_name)


def _parts_of_runs(runs: Iterable[QueuedRun]) -> Iterator[pb.HandOverQueueResponse]:
    """Short runs, many in a part: each part costs both hosts about as much as a hundred messages."""
    return (pb.HandOverQueueResponse(runs=some) for some in _some(_run_to(run, run.body) for run in runs))


def _run_of(run: pb.HandedRun, more: Sequence[bytes]) -> QueuedRun:
    """`more`: the rest of its body."""
    body = b"".join((run.body, *more))
    return QueuedRun(run.first_seq, tuple(run.length_bytes), run.accepted_ago_nanos, body)


def _run_to(run: QueuedRun, body: bytes) -> pb.HandedRun:
    return pb.HandedRun(
        first_seq=run.first_seq, length_bytes=run.lengths, accepted_ago_nanos=run.accepted_at, body=body
    )


def _parts_of_long_runs(runs: Iterable[QueuedRun]) -> Iterator[pb.HandOverQueueResponse]:
    """Runs that are longer than a part, each in several parts."""
    for run in runs:
        yield pb.HandOverQueueResponse(runs=[_run_to(run, run.body[:PART_BYTES])])
        for at in range(PART_BYTES, len(run.body), PART_BYTES):
            yield pb.HandOverQueueResponse(more_body=run.body[at : at + PART_BYTES])


def _producer_to(runs: Sequence[KeptRun]) -> Iterator[replica_service_pb2.FedProducer]:
    """The runs of one producer, in several entries if they are long: a run has an error for each refused message.

    In a `QueueHandoff` the time of an outcome is its age.
    """
    aged = ((one.first_number, one.outcome._replace(time=-one.outcome.time)) for one in runs)
    for some in _some(run_to(number, outcome, 0) for number, outcome in aged):
        yield replica_service_pb2.FedProducer(producer_id=runs[0].producer_id, owner=runs[0].caller_name, runs=some)


def _runs_of(producer: replica_service_pb2.FedProducer) -> Iterator[KeptRun]:
    for run in producer.runs:
        outcome = outcome_of(run, 0)
        aged = outcome._replace(time=-outcome.time)
        yield KeptRun(producer.producer_id, run.first_number, aged, producer.owner)
