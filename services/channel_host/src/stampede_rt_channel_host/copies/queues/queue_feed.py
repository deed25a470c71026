"""The owner's side of the replicas of queues: keeps them, and feeds each over a stream of its own."""

from __future__ import annotations

import asyncio
import logging
from collections.abc import Callable
from typing import Any

import grpc
from google.protobuf.message import DecodeError

from stampede_rt.errors import InvalidArgument, Overloaded, StampedeError, Unavailable
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.cluster.records import queue_message
from stampede_rt_channel_host.cluster.task_failures import first_failure
from stampede_rt_channel_host.copies.queues.queue_messages import PART_BYTES
from stampede_rt_channel_host.copies.queues.queue_puts import encode_request, read_answer
from stampede_rt_channel_host.copies.queues.queue_steps import STEPS_PER_REQUEST, step_parts, whole_parts
from stampede_rt_channel_host.copies.sent_ahead import SentAhead
from stampede_rt_channel_host.core.queue import JOURNAL_BYTES_MAX, AheadPut
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.queue_replication import QueueReplication
from stampede_rt_channel_host.queues.refusals import display_name
from stampede_rt_runtime.sockets.dialing import HostStream

logger = logging.getLogger(__name__)

METHOD = "/stampede_rt.v1.MigrationService/FeedQueue"
REQUEST_SECONDS = 0.2  # a replica that is silent for a second is out of sync
ANSWER_SECONDS_MAX = 3.0
WRITE_SECONDS_MAX = 10.0
SAME_TURN_BYTES_MAX = 2**18  # a larger step is left to the task of the feed


