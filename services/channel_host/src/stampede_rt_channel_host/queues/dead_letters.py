"""Moves messages that failed too often, or that a taker gave up, to the dead-letter queue (paper, section 3.5).

A message stays in its queue until the dead-letter queue has acknowledged it. A move is an enqueue like any other. Its
producer id is computed from the queue, and its number is the message's seq. So the dead-letter queue stores the message
only once, even if an earlier move of it is still under way. A refused message may be moved again with the same number,
because the retry window keeps no refusals.
"""

from __future__ import annotations

import asyncio
import hashlib
import logging
import random
from collections.abc import Callable, Sequence
from itertools import chain
from typing import Any

import grpc

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.status import from_error_message, from_rpc_error
from stampede_rt.v1 import channel_service_pb2, item_pb2, raw_run_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt.wire.request_pieces import messages_of
from stampede_rt.wire.runs import select_items
from stampede_rt_channel_host.cluster.queue_directory import QueueDirectory
from stampede_rt_channel_host.core.queue import GIVEN_BACK, LEASE_EXPIRED, TERMINATED, DeadLetter
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.refusals import display_name
from stampede_rt_channel_host.queues.replica_acks import wait_for_replicas

logger = logging.getLogger(__name__)

ITEMS_PER_ATTEMPT_MAX = 16
ATTEMPT_SECONDS_MAX = 10.0
ROOM_WAIT_NANOS = 2_000_000_000
"""The time that an attempt waits for room in a dead-letter queue that blocks."""
_PAUSE_SECONDS_MIN, _PAUSE_SECONDS_MAX = 0.1, 30.0
_ENDS = {
    LEASE_EXPIRED: item_pb2.DELIVERY_END_LEASE_EXPIRED,
    GIVEN_BACK: item_pb2.DELIVERY_END_GIVEN_BACK,
    TERMINATED: item_pb2.DELIVERY_END_TERMINATED,
}
_ENQUEUE = "/stampede_rt.v1.QueueService/Enqueue"


class DeadLetterMover:
    """Runs one task for each queue that has messages to move. The task tries until all these messages are moved. Its
    pauses after failures grow.

    `may_move` says whether the queue still belongs to this host. `on_defect` gets the error of a task that fails.
    """

    def __init__(
        self,
        directory: QueueDirectory,
        dial: Callable[[str], grpc.aio.Channel],
        *,
        may_move: Callable[[HostedQueue], bool],
        on_defect: Callable[[BaseException], None],
    ) -> None:
        self._directory = directory
        self._dial = dial
        self._may_move = may_move
        self._on_defect = on_defect
        self._tasks: dict[HostedQueue, asyncio.Task[None]] = {}

    def new_dead_letters(self, hosted: HostedQueue) -> None:
        """Start moving, because the queue has messages to move. Idempotent."""
        if hosted not in self._tasks:
            task = asyncio.create_task(self._move_all(hosted), name="dead letters")
            self._tasks[hosted] = task
            task.add_done_callback(lambda done: self._ended(hosted, done))

    def close(self) -> None:
        """Stop all moves."""
        for task in list(self._tasks.values()):
            task.cancel()

    def _ended(self, hosted: HostedQueue, task: asyncio.Task[None]) -> None:
        del self._tasks[hosted]
        if not task.cancelled() and (failure := task.exception()) is not None:
            logger.error(
                "the task that moves dead letters ended with a defect", exc_info=failure, extra={"event": "task_defect"}
            )
            self._on_defect(failure)

    async def _move_all(self, hosted: HostedQueue) -> None:
        pause_s = _PAUSE_SECONDS_MIN
        # pauses after each failure; ends when the queue has nothing to move, or no longer belongs to this host
        while hosted.queue.has_dead_letters and self._may_move(hosted):
            try:
                await self._attempt(hosted)
                pause_s = _PAUSE_SECONDS_MIN
            except StampedeError as error:
                extra = {"event": "dead_letters_wait", "queue": display_name(hosted.record), "why": str(error)}
                logger.warning("dead letters cannot be moved yet; trying again", extra=extra)
                await asyncio.sleep(pause_s * (0.5 + random.random() / 2))
                pause_s = min(2 * pause_s, _PAUSE_SECONDS_MAX)

    async def _attempt(self, hosted: HostedQueue) -> None:
        """Move some messages. Raises the last error if some of them could not be moved."""
        found = await self._directory.resolve(hosted.record.policy.dead_letter_queue_id or b"")
        if (target := found.target) is None:
            raise Unavailable(f"the dead-letter queue {display_name(found.queue)} has no live host at present")
        items = hosted.queue.dead_letters(ITEMS_PER_ATTEMPT_MAX)
        await wait_for_replicas(hosted)
        connection = self._dial(target)
        try:
            async with asyncio.timeout(ATTEMPT_SECONDS_MAX):
                acks = await _enqueue(connection, _requests(hosted.record, found.queue, items))
        except grpc.RpcError as error:
            raise from_rpc_error(error, target) from error
        except TimeoutError:
            raise Unavailable(f"{target} did not take the messages in {ATTEMPT_SECONDS_MAX:g} s") from None
        finally:
            await connection.close(None)
        _conclude(hosted, items, acks)


