"""The replicas of queues that a host holds, and the queues that it inherits with them."""

from __future__ import annotations

import asyncio
from dataclasses import replace
from itertools import pairwise

from stampede_rt.values.queueing import QueuePolicy
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.core.queue.queue import EMPTIED_PER_PIECE
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues.queue_content import KeptQueue
from stampede_rt_channel_host.queues.queue_copies import QueueCopies
from tests.support.channel_host.queue_cores import Core

S = 10**9
RECORD = RecordedQueue(
    queue_id=b"q" * 16, name="jobs", host_id=b"h" * 16, epoch=1, incarnation=1, spec_version=1,
    policy=QueuePolicy(replicas=1, ack="replica"), message=b"",
)  # fmt: skip


class Replica:
    """A copy of a queue with one leased message, whose lease ends at `ends`."""

    def __init__(self) -> None:
        owner = Core()
        owner.put(1)
        owner.taker(credit=1, lease_nanos=30 * S)
        owner.queue.take_batches()
        self.now = owner.now
        (self.lease,) = owner.queue.pending(0, 9, self.now)
        self.memory = MemoryBudget(2**20)
        self.copies = QueueCopies(self.memory, lambda: self.now, lambda: True, PieceScheduler())
        self.core = self.copies.restored(RECORD, owner.queue.export(self.now))


def test_the_leases_of_an_inherited_queue_do_not_count_the_time_without_an_owner() -> None:
    replica = Replica()
    copy = replica.copies.begin(RECORD, replica.core, 2)
    copy.last_message_nanos -= 10 * S
    content = replica.copies.inherit(replace(RECORD, epoch=2))
    assert content is not None
    (lease,) = content.core.pending(0, 9, replica.now)
    assert lease.expires >= replica.lease.expires + 10 * S
    assert not content.is_replicated, "the other replicas may lack the last steps"
    assert replica.copies.of(RECORD.queue_id) is None


async def test_a_copy_of_another_incarnation_is_dropped_and_not_inherited() -> None:
    replica = Replica()
    replica.copies.begin(RECORD, replica.core, 2)
    assert replica.copies.inherit(replace(RECORD, epoch=2, incarnation=2)) is None
    assert replica.copies.of(RECORD.queue_id) is None


def test_the_copy_of_a_former_owner_counts_its_leases_from_the_hold() -> None:
    replica = Replica()
    replica.copies.keep(RECORD, KeptQueue(replica.core, 2, 7))
    copy = replica.copies.of(RECORD.queue_id)
    assert copy is not None
    assert (copy.last_message_nanos, copy.journal.next_step, copy.owner_epoch) == (7, 2, 1)


async def test_the_copy_of_a_former_owner_needs_no_room_although_the_host_is_full() -> None:
    """In an earlier version, the host refused the copy after the move, although the directory knew it as in sync."""
    replica = Replica()
    replica.memory.bytes_max = 1
    replica.copies.keep(RECORD, KeptQueue(replica.core, 2, 7))
    assert replica.memory.used_bytes == replica.core.footprint_bytes
    assert replica.copies.of(RECORD.queue_id) is not None
    replica.copies.drop(RECORD.queue_id)
    assert replica.memory.used_bytes == 0


async def test_a_dropped_copy_is_freed_in_pieces() -> None:
    owner = Core(max_items=5 * EMPTIED_PER_PIECE)
    owner.put(*[1] * 5 * EMPTIED_PER_PIECE)
    replica = Replica()
    core = replica.copies.restored(RECORD, owner.queue.export(owner.now))
    replica.copies.begin(RECORD, core, 2)
    replica.copies.drop(RECORD.queue_id)
    left = [core.latest_counters().held]
    while left[-1]:
        await asyncio.sleep(0)
        left.append(core.latest_counters().held)
    assert max(before - after for before, after in pairwise([5 * EMPTIED_PER_PIECE, *left])) == EMPTIED_PER_PIECE
