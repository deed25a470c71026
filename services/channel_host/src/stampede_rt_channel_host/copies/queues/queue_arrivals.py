"""Moves queues and mailboxes to this host, which becomes their owner (paper, section 3.5: queues migrate)."""

from __future__ import annotations

import asyncio
import logging
import secrets
import time
from collections.abc import Callable
from contextlib import suppress
from functools import partial
from typing import Any, NamedTuple

import grpc

from stampede_rt.errors import InvalidArgument, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.v1 import migration_service_pb2_grpc
from stampede_rt_channel_host.channels import refusals
from stampede_rt_channel_host.channels.limits.memory import Charge
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.copies.moves.incoming_moves import until_known
from stampede_rt_channel_host.copies.moves.move_directory import MoveDirectory
from stampede_rt_channel_host.copies.moves.move_slots import MoveSlots
from stampede_rt_channel_host.copies.queues.queue_messages import ArrivingQueue
from stampede_rt_channel_host.copies.queues.queue_steps import ArrivingParts, WholeQueue
from stampede_rt_channel_host.core.channel.pieces import run_to_end
from stampede_rt_channel_host.core.queue import QueueCore, QueueLimits
from stampede_rt_channel_host.core.queue.handoff import freeing
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.queue_content import QueueContent
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_channel_host.queues.refusals import display_name, moved

logger = logging.getLogger(__name__)

COPY_SECONDS_MAX = 60.0  # in this time, the former owner copies the queue in pieces, and then sends the first part
PART_SECONDS_MAX = 10.0  # in this time, the former owner may wait for the ends of streams
HANDOVER_SECONDS_MAX = 90.0  # longer than the waits of the former owner, which ends the move earlier


class MovedQueue(NamedTuple):
    """A queue that has moved here. `blackout_nanos`: the time for which its calls waited; 0: it was here already."""

    hosted: HostedQueue
    blackout_nanos: int


class _ArrivedQueue(NamedTuple):
    """A queue that its former owner holds. `held_since_nanos`: since when, by a steady clock."""

    content: QueueContent
    permit: bytes
    held_since_nanos: int


