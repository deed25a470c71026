"""A channel host behind real gRPC on a free port, with a directory in memory, driven by the generated stubs."""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable, Iterable
from contextlib import asynccontextmanager
from typing import Any

from stampede_rt.transports.grpc_options import PUT_METHOD
from stampede_rt.v1 import channel_pb2, item_pb2, time_pb2
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from stampede_rt.v1.gatekeeper_service_pb2_grpc import GatekeeperServiceStub
from stampede_rt.wire.request_pieces import messages_of
from stampede_rt_runtime.clock import HostClock
from stampede_rt_runtime.server import serving
from tests.support.channel_host.fake_directory import FakeDirectory
from tests.support.channel_host.in_process_host import HOST_ID, InProcessHost, started_host, until_status

MIN_INSTANT, MAX_INSTANT = -(2**63), 2**63 - 1
MS, S = 10**6, 10**9
FOREVER = -1


class Rig:
    """The host under test, its directory, and the generated stubs."""

    def __init__(self, directory: FakeDirectory, started: InProcessHost) -> None:
        self.directory = directory
        self.host = started.host
        self.target = started.target
        self.connection = started.connect()
        self.channels = ChannelServiceStub(self.connection)
        self.gate = GatekeeperServiceStub(self.connection)
        self.accounts = started.server.access.accounts
        self.sockets = started.server.sockets

    def now(self) -> int:
        return self.host.store.now()

    async def open(
        self, name: str = "a", spec: channel_pb2.ChannelSpec | None = None, created_by: str = ""
    ) -> OpenedChannel:
        """Return a channel in the directory, bound at the host."""
        record = self.directory.add_channel(name, HOST_ID, spec)
        record.created_by = created_by
        await self.gate.BindChannel(gate_pb.BindChannelRequest(channel_id=record.channel_id, epoch=record.epoch))
        return OpenedChannel(self, record)


class OpenedChannel:
    """A bound channel."""

    def __init__(self, rig: Rig, record: channel_pb2.ChannelRecord) -> None:
        self.rig = rig
        self.channel_id = record.channel_id
        self.epoch = record.epoch
        self.incarnation = record.incarnation

    async def put(self, *runs: pb.PutRun, producer_id: int = 0, epoch: int | None = None) -> list[pb.PutAck]:
        """Put runs on a new stream, and return the acks."""
        request = pb.PutRequest(
            channel_id=self.channel_id, epoch=self.epoch if epoch is None else epoch, producer_id=producer_id, puts=runs
        )
        put = self.rig.connection.stream_stream(PUT_METHOD, response_deserializer=pb.PutResponse.FromString)
        call = put(messages_of(request.SerializeToString()))
        return [ack async for response in call for ack in response.acks]

    async def get(self, **fields: Any) -> CallAnswer:
        """Make one get on a new stream."""
        call = self.rig.channels.Get(iter((self.get_request(**fields),)))
        return CallAnswer([response async for response in call])

    def get_request(self, call_id: int = 1, **fields: Any) -> pb.GetRequest:
        fields = {"interval": between(MIN_INSTANT, MAX_INSTANT), "epoch": self.epoch, **fields}
        return pb.GetRequest(call_id=call_id, channel_id=self.channel_id, **fields)

    def newest_request(self, call_id: int = 1, **fields: Any) -> pb.GetRequest:
        return self.get_request(call_id, match=time_pb2.MATCH_START, newest_first=True, limit=1, **fields)

    def future(self) -> time_pb2.Interval:
        """Return an interval in the future, where no items are yet."""
        return between(self.rig.now() + 3600 * S, MAX_INSTANT)

    def subscribe(self, **fields: Any) -> Any:
        """Return a subscription with more credit than it needs."""
        return self.rig.channels.Subscribe(iter((self.subscribe_request(credit_bytes=MAX_INSTANT, **fields),)))

    async def subscribe_slowly(self, **fields: Any) -> Any:
        """Return a subscription without credit; `write` grants credit."""
        call = self.rig.channels.Subscribe()
        await call.write(self.subscribe_request(**fields))
        return call

    def subscribe_request(self, credit_bytes: int = 0, **fields: Any) -> pb.SubscribeRequest:
        fields = {"epoch": self.epoch, **fields}
        return pb.SubscribeRequest(
            open=pb.SubscribeOpen(channel_id=self.channel_id, **fields), credit_bytes=credit_bytes
        )

    async def status(self) -> channel_pb2.ChannelStatus:
        request = pb.GetChannelStatusRequest(channel_id=self.channel_id)
        return (await self.rig.channels.GetChannelStatus(request)).status

    async def until(self, condition: Callable[[channel_pb2.ChannelStatus], bool]) -> channel_pb2.ChannelStatus:
        return await until_status(self.status, condition)


class CallAnswer:
    """The answer to one call."""

    def __init__(self, responses: Iterable[pb.GetResponse]) -> None:
        self.responses = list(responses)
        self.runs = [delivered for response in self.responses for delivered in response.runs]
        self.summary = self.responses[-1].summary
        self.error = self.responses[-1].error

    @property
    def payloads(self) -> list[bytes]:
        return [payload for delivered in self.runs for payload in payloads_of(delivered.run)]

    @property
    def times(self) -> list[int]:
        return [time for delivered in self.runs for time in delivered.run.time_unix_nano]


def payloads_of(run: item_pb2.ItemRun) -> list[bytes]:
    payloads, at = [], 0
    for length in run.payload_length_bytes:
        payloads.append(run.payloads[at : at + length])
        at += length
    return payloads


def run_of(*payloads: bytes, times: Iterable[int] | None = None, number: int = 1, **fields: Any) -> pb.PutRun:
    """Return a run as a producer encodes it. Without times the host stamps it."""
    durations = fields.pop("durations", None)
    run = item_pb2.ItemRun(
        time_unix_nano=times,
        duration_nanos=durations,
        payload_length_bytes=[len(payload) for payload in payloads],
        payloads=b"".join(payloads),
        content_type=fields.pop("content_type", ""),
    )
    return pb.PutRun(first_number=number, run=run, **fields)


def instant(at: int, *, exclusive: bool = False) -> time_pb2.Bound:
    return time_pb2.Bound(instant_unix_nano=at, exclusive=exclusive)


def between(start: int, end: int, *, end_exclusive: bool = False) -> time_pb2.Interval:
    return time_pb2.Interval(start=instant(start), end=instant(end, exclusive=end_exclusive))


@asynccontextmanager
async def running_host(
    *,
    clock: HostClock | None = None,
    memory_bytes_max: int = 2**30,
    lease_ttl_nanos: int = 600 * S,
) -> AsyncIterator[Rig]:
    """Yield a host that has registered. It leaves at the end of the block, if it has not left before."""
    directory = FakeDirectory(lease_ttl_nanos=lease_ttl_nanos)
    async with serving(directory.register) as supernode:
        directory.target = supernode.address
        started = await started_host(directory.target, clock=clock, memory_bytes_max=memory_bytes_max)
        rig = Rig(directory, started)
        try:
            yield rig
        finally:
            await rig.connection.close(None)
            await started.stop()
