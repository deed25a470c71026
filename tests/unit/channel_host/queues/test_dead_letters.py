"""Dead letters: as whom a queue puts them."""

from __future__ import annotations

from stampede_rt.v1 import queue_pb2
from stampede_rt_channel_host.cluster.records import recorded_queue
from stampede_rt_channel_host.queues.dead_letters import producer_id_of


def test_a_queue_puts_its_dead_letters_as_the_same_producer_at_every_host() -> None:
    record = recorded_queue(queue_pb2.QueueRecord(queue_id=b"x" * 16, incarnation=5, epoch=1, host_id=b"a" * 16))
    elsewhere = recorded_queue(queue_pb2.QueueRecord(queue_id=b"x" * 16, incarnation=5, epoch=2, host_id=b"b" * 16))
    assert producer_id_of(record) == producer_id_of(elsewhere) != 0
    assert producer_id_of(recorded_queue(queue_pb2.QueueRecord(queue_id=b"x" * 16, incarnation=6))) != producer_id_of(
        record
    )
