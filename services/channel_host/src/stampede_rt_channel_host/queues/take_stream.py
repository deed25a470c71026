"""Serves one stream of a taker: credit and settlements come in, leased messages and results go out."""

from __future__ import annotations

import asyncio
from functools import partial

from grpc.aio import EOF

from stampede_rt.errors import InvalidArgument, Overloaded, StampedeError
from stampede_rt.v1 import queue_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt_channel_host.channels.requests import parse
from stampede_rt_channel_host.channels.streams import OpenStream
from stampede_rt_channel_host.core.queue import Batch, TakerState
from stampede_rt_channel_host.queues.access import check_queue_access
from stampede_rt_channel_host.queues.frames import take_response
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.queue_store import QueueStore
from stampede_rt_channel_host.queues.refusals import display_name
from stampede_rt_channel_host.queues.requests import (
    CREDIT_MAX,
    SETTLEMENTS_MAX,
    result_message,
    settlements_of,
    taker_of,
)
from stampede_rt_runtime.access.control import current_work
from stampede_rt_runtime.access.rules import AccessVerb
from stampede_rt_runtime.rpc import Context

SIGN_OF_LIFE_SECONDS = 4.0  # the silence before a sign of life; the contract promises a message every 5 s
WRITE_SECONDS_MAX = 30.0  # if the taker reads nothing for this time during a write, the stream ends


