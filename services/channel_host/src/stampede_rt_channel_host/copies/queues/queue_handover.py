"""The former owner's side of a move of a queue or mailbox (paper, section 3.5: queues migrate).

The host ends the streams of the queue, lets all calls wait, and sends everything. Then the first of
two commands in the directory decides the owner: the command of the new owner, or the command by which this host takes
the queue back.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import Awaitable, Iterator

from grpc.aio import InternalError

from stampede_rt.errors import InvalidArgument, Overloaded, QueueNotFound, StaleBinding, StampedeError
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.channels.move_under_way import HELD_SECONDS_MAX
from stampede_rt_channel_host.cluster.identity import ID_BYTES, HostIdentity
from stampede_rt_channel_host.copies.feed_callers import FeedCallers
from stampede_rt_channel_host.copies.moves.move_directory import MoveDirectory
from stampede_rt_channel_host.copies.moves.move_slots import MoveSlots
from stampede_rt_channel_host.copies.moves.outgoing_moves import RETRY_SECONDS, OutgoingMoves
from stampede_rt_channel_host.copies.queues.queue_messages import parts_of
from stampede_rt_channel_host.core.queue import QueueHandoff
from stampede_rt_channel_host.core.queue.handoff import freeing
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues import refusals
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.queue_content import KeptQueue
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_channel_host.queues.refusals import display_name
from stampede_rt_runtime.rpc import Context

logger = logging.getLogger(__name__)


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
        is_committed = False
        try:
            is_committed = await self._hand_over(hosted, opening.host_id, context)
        except TimeoutError:
            raise Overloaded(f"the move of queue {display_name(hosted.record)} took too long; move it again") from None
        except InternalError:
            pass  # the caller has gone; `_end` learns from the directory whether the queue stays
        finally:
            self._slots.give_back(hosted.record)
            end = self._end(hosted, opening.host_id, is_committed=is_committed)
            self._moves.start(end, "end of a move of a queue")

    async def _hand_over(self, hosted: HostedQueue, host_id: bytes, context: Context) -> bool:
        """Send the queue. Returns whether the new owner says that it is the owner."""
        async with asyncio.timeout(HELD_SECONDS_MAX):
            await hosted.hold(refusals.is_moving(hosted.record))
            permit = self._moves.allowed.permit(hosted.record.queue_id, hosted.epoch, host_id)
            state = await hosted.exported()
            next_step = await hosted.wait_until_replicated()
            keeping = asyncio.ensure_future(self._keep(hosted, state, next_step))
            try:
                await _send(parts_of(state, permit, next_step), keeping, context)
                answer = await context.read()
            finally:
                if keeping.done():  # otherwise a thread may still read the state
                    self._queues.scheduler.begin(freeing(state))
                keeping.cancel()
        return isinstance(answer, pb.HandOverQueueRequest) and answer.committed_epoch > 0

    async def _keep(self, hosted: HostedQueue, state: QueueHandoff, next_step: int) -> None:
        """Make the copy that stays here if the queue moves. If the new owner held a replica, this copy replaces it.

        From the commit on, the directory knows this copy as in sync. This host may learn of the commit late or never.
        Raises Overloaded if there is no room for the copy: then the queue does not move.
        """
        if not next_step:
            return
        made_nanos = time.monotonic_ns()
        core = await asyncio.to_thread(self._queues.copies.restored, hosted.record, state)
        if hosted.moving is not None:
            charge = self._queues.copies.room_for(hosted.record, core, sum(len(run.body) for run in state.runs))
            hosted.moving.kept = KeptQueue(core, next_step, made_nanos, charge)

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


async def _send(parts: Iterator[pb.HandOverQueueResponse], keeping: Awaitable[None], context: Context) -> None:
    """Send the queue. The last part has the permit, with which the new owner can commit. This part waits for
    `keeping`.
    """
    while (part := await asyncio.to_thread(next, parts, None)) is not None:
        if part.ends:
            await keeping
        await context.write(part)


async def _try_again(record: RecordedQueue, error: StampedeError) -> None:
    extra = {"event": "move_undecided", "queue": display_name(record), "why": str(error)}
    logger.info("cannot ask the directory for the outcome of a move; the host tries again", extra=extra)
    await asyncio.sleep(RETRY_SECONDS)
