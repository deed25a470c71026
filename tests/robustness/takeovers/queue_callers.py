"""Producers and takers of a queue in virtual time. They know the owner, as a client does after a look-up."""

from __future__ import annotations

import asyncio
import random
from contextlib import suppress
from typing import Any

import grpc
from grpc.aio import EOF

from stampede_rt.errors import LeaseExpired, StampedeError, Unavailable
from stampede_rt.status import from_error_message
from stampede_rt.transports.grpc_options import ENQUEUE_METHOD
from stampede_rt.v1 import item_pb2, queue_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from tests.robustness.takeovers.queue_ledger import ROUNDING_SECONDS, Delivery, Incarnation, Ledger, Message
from tests.robustness.takeovers.queue_world import TAKE, QueueCluster
from tests.robustness.takeovers.streams import Call, Connection

PUT_SECONDS, SILENT_SECONDS, SETTLE_SECONDS = 2.0, 6.0, 4.0
CREDIT = 4
BREAKS = (StampedeError, grpc.RpcError, TimeoutError, asyncio.InvalidStateError)


def call_to_owner(cluster: QueueCluster, queue_id: bytes, path: str, response: type[Any]) -> Call:
    """A call of a client to the owner. Raises Unavailable."""
    host = cluster.owner_of(queue_id)
    connection = Connection(cluster, host, host.methods)
    return connection.stream_stream(path, response_deserializer=response.FromString)()


async def put(cluster: QueueCluster, queue_id: bytes, message: Message, ledger: Ledger) -> bool:
    """Put a message once. Returns whether the put was acknowledged. Raises the errors of a broken call."""
    producer, number = message
    payload = b"%d %d" % message
    run = item_pb2.ItemRun(payload_length_bytes=[len(payload)], payloads=payload)
    wait_nanos = round(PUT_SECONDS * 1e9)
    request = pb.EnqueueRequest(
        queue_id=queue_id, epoch=cluster.queue(queue_id).epoch, producer_id=producer,
        runs=[pb.EnqueueRun(first_number=number, wait_nanos=wait_nanos, run=run)],
    )  # fmt: skip
    call = call_to_owner(cluster, queue_id, ENQUEUE_METHOD, pb.EnqueueResponse)
    try:
        async with asyncio.timeout(PUT_SECONDS + 1):
            await call.write(request.SerializeToString())
            response = await call.read()
    finally:
        call.cancel()
    if response is EOF or not response.acks or response.acks[0].HasField("error"):
        return False
    (ack,) = response.acks
    if not ack.HasField("first_seq"):
        return False
    ledger.of(ack.incarnation).accepted(message, ack.first_seq)
    return True


