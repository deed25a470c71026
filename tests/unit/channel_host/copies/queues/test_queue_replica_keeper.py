"""A host drops the replica of a queue that the directory no longer has, unless the owner feeds the replica anew."""

from __future__ import annotations

import asyncio
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.values.queueing import QueuePolicy
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.copies.queues.queue_replica_keeper import SILENT_OWNER_SECONDS, QueueReplicaKeeper
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues.queue_copies import QueueCopies
from tests.support.channel_host.queue_cores import Core
from tests.support.virtual_time import VirtualClock, run_virtually

RECORD = RecordedQueue(
    queue_id=b"q" * 16, name="jobs", host_id=b"h" * 16, epoch=1, incarnation=1, spec_version=1,
    policy=QueuePolicy(replicas=1, ack="replica"), message=b"",
)  # fmt: skip


@pytest.mark.parametrize("is_fed", [False, True], ids=["no feed", "a feed begins before the answer comes"])
def test_a_late_answer_drops_no_copy_that_has_a_feed(is_fed: bool) -> None:
    core = Core()
    copies = QueueCopies(MemoryBudget(2**20), lambda: core.now, lambda: True, PieceScheduler())
    copies.begin(RECORD, copies.restored(RECORD, core.queue.export(core.now)), 1).last_message_nanos = 0

    async def source_of(queue_id: bytes, host_id: bytes) -> None:
        if is_fed:  # a caller has added the replica again
            copies.note_feed(queue_id)

    async def run(clock: VirtualClock) -> None:
        queues: Any = SimpleNamespace(copies=copies)
        directory: Any = SimpleNamespace(source_of=source_of)
        identity: Any = SimpleNamespace(host_id=b"r" * 16)
        keeper = QueueReplicaKeeper(identity, queues, directory, lambda target: pytest.fail("no host is called"))
        dropping = asyncio.create_task(keeper.drop_unneeded_forever())
        await asyncio.sleep(1.5 * SILENT_OWNER_SECONDS)
        dropping.cancel()

    run_virtually(run, seed=1)
    assert (copies.of(RECORD.queue_id) is not None) == is_fed
