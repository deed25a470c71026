"""A queue's counters in protobuf form."""

from __future__ import annotations

from dataclasses import fields

from stampede_rt.v1 import queue_pb2
from stampede_rt_channel_host.cluster.records import queue_message
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue


def queue_status(hosted: HostedQueue, now: int) -> queue_pb2.QueueStatus:
    """Perform the due work of the queue, such as the end of leases. Then return its status as of `now`."""
    hosted.tick()
    counters = hosted.queue.counters(now)
    return queue_pb2.QueueStatus(
        record=queue_message(hosted.record),
        counters=queue_pb2.QueueCounters(**{field.name: getattr(counters, field.name) for field in fields(counters)}),
        waiting_takers=hosted.queue.waiting_takers,
        waiting_enqueues=hosted.queue.waiting_enqueues,
        oldest_accepted_unix_nano=hosted.queue.oldest_accepted_at,
        host_time_unix_nano=now,
        fed_copies=[] if hosted.replication is None else hosted.replication.statuses(),
    )
