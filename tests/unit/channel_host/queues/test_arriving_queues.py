"""A queue that moves here, while this host may hold a replica of it: one content is served, and the other one freed."""

from __future__ import annotations

import logging
from dataclasses import replace

import pytest

from stampede_rt.values.queueing import QueuePolicy
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.core.channel import Pieces
from stampede_rt_channel_host.core.queue import QueueCore
from stampede_rt_channel_host.core.queue.queue import EMPTIED_PER_PIECE
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues.arriving_queues import ArrivingQueues
from stampede_rt_channel_host.queues.queue_content import QueueContent
from stampede_rt_channel_host.queues.queue_copies import QueueCopies
from tests.support.channel_host.queue_cores import Core

MESSAGES = 3 * EMPTIED_PER_PIECE
RECORD = RecordedQueue(
    queue_id=b"q" * 16, name="jobs", host_id=b"h" * 16, epoch=1, incarnation=1, spec_version=1,
    policy=QueuePolicy(replicas=1, ack="replica"), message=b"",
)  # fmt: skip


class Destination:
    """A host with a replica of a queue, to which the queue moves. `pieces`: counts those of each work."""

    def __init__(self) -> None:
        self.pieces: list[int] = []
        self.copies = QueueCopies(MemoryBudget(2**30), lambda: 1000, lambda: True, self)  # type: ignore[arg-type]
        self.arriving = ArrivingQueues(self.copies, self)  # type: ignore[arg-type]
        self.replica, self.arrived = core(), core()
        self.copies.begin(RECORD, self.replica, 2)
        self.arriving.expect(RECORD, QueueContent(self.arrived, self.arrived.journal(2)))

    def begin(self, pieces: Pieces[None]) -> None:
        """See `PieceScheduler`."""
        self.pieces.append(sum(1 for _ in pieces))

    def left(self) -> tuple[int, int]:
        """The messages of the replica, and of the arrived queue."""
        return self.replica.latest_counters().held, self.arrived.latest_counters().held


def core() -> QueueCore:
    made = Core(max_items=MESSAGES)
    made.put(*[1] * MESSAGES)
    return made.queue


def test_a_queue_that_has_arrived_is_served_and_the_replica_is_freed_in_pieces(
    caplog: pytest.LogCaptureFixture,
) -> None:
    """In an earlier version, one step of the event loop freed the replica, and the log named it as the content."""
    caplog.set_level(logging.INFO)
    destination = Destination()
    content = destination.arriving.content_of(replace(RECORD, epoch=2))
    assert content is not None
    assert content.core is destination.arrived
    assert destination.left() == (0, MESSAGES)
    assert destination.pieces == [6]
    assert not caplog.records


@pytest.mark.parametrize("later", [replace(RECORD, epoch=3), replace(RECORD, epoch=2, incarnation=2)])
def test_an_arrived_queue_is_freed_in_pieces_if_the_directory_names_another_queue_or_epoch(
    later: RecordedQueue,
) -> None:
    destination = Destination()
    content = destination.arriving.content_of(later)
    is_same_queue = later.incarnation == RECORD.incarnation
    assert (content is not None and content.core is destination.replica) == is_same_queue
    assert destination.left() == (MESSAGES if is_same_queue else 0, 0)
    assert set(destination.pieces) == {6}


def test_a_queue_whose_move_has_failed_is_freed_in_pieces_once() -> None:
    destination = Destination()
    destination.arriving.give_up(RECORD.queue_id)
    destination.arriving.give_up(RECORD.queue_id)
    assert destination.left() == (MESSAGES, 0)
    assert destination.pieces == [6]