class QueueFeedStream:
    """Feeds one replica of a queue over one stream. `target`: the gatekeeper of the replica's host.

    `scheduler` does long work in pieces.
    """

    def __init__(
        self, hosted: HostedQueue, replication: QueueReplication, now: Callable[[], int], owner_host_id: bytes,
        host_id: bytes, target: str, scheduler: PieceScheduler,
    ) -> None:  # fmt: skip
        self._hosted = hosted
        self._scheduler = scheduler
        self._replication = replication
        self._now = now
        self._owner_host_id = owner_host_id
        self._host_id = host_id
        self._target = target
        self._wakeup = asyncio.Event()
        self._sent_record = b""
        self._held_step = 0  # the replica has reported that it has all steps before this one
        self._last_received_s = 0.0  # the loop time of the last answer of the replica
        self._waiting_call: HostStream | None = None  # while the feed waits for a step
        self._failure: Exception | None = None  # an error of a call from outside of the feed's tasks; it ends the feed
        self._ahead: SentAhead | None = None  # if the replica takes puts before the queue stores them
        self.next_step = replication.journal.next_step

    def wake(self) -> None:
        """Note that the queue has a new step. Sends it in this turn of the event loop if the replica has all other
        steps.

        Raises nothing, because the queue has made the step: an error ends the feed.
        """
        if self._ahead is not None and self._ahead.stored(self._replication.journal.next_step):
            return
        try:
            is_sent = self._waiting_call is not None and self._send_now(self._waiting_call)
        except Exception as error:  # noqa: BLE001 - the task of the feed raises it
            self._fail(error)
            return
        if not is_sent:
            self._wakeup.set()

    def send_ahead(self, put: AheadPut) -> None:
        """Send a put that the queue has accepted and is about to store, if the replica has everything else.

        Then the replica works while this host stores the message. Raises nothing, as `wake`.
        """
        ahead = None if len(put.body) > PART_BYTES or self._owes_record else self._ahead
        try:
            write = None if self._waiting_call is None else self._free_write(self._waiting_call)
            if ahead is not None and write is not None and put.number == self.next_step:
                ahead.sent(put.number + 1)
                self.next_step = put.number + 1
                write(put)
        except Exception as error:  # noqa: BLE001 - as in `wake`
            self._fail(error)

    def end(self, error: StampedeError) -> None:
        """See `OwnersFeed`."""
        self._fail(error)

    def take_back(self) -> None:
        """See `OwnersFeed`."""
        error = None if self._ahead is None else self._ahead.take_back()
        if error is not None:
            self._replication.discard(self._host_id, self)  # no report counts any more
            self._fail(error)

    def _fail(self, error: Exception) -> None:
        """Let a task of the feed raise the error."""
        self._failure, self._waiting_call = error, None
        self._wakeup.set()

    async def run(self, channel: grpc.aio.Channel) -> None:
        """Feed the replica until the stream ends. Raises StampedeError."""
        call = channel.stream_stream(METHOD, request_serializer=encode_request, response_deserializer=read_answer)()
        try:
            place = await self._open(call)
            async with asyncio.TaskGroup() as sides:
                self._replication.add(self._host_id, self)
                sides.create_task(self._read(call))
                await self._begin(call, place)
                await self._send_steps(call)
        except BaseExceptionGroup as group:
            raise self._as_stampede_error(first_failure(group)) from group
        except (grpc.RpcError, asyncio.InvalidStateError, TimeoutError, DecodeError) as error:
            raise self._as_stampede_error(error) from error
        finally:
            self._replication.discard(self._host_id, self)
            call.cancel()

    async def _open(self, call: Any) -> pb.FeedQueueResponse:
        async with asyncio.timeout(ANSWER_SECONDS_MAX):
            await call.write(self._request(owner_host_id=self._owner_host_id))
            return self._answer(await call.read())

    def _answer(self, response: object) -> pb.FeedQueueResponse:
        if not isinstance(response, pb.FeedQueueResponse):
            raise Unavailable(f"the host at {self._target} has ended the feed of a replica")
        return response

    def _next_step_of(self, response: object) -> int:
        """The step before which the replica has all steps; 0: it has no copy."""
        return response if isinstance(response, int) else self._answer(response).next_step

    def _request(self, **fields: Any) -> pb.FeedQueueRequest:
        request = pb.FeedQueueRequest(**fields)
        if self._owes_record:
            self._sent_record = self._hosted.record.message
            request.queue.CopyFrom(queue_message(self._hosted.record))
        return request

    @property
    def _owes_record(self) -> bool:
        """Whether the replica does not know the present record of the queue."""
        return self._hosted.record.message != self._sent_record

    async def _begin(self, call: Any, place: pb.FeedQueueResponse) -> None:
        """Continue at the place of the copy, or send the whole queue."""
        replication = self._replication
        replication.journal.takes_changes &= place.takes_changes
        if place.takes_puts:
            self._ahead = SentAhead(self._host_id, replication.diverged_host_ids)
        if self._continues(place):
            self.next_step = self._held_step = place.next_step
            replication.report(self._host_id, self, place.next_step)
            return
        if not await replication.begin_anew(self._host_id):
            raise Unavailable("the directory has not noted yet that the replica begins anew")
        snapshot = await self._scheduler.do(self._hosted.snapshot(replication))
        self.next_step = snapshot.next_step
        parts, begins_anew = whole_parts(snapshot, snapshot.next_step), True
        try:
            while (part := await asyncio.to_thread(next, parts, None)) is not None:
                await self._write(call, self._request(begins_anew=begins_anew, parts=[part]))
                begins_anew = False
        finally:
            self._scheduler.begin(snapshot.freeing())

    def _continues(self, place: pb.FeedQueueResponse) -> bool:
        """Whether the copy has only steps of this owner, and the journal has all later ones."""
        replication, hosted = self._replication, self._hosted
        if self._host_id in replication.diverged_host_ids:
            return False
        if not place.next_step or place.incarnation != hosted.queue.incarnation:
            return False
        # A copy of a former owner continues only if that owner was the last one before this owner, and if the copy has
        # no steps that the former owner made after this owner had taken over.
        since = replication.since_epoch
        is_beyond = place.owner_epoch + 1 < since or place.next_step > replication.start
        if place.owner_epoch < since and is_beyond:
            return False
        steps = replication.journal.steps_from(place.next_step, JOURNAL_BYTES_MAX)
        return steps is not None and (place.takes_changes or not any(one.has_changes for one in steps))

    async def _send_steps(self, call: Any) -> None:
        owes_sign = True  # after REQUEST_SECONDS without a step the owner owes the replica a sign of life
        self._last_received_s = asyncio.get_running_loop().time()
        while True:  # until an error ends the stream, or the caller cancels it
            if self._failure is not None:
                raise self._failure
            if asyncio.get_running_loop().time() - self._last_received_s > ANSWER_SECONDS_MAX:
                raise TimeoutError
            self._wakeup.clear()
            steps = self._replication.journal.steps_from(self.next_step, PART_BYTES)
            if steps is None:
                name = display_name(self._hosted.record)
                raise Overloaded(
                    f"a replica of queue {name} cannot catch up: it lacks steps that the owner has dropped"
                )
            steps = steps[:STEPS_PER_REQUEST]
            parts = [part for step in steps for part in step_parts(step, self._now())]
            if sum(part.ByteSize() for part in parts) > PART_BYTES:  # the other host takes messages of 2 * PART_BYTES
                for part in parts:
                    await self._write(call, self._request(parts=[part]))
            elif parts or owes_sign or self._owes_record:
                await self._write(call, self._request(parts=parts))
            if steps:
                self.next_step = steps[-1].number + 1
                if self.next_step < self._replication.journal.next_step:
                    await asyncio.sleep(0)
            owes_sign = not steps and not await self._wait_for_step(call)

    async def _wait_for_step(self, call: Any) -> bool:
        """Wait for a step that `wake` does not send itself, for REQUEST_SECONDS at most. Returns whether one came."""
        self._waiting_call = call if isinstance(call, HostStream) else None
        try:
            async with asyncio.timeout(REQUEST_SECONDS):
                await self._wakeup.wait()
        except TimeoutError:
            return False
        finally:
            self._waiting_call = None
        return True

    def _send_now(self, call: HostStream) -> bool:
        """Send the new step if the replica has all earlier ones, and the transport takes it immediately."""
        write = self._free_write(call)
        steps = None if write is None else self._replication.journal.steps_from(self.next_step, PART_BYTES)
        if write is None or not steps or len(steps) > 1 or steps[0].size_bytes > SAME_TURN_BYTES_MAX:
            return False
        write(self._request(parts=step_parts(steps[0], self._now())))
        self.next_step = steps[0].number + 1
        return True

    def _free_write(self, call: HostStream) -> Callable[[Any], None] | None:
        """Writes in this turn. None if the replica lacks earlier steps, or the next one has to wait."""
        return call.write_now if self._held_step >= self.next_step else None

    async def _write(self, call: Any, request: pb.FeedQueueRequest) -> None:
        async with asyncio.timeout(WRITE_SECONDS_MAX):
            await call.write(request)

    async def _read(self, call: Any) -> None:
        while True:  # until an error ends the stream, or the caller cancels it
            self._note_answer(self._next_step_of(await call.read()))  # `_send_steps` notices a silent replica
            if isinstance(call, HostStream):
                call.answer_in_same_turn(self._take_in_same_turn)

    def _take_in_same_turn(self, response: object) -> bool:
        """Take an answer in the turn of the event loop in which it comes, because callers wait for it."""
        self._note_answer(self._next_step_of(response))
        return True

    def _note_answer(self, next_step: int) -> None:
        self._last_received_s = asyncio.get_running_loop().time()
        if next_step:
            self._held_step = next_step
            self._replication.report(self._host_id, self, next_step)

    def _as_stampede_error(self, error: BaseException) -> BaseException:
        """The StampedeError for the error of a broken stream; any other error unchanged."""
        if isinstance(error, grpc.RpcError):
            return from_rpc_error(error, self._target)
        if isinstance(error, DecodeError):
            text = f"{self._target} sent bytes that are no FeedQueueResponse; install the same release on both hosts"
            return InvalidArgument(text)
        if isinstance(error, TimeoutError):
            return Unavailable(f"the replica at {self._target} was silent for {ANSWER_SECONDS_MAX:g} s")
        if isinstance(error, asyncio.InvalidStateError):  # grpc raises this for a write after the end of the call
            return Unavailable(f"the stream to {self._target} is broken")
        return error


async def feed_until_gone(
    make: Callable[[], QueueFeedStream | None], dial: Callable[[], grpc.aio.Channel], name: str
) -> None:
    """Feed a replica again after each break, until `make` returns None."""
    pause_s = 0.05
    while (feed := make()) is not None:  # paced by the sleep
        channel = dial()
        try:
            await feed.run(channel)
        except StampedeError as error:
            extra = {"event": "copy_feed_broken", "channel": name, "why": str(error)}
            logger.info("the feed of a copy is broken; the host tries again", extra=extra)
        finally:
            await channel.close(None)
        pause_s = min(2 * pause_s, 0.3)
        await asyncio.sleep(pause_s)
