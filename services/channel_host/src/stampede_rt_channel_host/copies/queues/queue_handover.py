"""The former owner's side of a move of a queue or mailbox (paper, section 3.5: queues migrate).

The host sends the whole queue, and the steps since then, while callers use the queue. Then it ends the streams of the
queue, lets all calls wait, and sends the last steps. The first of two commands in the directory decides the owner: the
command of the new owner, or the command by which this host takes the queue back.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import Iterator

from grpc.aio import InternalError

from stampede_rt.errors import InvalidArgument, Overloaded, QueueNotFound, StaleBinding, StampedeError
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.channels.move_under_way import HELD_SECONDS_MAX
from stampede_rt_channel_host.cluster.identity import ID_BYTES, HostIdentity
from stampede_rt_channel_host.copies.feed_callers import FeedCallers
from stampede_rt_channel_host.copies.moves.move_directory import MoveDirectory
from stampede_rt_channel_host.copies.moves.move_slots import MoveSlots
from stampede_rt_channel_host.copies.moves.outgoing_moves import RETRY_SECONDS, OutgoingMoves
from stampede_rt_channel_host.copies.queues.queue_messages import PART_BYTES, parts_of
from stampede_rt_channel_host.copies.queues.queue_steps import STEPS_PER_REQUEST, step_parts
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues import refusals
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.queue_content import KeptQueue
from stampede_rt_channel_host.queues.queue_copying import QueueCopying
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_channel_host.queues.refusals import display_name
from stampede_rt_runtime.rpc import Context

logger = logging.getLogger(__name__)

COPY_SECONDS_MAX = 60.0  # for the whole queue and the steps since then, while callers use the queue
CATCH_UP_SECONDS_MAX = 10.0  # then the host holds the queue, although the new owner may lack many steps


class QueueHandovers:
    """The moves of queues away from one host. `moves` does the work that continues after the end of a stream."""

    def __init__(
        self, identity: HostIdentity, queues: QueueStore, directory: MoveDirectory, moves: OutgoingMoves,
        callers: FeedCallers,
    ) -> None:  # fmt: skip
        """`callers` checks that a caller is the host that it claims to be."""
        self._identity = identity
        self._queues = queues
        self._directory = directory
        self._moves = moves
        self._callers = callers
        self._slots = MoveSlots(f"away from host {identity.name}", of_queues=True)

    async def serve(self, context: Context) -> None:
        """Hand one queue over. Raises the errors of MigrationService.HandOverQueue."""
        first = await context.read()
        opening = first.open if isinstance(first, pb.HandOverQueueRequest) else pb.HandOverQueueOpen()
        if len(opening.queue_id) != ID_BYTES or len(opening.host_id) != ID_BYTES:
            raise InvalidArgument(
                "the first request has no `open` with a queue_id and a host_id of 16 bytes; state them"
            )
        await self._callers.check(context, opening.host_id)
        hosted = await self._queues.use(opening.queue_id, opening.epoch)
        name = f"queue {display_name(hosted.record)}"
        self._moves.allowed.check(name, opening.queue_id, hosted.epoch, opening.host_id)
        self._slots.take(hosted.record)
        try:
            copying = hosted.begin_copying()
            try:
                await self._copy_and_hold(hosted, copying, opening, context)
            finally:
                self._queues.scheduler.begin(hosted.end_copying())
        except TimeoutError:
            raise Overloaded(f"the move of queue {display_name(hosted.record)} took too long; move it again") from None
        except InternalError:
            pass  # the caller has gone; `_end` learns from the directory whether the queue stays
        finally:
            self._slots.give_back(hosted.record)

    async def _copy_and_hold(
        self, hosted: HostedQueue, copying: QueueCopying, opening: pb.HandOverQueueOpen, context: Context
    ) -> None:
        """Send most of the queue while callers use it. Then hold the queue, and hand it over."""
        if opening.takes_steps:
            async with asyncio.timeout(COPY_SECONDS_MAX):
                await self._send_copy(hosted, copying, context)
            if await self._queues.use(opening.queue_id, opening.epoch) is not hosted:
                raise refusals.is_moving(hosted.record)
        is_committed = False
        try:
            is_committed = await self._hand_over(hosted, copying, opening, context)
        finally:
            end = self._end(hosted, opening.host_id, is_committed=is_committed)
            self._moves.start(end, "end of a move of a queue")

    async def _send_copy(self, hosted: HostedQueue, copying: QueueCopying, context: Context) -> None:
        """Send the whole queue, and the steps since then, until few steps are left."""
        snapshot = await self._queues.scheduler.do(hosted.copied(copying))
        try:
            await _send(parts_of(snapshot, next_step=snapshot.next_step, steps_follow=True), context)
        finally:
            self._queues.scheduler.begin(snapshot.freeing())
        answer = await context.read()
        if not isinstance(answer, pb.HandOverQueueRequest) or not answer.has_copy:
            raise InvalidArgument(
                "the calling host has not said that it has the copy; install the same release on both"
            )
        ends_s = time.monotonic() + CATCH_UP_SECONDS_MAX
        while await self._send_steps(hosted, copying, context) and time.monotonic() < ends_s:
            pass

    async def _send_steps(self, hosted: HostedQueue, copying: QueueCopying, context: Context) -> bool:
        """Send some steps. Returns whether there were more."""
        now = hosted.check_copying(copying)
        steps = copying.steps.take(STEPS_PER_REQUEST, PART_BYTES)
        has_more = len(copying.steps) > 0
        parts = [part for step in steps for part in step_parts(step, now)]
        if sum(part.ByteSize() for part in parts) > PART_BYTES:
            for part in parts:
                await context.write(pb.HandOverQueueResponse(steps=[part]))
        elif parts:
            await context.write(pb.HandOverQueueResponse(steps=parts))
        return has_more

    async def _hand_over(
        self, hosted: HostedQueue, copying: QueueCopying, opening: pb.HandOverQueueOpen, context: Context
    ) -> bool:
        """Hold the queue, and send the rest. Returns whether the new owner says that it is the owner."""
        async with asyncio.timeout(HELD_SECONDS_MAX):
            held_nanos = time.monotonic_ns()
            await hosted.hold(refusals.is_moving(hosted.record))
            permit = self._moves.allowed.permit(hosted.record.queue_id, hosted.epoch, opening.host_id)
            if not opening.takes_steps:
                await self._send_held(hosted, copying, permit, context)
            else:
                next_step = await self._keep(hosted, held_nanos)
                while await self._send_steps(hosted, copying, context):
                    pass
                facts, waited_nanos = pb.HandedQueueFacts(next_step=next_step), time.monotonic_ns() - held_nanos
                await context.write(
                    pb.HandOverQueueResponse(is_held=True, permit=permit, facts=facts, held_nanos=waited_nanos)
                )
            answer = await context.read()
        return isinstance(answer, pb.HandOverQueueRequest) and answer.committed_epoch > 0

    async def _send_held(self, hosted: HostedQueue, copying: QueueCopying, permit: bytes, context: Context) -> None:
        """Send the whole held queue to a host of an earlier release."""
        held_nanos = time.monotonic_ns()
        snapshot = await self._queues.scheduler.do(hosted.copied(copying))
        try:
            next_step = await self._keep(hosted, held_nanos)
            await _send(parts_of(snapshot, permit, next_step), context)
        finally:
            self._queues.scheduler.begin(snapshot.freeing())

    async def _keep(self, hosted: HostedQueue, held_nanos: int) -> int:
        """Wait until the replicas have the held queue. If the queue moves, this host keeps it as a replica. If the new
        owner held a replica, this one replaces it. Returns the number of the next step; 0 without replicas.

        From the commit on, the directory knows this replica as in sync. This host may learn of the commit late or
        never. Raises Overloaded if this host has no room for another replica, and Unavailable if the replicas lack
        steps: then the queue does not move.
        """
        next_step = await hosted.wait_until_replicated()
        if next_step and hosted.moving is not None:
            self._queues.copies.check_number()
            hosted.moving.kept = KeptQueue(hosted.queue, next_step, held_nanos)
        return next_step

    async def _end(self, hosted: HostedQueue, host_id: bytes, *, is_committed: bool) -> None:
        """Drop the queue if it has moved; otherwise serve it again. Asks the directory until the outcome is known."""
        record, request_id = hosted.record, secrets.token_bytes(16)
        if is_committed:
            self._gone(hosted, refusals.moved_to(record, host_id))
        while self._is_under_way(hosted):
            try:
                present = await self._directory.commit_queue(record.queue_id, record.epoch, request_id)
                if not self._is_under_way(hosted):
                    return
                self._queues.adopt(present)
                extra = {"event": "move_ended", "queue": display_name(record)}
                logger.info("a move of a queue has failed; the queue stays", extra=extra)
            except StaleBinding:
                await self._learn_owner(hosted)
            except QueueNotFound:
                self._queues.forget(record.queue_id, refusals.deleted(record))
            except StampedeError as error:
                await _try_again(record, error)

    async def _learn_owner(self, hosted: HostedQueue) -> None:
        """Learn that another host owns the queue, or that this host has another epoch."""
        try:
            present, _ = await self._directory.queue(hosted.record.queue_id)
        except StampedeError:
            await asyncio.sleep(RETRY_SECONDS)
            return
        if present.host_id != self._identity.host_id:
            self._gone(hosted, refusals.moved(present))
        elif self._is_under_way(hosted):
            self._queues.adopt(present)

    def _is_under_way(self, hosted: HostedQueue) -> bool:
        """Whether this host still has the queue, and a move of it away is not decided."""
        return self._queues.serves(hosted) and hosted.moving is not None

    def _gone(self, hosted: HostedQueue, error: StampedeError) -> None:
        name = display_name(hosted.record)
        logger.info("a queue has moved away", extra={"event": "queue_moved_away", "queue": name})
        if self._queues.serves(hosted):
            self._queues.forget(hosted.record.queue_id, error)


async def _send(parts: Iterator[pb.HandOverQueueResponse], context: Context) -> None:
    """Send the queue. A thread makes the parts, because nothing changes their values."""
    while (part := await asyncio.to_thread(next, parts, None)) is not None:
        await context.write(part)


async def _try_again(record: RecordedQueue, error: StampedeError) -> None:
    extra = {"event": "move_undecided", "queue": display_name(record), "why": str(error)}
    logger.info("cannot ask the directory for the outcome of a move; the host tries again", extra=extra)
    await asyncio.sleep(RETRY_SECONDS)
