"""Answers of a queue that wait for its replicas."""

from __future__ import annotations

from stampede_rt.errors import NotReplicated
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.puts.held_acks import AckOfReplicas, HeldAck
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.queue_replication import QueueReplication
from stampede_rt_channel_host.queues.refusals import display_name

ANSWER_SECONDS_MAX = 8.0  # shorter than clients wait for a call


async def wait_for_replicas(hosted: HostedQueue) -> None:
    """Wait until the replicas have the present state of the queue, ANSWER_SECONDS_MAX at most.

    Raises NotReplicated if they do not have it by then, and the error with which the host gives the queue up.
    """
    replication = hosted.replication
    if replication is None:
        return
    period = replication.period
    if not await replication.replicated(replication.journal.next_step, ANSWER_SECONDS_MAX):
        raise period.ended or _not_replicated(hosted, replication, {}, 1)


def ack_of_replicas(ack: pb.PutAck, hosted: HostedQueue, wait_nanos: int | None) -> pb.PutAck | HeldAck:
    """The ack of a put, or the wait for the replicas that holds it back.

    `wait_nanos`: the longest wait; None: no limit.
    """
    replication = hosted.replication
    if replication is None or not ack.HasField("first_seq"):
        return ack

    def explain(late: pb.PutAck) -> NotReplicated:
        return _not_replicated(hosted, replication, {"seq": str(late.first_seq)}, late.copies)

    left_nanos = None if wait_nanos is None else max(0, wait_nanos)
    return AckOfReplicas(ack, replication, replication.journal.next_step, left_nanos, explain)


def _not_replicated(
    hosted: HostedQueue, replication: QueueReplication, about: dict[str, str], copies: int
) -> NotReplicated:
    name = display_name(hosted.record)
    return NotReplicated(
        f"queue {name} has made the change, but its replicas did not get it in time: min_replicas is "
        f"{replication.min_replicas}; the change counts once it is replicated; look at `stampede replicas --queue "
        f"{name}`, or start another host",
        metadata={"queue": name, "copies": str(copies)} | about,
    )
