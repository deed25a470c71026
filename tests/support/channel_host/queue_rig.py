"""Hosts with queues behind real gRPC, a directory in memory, and the generated stubs."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from typing import Any

import grpc

from stampede_rt.transports.grpc_options import ENQUEUE_METHOD
from stampede_rt.v1 import channel_service_pb2, item_pb2, queue_pb2
from stampede_rt.v1 import queue_service_pb2 as pb
from stampede_rt.v1.queue_service_pb2_grpc import QueueServiceStub
from stampede_rt.wire.request_pieces import messages_of
from stampede_rt_runtime.server import serving
from tests.support.channel_host.fake_queue_directory import FakeQueueDirectory
from tests.support.channel_host.in_process_host import WAIT_SECONDS_MAX, InProcessHost, started_host, until_status
from tests.support.channel_host.rig import payloads_of

MS, S = 10**6, 10**9

OTHER_ID = b"the-other-host-i"


class QueueRig:
    """One host, its directory, and a connection to it."""

    def __init__(self, directory: FakeQueueDirectory, started: InProcessHost) -> None:
        self.directory = directory
        self.host = started.host
        self.target = started.target
        self.connection = started.connect()
        self.stub = QueueServiceStub(self.connection)
        self.accounts = started.server.access.accounts
        self.sockets = started.server.sockets

    def open(self, name: str = "q", **spec: Any) -> OpenedQueue:
        """Return a queue whose owner in the directory is this host."""
        return OpenedQueue(self, self.directory.add_queue(name, self.host.identity.host_id, **spec))


class OpenedQueue:
    """A queue with the calls of its users."""

    def __init__(self, rig: QueueRig, record: queue_pb2.QueueRecord) -> None:
        self.rig = rig
        self.record = record
        self.queue_id = record.queue_id

    async def put(self, *payloads: bytes, **fields: Any) -> channel_service_pb2.PutAck:
        """Put one run on a new stream, and return its ack."""
        (ack,) = await self.enqueue(run_of(*payloads, **fields))
        return ack

    async def enqueue(
        self, *runs: pb.EnqueueRun, producer_id: int = 0, epoch: int | None = None
    ) -> list[channel_service_pb2.PutAck]:
        enqueue = self.rig.connection.stream_stream(ENQUEUE_METHOD, response_deserializer=pb.EnqueueResponse.FromString)
        request = self.enqueue_request(*runs, producer_id=producer_id, epoch=epoch)
        call = enqueue(messages_of(request.SerializeToString()))
        return [ack async for response in call for ack in response.acks]

    def enqueue_request(
        self, *runs: pb.EnqueueRun, producer_id: int = 0, epoch: int | None = None
    ) -> pb.EnqueueRequest:
        believed = self.record.epoch if epoch is None else epoch
        return pb.EnqueueRequest(queue_id=self.queue_id, epoch=believed, producer_id=producer_id, runs=runs)

    def take(self, taker_id: int = 1, credit: int = 0, **fields: Any) -> TakeCall:
        return TakeCall(self, taker_id, credit, **fields)

    async def settle(
        self, *settlements: queue_pb2.Settlement, taker_id: int = 1, epoch: int | None = None
    ) -> list[queue_pb2.SettlementResult]:
        believed = self.record.epoch if epoch is None else epoch
        request = pb.SettleRequest(queue_id=self.queue_id, epoch=believed, taker_id=taker_id, settlements=settlements)
        return list((await self.rig.stub.Settle(request)).results)

    async def status(self) -> queue_pb2.QueueStatus:
        request = pb.GetQueueStatusRequest(queue_id=self.queue_id)
        return (await self.rig.stub.GetQueueStatus(request)).status

    async def until(self, condition: Callable[[queue_pb2.QueueStatus], bool]) -> queue_pb2.QueueStatus:
        return await until_status(self.status, condition)


class RigDelivery:
    """One delivered message."""

    def __init__(self, payload: bytes, seq: int, delivery_id: int, delivery: int, run: queue_pb2.LeasedRun) -> None:
        self.payload = payload
        self.seq = seq
        self.delivery_id = delivery_id
        self.delivery = delivery
        self.run = run


class TakeCall:
    """A Take stream."""

    def __init__(
        self, queue: OpenedQueue, taker_id: int, credit: int, *, epoch: int | None = None, **fields: Any
    ) -> None:
        believed = queue.record.epoch if epoch is None else epoch
        self.queue = queue
        self.call = queue.rig.stub.Take()
        self._first: pb.TakeRequest | None = pb.TakeRequest(
            open=pb.TakeOpen(queue_id=queue.queue_id, epoch=believed, taker_id=taker_id, **fields), credit=credit
        )
        self.incarnation = 0
        self._deliveries: list[RigDelivery] = []
        self.results: list[queue_pb2.SettlementResult] = []
        self.drained = False

    async def open(self) -> TakeCall:
        """Open the stream, and return when the host has answered."""
        await self.send()
        response = await self.read()
        self.incarnation = response.incarnation
        return self

    async def send(self, **fields: Any) -> None:
        if self._first is not None:
            first, self._first = self._first, None
            await self.call.write(first)
        if fields:
            await self.call.write(pb.TakeRequest(**fields))

    async def read(self) -> pb.TakeResponse:
        async with asyncio.timeout(WAIT_SECONDS_MAX):
            response = await self.call.read()
        assert response is not grpc.aio.EOF, "the stream goes on"
        self._deliveries += delivered_in(response)
        self.results += response.results
        self.drained = self.drained or response.drained
        return response

    async def deliveries(self, count: int) -> list[RigDelivery]:
        """Return the next `count` deliveries."""
        await self.send()
        while len(self._deliveries) < count:
            await self.read()
        found, self._deliveries = self._deliveries[:count], self._deliveries[count:]
        return found

    async def settled(self, *settlements: queue_pb2.Settlement) -> list[queue_pb2.SettlementResult]:
        """Send settlements on this stream, and return their results."""
        before = len(self.results)
        await self.send(settlements=settlements)
        while len(self.results) < before + len(settlements):
            await self.read()
        return self.results[before:]

    async def ended(self) -> grpc.StatusCode:
        """Return the status with which the stream ends. Reads and drops everything before."""
        async with asyncio.timeout(WAIT_SECONDS_MAX):
            with contextlib.suppress(grpc.aio.AioRpcError):
                while await self.call.read() is not grpc.aio.EOF:
                    pass
            code: grpc.StatusCode = await self.call.code()
        return code


def delivered_in(response: pb.TakeResponse) -> list[RigDelivery]:
    return [
        RigDelivery(payload, run.run.first_seq + at, delivery_id, run.deliveries[at] if run.deliveries else 1, run)
        for run in response.runs
        for at, (payload, delivery_id) in enumerate(zip(payloads_of(run.run), run.delivery_ids, strict=True))
    ]


def ack(one: RigDelivery | int) -> queue_pb2.Settlement:
    return _settlement(one, acknowledge=queue_pb2.Acknowledge())


def nack(one: RigDelivery | int, delay_nanos: int = 0) -> queue_pb2.Settlement:
    return _settlement(one, give_back=queue_pb2.GiveBack(delay_nanos=delay_nanos))


def extend(one: RigDelivery | int, lease_nanos: int) -> queue_pb2.Settlement:
    return _settlement(one, extend_lease=queue_pb2.ExtendLease(lease_nanos=lease_nanos))


def term(one: RigDelivery | int, reason: str = "") -> queue_pb2.Settlement:
    return _settlement(one, terminate=queue_pb2.Terminate(reason=reason))


def _settlement(one: RigDelivery | int, **verdict: Any) -> queue_pb2.Settlement:
    return queue_pb2.Settlement(delivery_id=one if isinstance(one, int) else one.delivery_id, **verdict)


def run_of(*payloads: bytes, number: int = 1, **fields: Any) -> pb.EnqueueRun:
    """Return a run as a producer encodes it. Without times the host stamps it."""
    run = item_pb2.ItemRun(
        payload_length_bytes=[len(payload) for payload in payloads],
        payloads=b"".join(payloads),
        content_type=fields.pop("content_type", ""),
        attributes=fields.pop("attributes", {}),
    )
    return pb.EnqueueRun(first_number=number, run=run, **fields)


@asynccontextmanager
async def queue_directory(lease_ttl_nanos: int = 600 * S) -> AsyncIterator[FakeQueueDirectory]:
    directory = FakeQueueDirectory(lease_ttl_nanos=lease_ttl_nanos)
    async with serving(directory.register) as supernode:
        directory.target = supernode.address
        yield directory


@asynccontextmanager
async def host_of(directory: FakeQueueDirectory, **settings: Any) -> AsyncIterator[QueueRig]:
    """Yield a host that has registered, see `started_host`. It leaves at the end of the block."""
    started = await started_host(directory.target, **settings)
    rig = QueueRig(directory, started)
    try:
        yield rig
    finally:
        await rig.connection.close(None)
        await started.stop()


@asynccontextmanager
async def two_queue_hosts() -> AsyncIterator[tuple[QueueRig, QueueRig, OpenedQueue]]:
    """Yield two hosts, and a queue with three messages at the first one. The second one has the id OTHER_ID."""
    async with (
        queue_directory() as directory,
        host_of(directory) as first,
        host_of(directory, host_id=OTHER_ID, name="h2", boot=8) as second,
    ):
        queue = first.open(lease_nanos=60 * S)
        await queue.put(b"a", b"b", b"c", number=1)
        yield first, second, queue


@asynccontextmanager
async def running_queue_host(**settings: Any) -> AsyncIterator[QueueRig]:
    """Yield a host and its directory."""
    async with queue_directory() as directory, host_of(directory, **settings) as rig:
        yield rig