class Taker:
    """Takes messages, works on each for a while, and settles it at the present owner until a host answers."""

    def __init__(
        self, cluster: QueueCluster, queue_id: bytes, taker_id: int, rng: random.Random, ledger: Ledger
    ) -> None:
        self.cluster, self.queue_id, self.taker_id = cluster, queue_id, taker_id
        self.rng, self.ledger = rng, ledger
        self.finishes_all = False  # if True, the taker acks every message, and soon
        self.work: set[asyncio.Task[None]] = set()
        self._call: Call | None = None
        self._waiting: dict[int, asyncio.Future[queue_pb2.SettlementResult]] = {}  # by delivery id

    async def run(self) -> None:
        """Take messages, for ever."""
        while True:
            with suppress(*BREAKS):
                await self._take()
            await asyncio.sleep(self.rng.uniform(0.05, 0.3))

    async def _take(self) -> None:
        call = self._call = await self._opened()
        try:
            response = await self._next(call)
            incarnation = response.incarnation
            while True:  # until the stream ends
                response = await self._next(call)
                if not response.ByteSize():
                    await call.write(pb.TakeRequest().SerializeToString())
                for result in response.results:
                    if (future := self._waiting.pop(result.delivery_id, None)) is not None and not future.done():
                        future.set_result(result)
                for run in response.runs:
                    self._got(run, self.ledger.of(incarnation), call.sent_s)
        finally:
            call.cancel()
            self._call = None

    async def _opened(self) -> Call:
        call = call_to_owner(self.cluster, self.queue_id, TAKE, pb.TakeResponse)
        opened = pb.TakeOpen(
            queue_id=self.queue_id, epoch=self.cluster.queue(self.queue_id).epoch, taker_id=self.taker_id
        )
        await call.write(pb.TakeRequest(open=opened, credit=CREDIT).SerializeToString())
        return call

    async def _next(self, call: Call) -> pb.TakeResponse:
        async with asyncio.timeout(SILENT_SECONDS):
            response = await call.read()
        if not isinstance(response, pb.TakeResponse):
            raise Unavailable("the stream has ended")
        return response

    def _got(self, run: queue_pb2.LeasedRun, known: Incarnation, sent_s: float) -> None:
        at = 0
        for index, length in enumerate(run.run.payload_length_bytes):
            producer, number = map(int, run.run.payloads[at : at + length].split())
            at += length
            count = run.deliveries[index] if run.deliveries else 1
            delivery = Delivery(run.delivery_ids[index], count, self.taker_id, sent_s + run.lease_nanos / 1e9)
            if known.delivered((producer, number), run.run.first_seq + index, delivery, sent_s):
                task = asyncio.create_task(self._handle((producer, number), delivery, known))
                self.work.add(task)
                task.add_done_callback(self._over)

    def _over(self, task: asyncio.Task[None]) -> None:
        self.work.discard(task)
        if not task.cancelled() and (failure := task.exception()) is not None:
            self.cluster.defects.append(failure)

    async def _handle(self, message: Message, delivery: Delivery, known: Incarnation) -> None:
        """Work on a message, and settle it."""
        choice = 0.0 if self.finishes_all else self.rng.random()
        await asyncio.sleep(self.rng.choice((0.0, 0.05, 0.5, 2.0)) if choice < 0.9 else 30.0)
        with suppress(*BREAKS):
            if self._call is not None:
                await self._call.write(pb.TakeRequest(credit=1).SerializeToString())
        if choice < 0.75:
            await self._ack(message, delivery, known)
        elif choice < 0.8:
            if await self._settled(delivery, known, terminate=queue_pb2.Terminate(reason="no")) is None:
                known.left_s[message] = self.cluster.clock.now_s
        elif choice < 0.85:
            known.given_back.add(delivery.delivery_id)
            delay_nanos = self.rng.choice((0, 10**9))
            await self._settled(delivery, known, give_back=queue_pb2.GiveBack(delay_nanos=delay_nanos))
        # otherwise the lease ends

    async def _ack(self, message: Message, delivery: Delivery, known: Incarnation) -> None:
        known.perhaps_acked[delivery.delivery_id] = message
        error = await self._settled(delivery, known, acknowledge=queue_pb2.Acknowledge())
        del known.perhaps_acked[delivery.delivery_id]  # after an error no try of the ack has had an effect
        if error is None:
            known.acked.add(message)
            known.left_s[message] = self.cluster.clock.now_s

    async def _settled(self, delivery: Delivery, known: Incarnation, **verdict: Any) -> StampedeError | None:
        """Settle until a host answers. Returns its error.

        Raises AssertionError if a host has forgotten a lease that has not ended, or an earlier try of this ack.
        """
        settlement = queue_pb2.Settlement(delivery_id=delivery.delivery_id, **verdict)
        tries = 0
        while True:  # until the queue has an owner that answers
            tries += 1
            result = None
            with suppress(*BREAKS):
                async with asyncio.timeout(SETTLE_SECONDS):
                    result = await self._tried(settlement)
            if result is None:
                await asyncio.sleep(self.rng.uniform(0.1, 0.5))
                continue
            if not result.HasField("error"):
                return None
            error = from_error_message(result.error)
            assert isinstance(error, LeaseExpired), error
            is_kept = known is self.ledger.incarnations.get(self.cluster.queue(self.queue_id).incarnation)
            is_over = self.cluster.clock.now_s >= delivery.ends_s - ROUNDING_SECONDS
            may_end = is_over or (tries > 1 and "acknowledge" not in verdict)
            assert may_end or not is_kept, f"the lease of {delivery} has ended early: {error}"
            return error

    async def _tried(self, settlement: queue_pb2.Settlement) -> queue_pb2.SettlementResult:
        """Settle on the open stream."""
        if self._call is None:
            raise Unavailable("there is no stream")
        future = self._waiting[settlement.delivery_id] = asyncio.get_running_loop().create_future()
        await self._call.write(pb.TakeRequest(settlements=[settlement]).SerializeToString())
        return await future
