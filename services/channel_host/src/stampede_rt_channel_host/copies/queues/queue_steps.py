"""Converts the whole queue, and its steps, to and from the parts of `MigrationService.FeedQueue`."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from typing import NamedTuple

from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.v1 import subject_pb2
from stampede_rt_channel_host.copies.queues.queue_messages import (
    PART_BYTES,
    ArrivingQueue,
    QueueValues,
    parts_of,
    seq_ranges,
)
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.queue import QueueHandoff, QueueStep

STEPS_PER_REQUEST = 64  # the copy repeats them in one turn of its event loop; each takes about 30 us


class WholeQueue(NamedTuple):
    """The whole queue, after all steps before `next_step`.

    `state` decodes it. A thread should call it, because it takes some microseconds for each message.
    """

    state: Callable[[], QueueHandoff]
    next_step: int


def whole_parts(state: QueueValues, next_step: int) -> Iterator[pb.FedQueuePart]:
    """The parts of the whole queue. A thread may take them, because nothing changes `state`."""
    for content in parts_of(state):
        yield pb.FedQueuePart(content=content, next_step=next_step if content.ends else 0)


def step_parts(step: QueueStep, now: int) -> Iterator[pb.FedQueuePart]:
    """The parts of a step: one, unless it has many bytes. `now`: the owner's clock."""
    content = pb.HandOverQueueResponse()
    for part in parts_of(step.changes):
        if content.ByteSize() + part.ByteSize() > PART_BYTES:
            yield pb.FedQueuePart(content=content)
            content = pb.HandOverQueueResponse()
        content.MergeFrom(part)
    ranges = [subject_pb2.SeqRange(first_seq=first, items=last - first + 1) for first, last in seq_ranges(step.removed)]
    yield pb.FedQueuePart(content=content, next_step=step.number + 1, removed=ranges, ago_nanos=max(0, now - step.time))


class ArrivingParts:
    """Joins the parts of a feed. `is_whole`: the parts belong to the whole queue, until it has come."""

    def __init__(self) -> None:
        self.is_whole = False
        self._arriving = ArrivingQueue()

    @property
    def size_bytes(self) -> int:
        """The bytes of the parts that wait for the rest."""
        return self._arriving.size_bytes

    def freeing(self) -> Pieces[None]:
        """Free these parts, in pieces."""
        return self._arriving.freeing()

    def begin_anew(self) -> None:
        """Note that the parts of the whole queue follow."""
        self.is_whole, self._arriving = True, ArrivingQueue()

    def add(self, parts: Iterable[pb.FedQueuePart]) -> Iterator[WholeQueue | tuple[QueueStep, int]]:
        """Add parts. Yields the things that are complete: the whole queue, and steps with their ages in nanoseconds.

        Raises InvalidArgument for parts that do not fit together.
        """
        for part in parts:
            self._arriving.add(part.content)
            if not self._arriving.is_whole:
                continue
            arrived, self._arriving = self._arriving, ArrivingQueue()
            if self.is_whole:
                self.is_whole = False
                yield WholeQueue(arrived.state, part.next_step)
            else:
                gone = (range(one.first_seq, one.first_seq + one.items) for one in part.removed)
                removed = tuple(seq for seqs in gone for seq in seqs)
                yield QueueStep(part.next_step - 1, 0, arrived.values(), removed), part.ago_nanos
