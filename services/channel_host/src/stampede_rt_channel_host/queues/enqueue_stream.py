"""Serves one stream of enqueues: judges and acks runs in order."""

from __future__ import annotations

import asyncio
from collections import deque
from collections.abc import Iterator
from contextlib import contextmanager
from functools import partial
from typing import Any

from grpc.aio import EOF

from stampede_rt.errors import InvalidArgument, PermissionDenied, StampedeError
from stampede_rt.v1 import channel_service_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt_channel_host.channels.puts.ack_writer import RUNS_PER_TURN, AckWriter
from stampede_rt_channel_host.channels.puts.acks import refused
from stampede_rt_channel_host.channels.puts.held_acks import HeldAck
from stampede_rt_channel_host.channels.puts.read_ahead import ReadAhead
from stampede_rt_channel_host.channels.puts.whole_requests import WholeRequests
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.core.queue import Enqueue
from stampede_rt_channel_host.queues.access import check_queue_access
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.incoming import (
    EnqueueRun,
    answer,
    check_forwards,
    check_number,
    enqueue_of,
    read_request,
)
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_channel_host.queues.replica_acks import ack_of_replicas
from stampede_rt_channel_host.queues.requests import check_queue_id
from stampede_rt_runtime.access.control import check_not_judged, current_account, current_work, own_name, request_rights
from stampede_rt_runtime.access.rules import AccessVerb
from stampede_rt_runtime.admission import caller_identity
from stampede_rt_runtime.rpc import Context

REQUEST_BYTES_MAX = 4 * 2**20  # the runs of a request with several runs
_FRAMING_BYTES_MAX = 4096  # the fields of such a request, without the runs
_ENDING = ("OVERLOADED", "SHUTTING_DOWN")  # if the queue cannot be used for these reasons, the stream ends


class EnqueueStream:
    """Serves one stream. A run that waits for room blocks the later runs.

    The waiting time of each run counts from the arrival of its request. If this time has passed when the run's turn
    comes, the host refuses the run, unless the queue has room or can make room.
    """

    def __init__(self, store: QueueStore, context: Context, stream: OpenStream) -> None:
        self._store = store
        self._context = context
        self._stream = stream
        self._queue_id, self._epoch, self._producer_id = b"", 0, 0
        self._acks: AckWriter  # made when the stream is served
        self._account = current_account()
        self._caller_name = own_name()
        self._rights = request_rights(_lose)
        self._work = current_work()
        whole = WholeRequests(context.read, store.memory.requests, self._account)
        self._requests = ReadAhead(whole, store.memory, self._account)

    async def run(self) -> None:
        """Serve until the caller has closed its side and every run is acked.

        Raises InvalidArgument, Overloaded, or Unavailable (SHUTTING_DOWN). Sends the acks of judged runs first.
        """
        self._acks = AckWriter(self._context, _encoded, self._stream.spawn)
        try:
            while (received := self._read_request(*await self._requests.next())) is not None:
                await self._take(*received)
            await self._acks.finish()
        except StampedeError:
            await self._acks.finish()
            raise
        finally:
            self._acks.close()
            self._requests.close()

    def _read_request(self, raw: Any, received_s: float) -> tuple[deque[EnqueueRun], float] | None:
        """The runs of a request, and the time at which it came; None at the end of the stream.

        Keeps no reference to the request.
        """
        if raw is EOF:
            return None
        request = read_request(raw)
        if request.queue_id:
            check_queue_id(request.queue_id)
            self._queue_id, self._epoch = request.queue_id, request.epoch
            self._producer_id = request.producer_id
        if not self._queue_id:
            raise InvalidArgument("the stream names no queue; set queue_id and epoch in its first request")
        if len(request.runs) > 1 and len(raw) > REQUEST_BYTES_MAX + _FRAMING_BYTES_MAX:
            raise InvalidArgument(
                f"the request is larger than {REQUEST_BYTES_MAX} bytes and holds several runs; send fewer "
                "in one request"
            )
        return request.runs, received_s

    async def _take(self, runs: deque[EnqueueRun], received_s: float) -> None:
        if self._work.must_wait:
            await self._work.turn()
        failure = await self._failure_to_find()
        self._requests.release()  # these runs do not count any more; a run that has to wait counts again
        self._work.spend_read()
        while runs:
            await self._acks.add(await self._enqueue(runs, received_s, failure))
            if runs and len(runs) % RUNS_PER_TURN == 0:
                await asyncio.sleep(0)
        self._acks.wake()
        await asyncio.sleep(0)  # let the writer send this ack before the next read begins

    async def _failure_to_find(self) -> StampedeError | None:
        """The error that says why the queue cannot be used; None if it can be used.

        May ask the directory. So the stream calls this once for each request, not for each run.
        """
        try:
            await self._store.use(self._queue_id, self._epoch)
        except StampedeError as error:
            return error
        return None

    async def _enqueue(
        self, runs: deque[EnqueueRun], received_s: float, failure: StampedeError | None
    ) -> channel_service_pb2.PutAck | HeldAck:
        """The ack of the first run. Waits while the run waits for room."""
        message = runs.popleft()
        check_number(self._producer_id, message.first_number)
        hosted: HostedQueue | None = None
        try:
            if failure is not None:
                raise failure
            hosted = self._store.find(self._queue_id, self._epoch)
            check_queue_access(AccessVerb.SEND, hosted.record, self._rights.check)
            if message.origin:
                check_forwards(caller_identity(self._context))
                check_not_judged("set the origin of a run, as of a dead letter")
            run = enqueue_of(message, self._producer_id, received_s, self._caller_name)
        except StampedeError as error:
            if hosted is not None:
                hosted.refuse_unread(error)
            elif error.reason in _ENDING:
                raise
            return refused(message.first_number, 0, error, self._store.now())
        await hosted.enqueue(run, lambda: self._waiting(hosted, run, runs))
        ack = answer(run, self._store.now(), hosted.queue.incarnation)
        return ack_of_replicas(ack, hosted, run.wait_nanos)

    @contextmanager
    def _waiting(self, hosted: HostedQueue, run: Enqueue, behind: deque[EnqueueRun]) -> Iterator[None]:
        """A context in which a run waits for room. Sends the earlier acks, and reads further requests ahead.

        `behind`: the later runs of the same request. Raises Overloaded if the caller has too many waiting calls or
        bytes.
        """
        self._acks.wake()
        kept_bytes, waiting = sum(len(one.run) for one in behind), (hosted, run)
        check_queue_access(AccessVerb.SEND, hosted.record, partial(self._rights.hold, waiting))
        try:
            with self._account.waiting(run.charged_bytes), self._requests.keeping(kept_bytes):
                yield
        finally:
            self._rights.release(waiting)


def _encoded(acks: list[channel_service_pb2.PutAck]) -> bytes:
    return pb.EnqueueResponse(acks=acks).SerializeToString()


def _lose(waiting: tuple[HostedQueue, Enqueue], error: PermissionDenied) -> None:
    """Refuse a run that waits, because the caller has lost a right."""
    hosted, run = waiting
    hosted.refuse(run, error)
