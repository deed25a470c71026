"""Answers of a queue that wait for its replicas."""

from __future__ import annotations

import asyncio

from stampede_rt.errors import NotReplicated
from stampede_rt.status import to_error_message
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt_channel_host.channels.puts.acks import refused
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


class AckOfQueue:
    """The ack of a put that is due once the replicas have the message."""

    def __init__(
        self, ack: pb.PutAck, hosted: HostedQueue, replication: QueueReplication, wait_s: float | None
    ) -> None:
        """`wait_s`: the longest wait in seconds; None: without a limit."""
        self._ack = ack
        self._hosted = hosted
        self._replication = replication
        self._period = replication.period
        self._next_step = replication.journal.next_step
        self._ends_s = None if wait_s is None else asyncio.get_running_loop().time() + wait_s

    async def due(self) -> pb.PutAck:
        """Wait until the ack is due, and return it. After the longest wait it has the error NOT_REPLICATED."""
        replication, ack = self._replication, self._ack
        left_s = None if self._ends_s is None else max(0.0, self._ends_s - asyncio.get_running_loop().time())
        is_replicated = await replication.replicated(self._next_step, left_s, self._period)
        ack.copies = replication.copies(self._next_step)
        if is_replicated:
            return ack
        if (ended := self._period.ended) is not None:
            return refused(ack.first_number, ack.items, ended, ack.host_time_unix_nano, ack.incarnation)
        replication.not_replicated += ack.items - len(ack.rejections)
        error = _not_replicated(self._hosted, replication, {"seq": str(ack.first_seq)}, ack.copies)
        ack.error.CopyFrom(to_error_message(error))
        return ack


def _not_replicated(
    hosted: HostedQueue, replication: QueueReplication, about: dict[str, str], copies: int
) -> NotReplicated:
    name = display_name(hosted.record)
    return NotReplicated(
        f"queue {name} has done this, but its replicas did not get it in time: min_replicas is "
        f"{replication.min_replicas}; it counts once it is replicated; look at `stampede replicas --queue {name}`, or "
        "start another host",
        metadata={"queue": name, "copies": str(copies)} | about,
    )