class TakeStream:
    """Serves one stream, as a `TakerStream` of its queue. Call all methods on the event loop.

    After the caller has closed its side, the stream stays open until the taker's credit is used up. So a caller can
    take a fixed number of messages: it grants that credit, closes its side, and reads to the end.
    """

    def __init__(self, store: QueueStore, context: Context, stream: OpenStream) -> None:
        self._store = store
        self._context = context
        self._stream = stream
        self._batch: Batch | None = None
        self._results: list[queue_pb2.SettlementResult] = []
        self._owed = 0  # the results that were not sent yet; some of them may wait for replicas
        self._owes_drained = False  # the answer to the request's `drain` is due
        self._drains = False  # the taker wants no more messages
        self._closed = False  # the caller has closed its side
        self._probes = False  # `probe` was called, and its sign of life is due
        self._wakeup = asyncio.Event()  # there is something to write, or the caller has closed its side
        self._silent_at_s = 0.0  # loop time at which a sign of life is due; only a write postpones it
        self._room = asyncio.Event()  # the writer has taken the results
        self._work = current_work()

    def deliver(self, batch: Batch) -> None:
        """Send a batch. The queue gives this stream the next batch only after `HostedQueue.sent`."""
        self._batch = batch
        self._wakeup.set()

    def probe(self) -> None:
        """See `TakerStream`."""
        self._probes = True
        self._wakeup.set()

    def end(self, error: StampedeError) -> None:
        """Note that the host no longer serves the queue."""
        self._stream.end(error)

    async def run(self) -> None:
        """Serve until the stream ends, or until the caller has closed its side and its credit is used up.

        Raises StaleBinding, QueueNotFound, InvalidArgument, PermissionDenied. Raises Overloaded if the queue has too
        many takers, or if the taker reads nothing for WRITE_SECONDS_MAX.
        """
        raw = await self._context.read()
        if raw is EOF:
            raise InvalidArgument("the stream ended without a request; begin with `open`")
        request: pb.TakeRequest = parse(pb.TakeRequest, raw, "TakeRequest")
        taker = taker_of(request.open)
        hosted = await self._store.use(request.open.queue_id, request.open.epoch)
        check = partial(check_queue_access, AccessVerb.TAKE, hosted.record)
        with self._store.takers.using(request.open.queue_id, taker.taker_id, "taker", check):
            hosted.attach(taker, self)
        try:
            await self._serve(hosted, taker, request)
        finally:
            hosted.leave(taker)

    async def _serve(self, hosted: HostedQueue, taker: TakerState, request: pb.TakeRequest) -> None:
        writer = self._stream.spawn(self._write_all(hosted, taker))
        try:
            await self._take(hosted, taker, request)
            while (raw := await self._context.read()) is not EOF:
                request = parse(pb.TakeRequest, raw, "TakeRequest")
                if request.HasField("open"):
                    raise InvalidArgument("the stream is open already; leave `open` out after the first request")
                await self._take(hosted, taker, request)
            self._closed = True
            self._wakeup.set()
            await writer
        finally:
            writer.cancel()
            del writer  # the error of a failed writer refers to this frame

    async def _take(self, hosted: HostedQueue, taker: TakerState, request: pb.TakeRequest) -> None:
        if self._work.must_wait:
            await self._work.turn()
        self._work.spend_read()
        settlements = settlements_of(request.settlements)
        if settlements:
            results = [*map(result_message, hosted.settle(taker.taker_id, settlements))]
            self._owed += len(results)
            hosted.once_replicated(self, partial(self._answer, results))
        if request.drain:
            self._drains = True
            hosted.queue.drain(taker)
            hosted.once_replicated(self, self._answer_drain)
        self._grant(hosted, taker, request.credit)
        self._wakeup.set()
        while self._owed >= SETTLEMENTS_MAX:  # a taker that does not read its results must wait
            self._room.clear()
            await self._room.wait()

    def _answer(self, results: list[queue_pb2.SettlementResult]) -> None:
        """Send results, because the replicas have these settlements."""
        self._results += results
        self._wakeup.set()

    def _answer_drain(self) -> None:
        """Tell the taker that no batch follows: all earlier ones are sent."""
        self._owes_drained = True
        self._wakeup.set()

    def _grant(self, hosted: HostedQueue, taker: TakerState, credit: int) -> None:
        """Add the credit that the taker grants. A request without credit is a sign of life.

        Ignores the credit of a taker that drains. Raises InvalidArgument if the taker has more than CREDIT_MAX then.
        """
        credit = 0 if self._drains else credit
        if taker.credit + credit > CREDIT_MAX:
            raise InvalidArgument(
                f"the taker has a credit of {taker.credit} messages and grants {credit} more; the limit is {CREDIT_MAX}"
            )
        hosted.grant(taker, credit)

    async def _write_all(self, hosted: HostedQueue, taker: TakerState) -> None:
        """Send batches, results and signs of life. Results that came during one write go out in the next message."""
        await self._write(hosted, take_response(None, (), 0, incarnation=hosted.queue.incarnation))
        while not self._is_over(taker):
            if await self._wait_for_change():
                if self._work.must_wait:
                    await self._work.turn()
                await self._write_news(hosted, taker)
            elif not self._closed:
                await self._write(hosted, b"")

    def _is_over(self, taker: TakerState) -> bool:
        waiting = taker.is_busy or self._owed or self._owes_drained
        return self._closed and not taker.credit and not waiting

    async def _write_news(self, hosted: HostedQueue, taker: TakerState) -> None:
        batch, self._batch = self._batch, None
        results, self._results = self._results, []
        self._owed -= len(results)
        drained, self._owes_drained = self._owes_drained, False
        probes, self._probes = self._probes, False
        self._room.set()
        if batch is not None:
            hosted.queue.sending(taker)
        if results and batch is not None and len(results) > SETTLEMENTS_MAX // 8:
            await self._write(hosted, take_response(None, results, 0))  # batch and results together might exceed 1 MiB
            results = []
        if batch is not None or results or drained:
            await self._write(hosted, take_response(batch, results, self._store.now(), drained=drained))
        elif probes and not self._closed:
            await self._write(hosted, b"")
        if batch is not None:
            hosted.note_sent(taker)

    async def _wait_for_change(self) -> bool:
        """Wait until there may be something to send. Returns False if a sign of life is due first."""
        try:
            async with asyncio.timeout_at(self._silent_at_s):
                await self._wakeup.wait()
        except TimeoutError:
            return False
        self._wakeup.clear()
        return True

    async def _write(self, hosted: HostedQueue, message: bytes) -> None:
        self._work.spend_write()
        try:
            async with asyncio.timeout(WRITE_SECONDS_MAX):
                await self._context.write(message)
            self._silent_at_s = asyncio.get_running_loop().time() + SIGN_OF_LIFE_SECONDS
        except TimeoutError:
            raise Overloaded(
                f"the taker of queue {display_name(hosted.record)} read nothing for {WRITE_SECONDS_MAX:g} s, and its "
                "stream is ended; give less credit, or read faster, and open it again: sent messages can still be "
                "settled"
            ) from None
