"""The replicas of queues that a host holds, and the queues that it inherits with them."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.values.queueing import QueuePolicy
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
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

    def __init__(self, bytes_max: int = 2**20) -> None:
        owner = Core()
        owner.put(1)
        owner.taker(credit=1, lease_nanos=30 * S)
        owner.queue.take_batches()
        self.now = owner.now
        (self.lease,) = owner.queue.pending(0, 9, self.now)
        self.copies = QueueCopies(MemoryBudget(bytes_max), lambda: self.now, lambda: True)
        self.core = self.copies.restored(RECORD, owner.queue.export(self.now))


def test_the_leases_of_an_inherited_queue_do_not_count_the_time_without_an_owner() -> None:
    replica = Replica()
    copy = replica.copies.begin(RECORD, replica.core, 2)
    copy.heard_nanos -= 10 * S
    content = replica.copies.inherit(replace(RECORD, epoch=2))
    assert content is not None
    (lease,) = content.core.pending(0, 9, replica.now)
    assert lease.expires >= replica.lease.expires + 10 * S
    assert not content.is_replicated, "the other replicas may lack the last steps"
    assert replica.copies.of(RECORD.queue_id) is None


def test_a_copy_of_another_incarnation_is_dropped_and_not_inherited() -> None:
    replica = Replica()
    replica.copies.begin(RECORD, replica.core, 2)
    assert replica.copies.inherit(replace(RECORD, epoch=2, incarnation=2)) is None
    assert replica.copies.of(RECORD.queue_id) is None


def test_the_copy_of_a_former_owner_counts_its_leases_from_the_hold() -> None:
    replica = Replica()
    replica.copies.keep(RECORD, KeptQueue(replica.core, 2, made_nanos=7))
    copy = replica.copies.of(RECORD.queue_id)
    assert copy is not None
    assert (copy.heard_nanos, copy.journal.next_step, copy.owner_epoch) == (7, 2, 1)


def test_a_former_owner_without_room_keeps_no_copy() -> None:
    replica = Replica(bytes_max=1)
    replica.copies.keep(RECORD, KeptQueue(replica.core, 2, made_nanos=7))
    assert replica.copies.of(RECORD.queue_id) is None
