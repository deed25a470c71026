"""Answers of the directory about a queue that come late: the queue has moved meanwhile."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import pytest

from stampede_rt.errors import StaleBinding, StampedeError
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.v1.migration_service_pb2_grpc import MigrationServiceStub
from stampede_rt_channel_host.cluster.records import recorded_queue
from stampede_rt_channel_host.core.channel import run_to_end
from tests.support.channel_host.queue_rig import OTHER_ID, OpenedQueue, QueueRig, two_queue_hosts


class Move:
    """A queue with three messages at `source`, and the host to which it moves."""

    def __init__(self, source: QueueRig, other: QueueRig, queue: OpenedQueue) -> None:
        self.source, self.other, self.queue = source, other, queue
        self.queues = other.host.queues
        self.arrivals: Any = other.host._queues_here
        self.record = recorded_queue(queue.record)

    async def make(self) -> None:
        """Move the queue."""
        queue_id = self.queue.queue_id
        allowed = pb.AllowMoveRequest(queue_id=queue_id, to_host_id=OTHER_ID)
        await MigrationServiceStub(self.source.connection).AllowMove(allowed)
        await self.arrivals.move_here(self.record, self.source.target)

    async def held(self) -> int:
        """The number of messages at the new owner."""
        hosted = await self.queues.use(self.queue.queue_id, None)
        return hosted.queue.latest_counters().held


@pytest.fixture
async def move() -> AsyncIterator[Move]:
    async with two_queue_hosts() as (source, other, queue):
        yield Move(source, other, queue)


async def test_the_new_owner_keeps_a_queue_of_which_a_lookup_from_before_the_move_names_the_former_owner(
    move: Move,
) -> None:
    directory: Any = move.queues._directory
    look_up, looked_up, release = directory.resolve, asyncio.Event(), asyncio.Event()

    async def answered_late(queue_id: bytes) -> Any:
        found = await look_up(queue_id)
        looked_up.set()
        await release.wait()
        return found

    directory.resolve = answered_late
    using = asyncio.create_task(move.queues.use(move.queue.queue_id, None))
    await looked_up.wait()
    await move.make()
    directory.resolve = look_up
    release.set()
    with suppress(StampedeError):
        await using
    assert await move.held() == 3


async def test_a_second_call_for_a_move_that_is_over_leaves_the_queue_at_its_new_owner(move: Move) -> None:
    """The second call has asked the directory before the move, too."""
    await move.make()
    moved = await move.arrivals.move_here(move.record, move.source.target)
    assert moved.blackout_nanos == 0
    assert await move.held() == 3


async def test_a_host_serves_no_queue_whose_commit_is_answered_after_its_lease_has_ended(move: Move) -> None:
    """Another host has got the queue when this host registers again, and then the answer about the move comes."""
    directory: Any = move.arrivals._directory
    commit = directory.commit_queue

    async def answered_late(*arguments: Any) -> Any:
        record = await commit(*arguments)
        present = move.source.directory.queues[move.queue.queue_id]
        present.host_id, present.epoch, present.incarnation = b"another-host-16b", 3, present.incarnation + 1
        run_to_end(move.queues.registering([], is_complete=True))
        return replace(record, host_id=OTHER_ID, epoch=2)

    directory.commit_queue = answered_late
    with pytest.raises(StaleBinding, match="is at host"):
        await move.make()
    assert move.queues.known(move.queue.queue_id) is None


async def test_a_replica_does_not_own_its_queue_because_a_watch_reports_the_time_before_a_move(move: Move) -> None:
    """The host was the owner, and is a replica since a move. A change of the queue from before it is reported late."""
    move.queues.copies.begin(replace(move.record, epoch=2), move.queues.copies.restored(move.record, _empty(move)), 1)
    move.queues.changed(replace(move.record, host_id=OTHER_ID, epoch=1, spec_version=2), removed=False)
    assert move.queues.known(move.queue.queue_id) is None
    assert move.queues.copies.of(move.queue.queue_id) is not None


async def test_messages_of_a_former_incarnation_are_not_served_under_a_new_one(move: Move) -> None:
    """The former owner was lost. A caller opened the queue at the host to which the queue was about to move."""
    directory: Any = move.arrivals._directory
    commit = directory.commit_queue

    async def committed_by_a_caller(*arguments: Any) -> Any:
        record = await commit(*arguments)
        present = move.source.directory.queues[move.queue.queue_id]
        present.incarnation += 1
        return replace(record, incarnation=present.incarnation)

    directory.commit_queue = committed_by_a_caller
    await move.make()
    hosted = move.queues.known(move.queue.queue_id)
    assert hosted is not None
    assert hosted.queue.incarnation == hosted.record.incarnation


def _empty(move: Move) -> Any:
    """The state of a queue."""
    hosted = move.source.host.queues.known(move.queue.queue_id)
    assert hosted is not None
    return hosted.queue.export(move.queues.now())