class QueueArrivals:
    """The moves of queues to one host, on its event loop. `dial` opens connections to other hosts."""

    def __init__(
        self, identity: HostIdentity, queues: QueueStore, directory: MoveDirectory,
        dial: Callable[[str], grpc.aio.Channel],
    ) -> None:  # fmt: skip
        self._identity = identity
        self._queues = queues
        self._directory = directory
        self._dial = dial
        self._moves: dict[bytes, asyncio.Task[MovedQueue]] = {}  # by queue
        self._slots = MoveSlots(f"to host {identity.name}", of_queues=True)
        self._is_closing = False

    async def move_here(self, record: RecordedQueue, target: str | None) -> MovedQueue:
        """Make this host the owner of a queue, which is at `target`. Joins a move of this queue that is under way.

        The move continues if the caller is cancelled. Raises the errors of MigrationService.MoveHere.
        """
        known = self._queues.known(record.queue_id)
        is_here = known is not None and known.record.epoch > record.epoch  # since the directory has given `record`
        if is_here or record.host_id == self._identity.host_id:
            return MovedQueue(await self._queues.use(record.queue_id, None if is_here else record.epoch), 0)
        move = self._moves.get(record.queue_id) or self._begin_move(record, target)
        return await asyncio.shield(move)

    def _begin_move(self, record: RecordedQueue, target: str | None) -> asyncio.Task[MovedQueue]:
        if self._is_closing:
            raise refusals.SHUTTING_DOWN
        if target is None:
            raise Unavailable(f"the host of queue {display_name(record)} is lost, and so are its messages; open it")
        self._slots.take(record)
        move = asyncio.create_task(self._move(record, target), name=f"move of {display_name(record)}")
        self._moves[record.queue_id] = move
        move.add_done_callback(lambda done: self._over(record, done))
        return move

    def close(self) -> None:
        """Begin no further moves, because the host stops."""
        self._is_closing = True

    async def ended(self) -> None:
        """Wait until no move is under way. Call `close` first."""
        while self._moves:
            await asyncio.wait([*self._moves.values()])

    async def aclose(self) -> None:
        """End all moves."""
        for task in [*self._moves.values()]:
            task.cancel()
        await asyncio.gather(*self._moves.values(), return_exceptions=True)

    def _over(self, record: RecordedQueue, done: asyncio.Task[MovedQueue]) -> None:
        del self._moves[record.queue_id]
        self._slots.give_back(record)
        self._queues.arriving.give_up(record.queue_id)
        if not done.cancelled() and (failure := done.exception()) is not None:
            logger.info("a move of a queue has failed", extra={"event": "move_failed", "why": str(failure)})

    async def _move(self, record: RecordedQueue, target: str) -> MovedQueue:
        self._queues.forget(record.queue_id, moved(record))  # this host may have owned the queue before
        channel = self._dial(target)
        call = migration_service_pb2_grpc.MigrationServiceStub(channel).HandOverQueue()
        room = self._queues.memory.charge_for(record.created_by)
        try:
            async with asyncio.timeout(HANDOVER_SECONDS_MAX):
                opening = pb.HandOverQueueOpen(
                    queue_id=record.queue_id, epoch=record.epoch, host_id=self._identity.host_id, takes_steps=True
                )
                await call.write(pb.HandOverQueueRequest(open=opening))
                arrived = await self._arrived(record, call, room)
            room.set(0)
            adopted = await self._take_over(record, arrived.content, arrived.permit)
            await _report_commit(call, adopted.epoch)
        except grpc.RpcError as error:
            raise from_rpc_error(error, target) from error
        except asyncio.InvalidStateError:  # grpc raises this for a write after the end of the call
            raise Unavailable(f"{target} has ended the move of queue {display_name(record)}; move it again") from None
        except TimeoutError:
            raise Unavailable(
                f"{target} did not hand queue {display_name(record)} over in time; move it again"
            ) from None
        finally:
            room.set(0)
            call.cancel()
            await channel.close(None)
        logger.info("a queue has moved here", extra={"event": "queue_moved_here", "queue": display_name(record)})
        return MovedQueue(
            await self._queues.use(adopted.queue_id, adopted.epoch), time.monotonic_ns() - arrived.held_since_nanos
        )

    async def _arrived(self, record: RecordedQueue, call: Any, room: Charge) -> _ArrivedQueue:
        """The whole queue, when its former owner holds it. Raises the errors of `_receive`, and InvalidArgument."""
        began_nanos = time.monotonic_ns()
        first = await self._part(call, COPY_SECONDS_MAX)
        as_of, arriving = self._queues.now(), ArrivingQueue()
        try:
            await self._receive(arriving, first, call, room)
            core = await asyncio.to_thread(self._restored, record, arriving, as_of)
        finally:
            self._queues.scheduler.begin(arriving.freeing())
        journal = core.journal(arriving.next_step) if arriving.next_step else None
        content = QueueContent(core, journal)
        if not arriving.steps_follow:  # the former owner has an earlier release
            return _ArrivedQueue(content, arriving.permit, began_nanos)
        try:
            return await self._followed(content, call, room)
        except BaseException:
            self._queues.scheduler.begin(content.emptying())
            raise

    async def _followed(self, content: QueueContent, call: Any, room: Charge) -> _ArrivedQueue:
        """The copy, after all steps that the former owner has made since. Raises the errors of `_part`, Overloaded, and
        InvalidArgument.
        """
        core, journal, parts = content.core, content.journal, ArrivingParts()
        if journal is None:
            raise InvalidArgument("the former owner of the queue has not numbered its steps; move it again")
        room.set(0)
        room.claim(core.footprint_bytes)
        await call.write(pb.HandOverQueueRequest(has_copy=True))
        while not (response := await self._part(call)).is_held:
            room.claim(response.ByteSize())
            for step in parts.add(response.steps):
                if isinstance(step, WholeQueue):
                    raise InvalidArgument("the former owner of the queue has sent it twice; move it again")
                journal.apply(step[0], self._queues.now() - step[1])
            room.set(core.footprint_bytes + journal.size_bytes + parts.size_bytes)
        held_since_nanos = time.monotonic_ns() - response.held_nanos
        if not response.facts.next_step:
            self._queues.scheduler.begin(journal.stopping())
        content = QueueContent(core, journal if response.facts.next_step else None)
        return _ArrivedQueue(content, response.permit, held_since_nanos)

    async def _part(self, call: Any, seconds: float = PART_SECONDS_MAX) -> pb.HandOverQueueResponse:
        """The next response. Raises Unavailable if there is none, and TimeoutError after `seconds`."""
        async with asyncio.timeout(seconds):
            part = await call.read()
        if not isinstance(part, pb.HandOverQueueResponse):
            raise Unavailable("the former owner of the queue has ended the move; move it again")
        return part

    async def _receive(self, arriving: ArrivingQueue, part: pb.HandOverQueueResponse, call: Any, room: Charge) -> None:
        """Receive all parts of the queue. `part`: the first one. Raises Overloaded if there is no room for them, and
        the errors of `_part`.
        """
        while True:
            room.claim(part.ByteSize())
            arriving.add(part)
            room.set(arriving.size_bytes)
            if arriving.is_whole:
                return
            part = await self._part(call)

    def _restored(self, record: RecordedQueue, arriving: ArrivingQueue, as_of: int) -> QueueCore:
        """The queue. A thread does this work, because it takes some microseconds for each message.

        `as_of`: when the first part came, by this host's clock. If the former owner serves the queue meanwhile, the
        leases count from then on.
        """
        state = arriving.state()
        restore = QueueCore.restored if arriving.steps_follow else QueueCore.restore
        core = restore(
            QueueLimits.of(record.policy),
            state,
            as_of if arriving.steps_follow else self._queues.now(),
            incarnation=record.incarnation,
            name=display_name(record),
            may_serve=self._queues.may_serve,
        )
        run_to_end(freeing(state))  # in one step the interpreter would run no other thread meanwhile
        return core

    async def _take_over(self, record: RecordedQueue, content: QueueContent, permit: bytes) -> RecordedQueue:
        """Become the owner. A caller that asks for the queue right after the commit gets it with its messages."""
        self._queues.arriving.expect(record, content)
        self._queues.check_room(record)
        request_id = secrets.token_bytes(16)
        commit = partial(self._directory.commit_queue, record.queue_id, record.epoch, request_id, permit)
        registrations = self._queues.registrations
        adopted = await until_known(commit)
        if registrations == self._queues.registrations:
            self._queues.adopt(adopted)
        else:  # the lease had ended, and the queue may have another owner by now
            await self._queues.use(adopted.queue_id, adopted.epoch)
        return adopted


async def _report_commit(call: Any, epoch: int) -> None:
    """Tell the former owner that this host owns the queue. If the former owner has gone, it learns this from the
    directory.
    """
    with suppress(grpc.RpcError, asyncio.InvalidStateError):
        await call.write(pb.HandOverQueueRequest(committed_epoch=epoch))
        await call.done_writing()