def producer_id_of(record: RecordedQueue) -> int:
    """The producer id of the moves from a queue: the same at every host, never 0."""
    about = record.queue_id + record.incarnation.to_bytes(8, "little")
    return int.from_bytes(hashlib.blake2b(about, digest_size=8).digest(), "little") | 1


def _requests(source: RecordedQueue, target: RecordedQueue, items: Sequence[DeadLetter]) -> list[bytes]:
    """One encoded request for each message, because several messages might exceed the limit of one request."""
    requests = []
    for item in items:
        request = raw_run_pb2.RawEnqueueRequest(
            queue_id=target.queue_id,
            epoch=target.epoch,
            producer_id=producer_id_of(source),
            runs=[_enqueue_run(item, source)],
        )
        requests.append(request.SerializeToString())
    return requests


def _enqueue_run(item: DeadLetter, source: RecordedQueue) -> raw_run_pb2.RawEnqueueRun:
    return raw_run_pb2.RawEnqueueRun(
        first_number=item.seq,
        wait_nanos=ROOM_WAIT_NANOS,
        run=_run_of(item, source.policy.content_type or ""),
        origin=_origin_of(item, source).SerializeToString(),
    )


def _run_of(item: DeadLetter, content_type: str) -> bytes:
    """The message as its producer put it.

    A message without a content type gets its queue's content type, because the dead-letter queue may have another one.
    """
    single = select_items(item.run.body, [item.position])
    if content_type and not item_pb2.ItemRun.FromString(single).content_type:
        return single + item_pb2.ItemRun(content_type=content_type).SerializeToString()
    return single


def _origin_of(item: DeadLetter, source: RecordedQueue) -> item_pb2.DeadLetterOrigin:
    origin = item_pb2.DeadLetterOrigin(
        queue_id=source.queue_id,
        queue_name=source.name,
        seq=item.seq,
        incarnation=source.incarnation,
        enqueued_unix_nano=item.run.accepted_at,
    )
    if item.last is not None:
        origin.deliveries, origin.last_end = item.last.number, _ENDS[item.last.ended]
        origin.reason, origin.last_taker_id = item.last.reason, item.last.taker_id
        origin.last_taker_name = item.last.taker_name
    return origin


async def _enqueue(connection: grpc.aio.Channel, requests: Sequence[bytes]) -> list[channel_service_pb2.PutAck]:
    enqueue: Any = connection.stream_stream(_ENQUEUE, response_deserializer=pb.EnqueueResponse.FromString)
    acks: list[channel_service_pb2.PutAck] = []
    async for response in enqueue(chain.from_iterable(map(messages_of, requests))):
        acks += response.acks
    if len(acks) != len(requests):
        raise Unavailable(f"the dead-letter queue answered {len(acks)} of {len(requests)} enqueues")
    return acks


def _conclude(hosted: HostedQueue, items: Sequence[DeadLetter], acks: Sequence[channel_service_pb2.PutAck]) -> None:
    """Remove the accepted messages from their queue. The next attempts move the refused messages after all others.

    Raises the last refusal, if there is one.
    """
    failure: StampedeError | None = None
    for item, ack in zip(items, acks, strict=True):
        if ack.HasField("first_seq") and not ack.HasField("error"):  # else its replicas may lack the message
            hosted.dead_letter_moved(item.seq)
            continue
        failure = from_error_message(ack.rejections[0].error if ack.rejections else ack.error)
        hosted.queue.postpone_dead_letter(item.seq)
    if failure is not None:
        raise failure
