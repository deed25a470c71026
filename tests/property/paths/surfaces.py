"""The paths to a channel under test, behind one blocking interface. A further transport is one more `Surface`.

`do` performs a call and returns its result. `start` begins a call that may block.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import ExitStack, contextmanager
from typing import Any, Protocol

import grpc

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.security.tls import TlsReader
from stampede_rt.status import from_error_message, from_rpc_error
from stampede_rt.transports import futexes
from stampede_rt.transports.grpc_credentials import channel_credentials
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub
from stampede_rt.wire.runs import encode_run
from tests.oracle import Ack
from tests.property.paths.values import FollowedItems, Run, StartedCall
from tests.support.channel_host.loopback_host import LoopbackHost

WAIT_SECONDS_MAX = 20.0
THREADS_MAX = 24
TRANSPORTS = ("grpc", "socket", "tcp", *(("shared",) if futexes.is_supported() else ()))


class Surface(Protocol):
    """One path to a host."""

    connections: Sequence[Any]  # one for each client

    def do(self, call: Callable[[], Any]) -> Any:
        """Perform a call of the surface, and return its result. Awaits it if the surface is asynchronous."""

    def start(self, call: Callable[[], Any]) -> StartedCall:
        """Begin a call."""

    def put_run(self, handle: Any, run: Run) -> Any:
        """Put a run as any producer would. Returns its Ack; AwaitedSurface returns a coroutine for it."""

    def break_stream(self, run: Run) -> None:
        """Break the stream of a waiting run."""

    def consume(self, handle: Any, consumer_id: int, seqs: Sequence[int], lease_nanos: int) -> Any:
        """Consume as any consumer would. Returns the number of items, and the lease.

        AwaitedSurface returns a coroutine for them.
        """

    def follow(self, subscribe: Callable[[], Any]) -> FollowedItems:
        """Begin a subscription. It has begun when this method returns."""


class BlockingSurface:
    """`stampede_rt`, with a thread for each blocking call."""

    def __init__(self, connections: Sequence[Any], host: LoopbackHost, pool: ThreadPoolExecutor) -> None:
        self.connections = connections
        self._pool = pool
        self._wire = _wire(grpc, host)
        self._channels = ChannelServiceStub(self._wire)
        self._puts: dict[int, Any] = {}  # the runs under way, by the identity of the run

    def do(self, call: Callable[[], Any]) -> Any:
        return call()

    def start(self, call: Callable[[], Any]) -> StartedCall:
        return _InThread(self._pool.submit(call))

    def put_run(self, handle: Any, run: Run) -> Ack:
        call = self._puts[id(run)] = self._channels.Put(iter((put_request(handle, run),)))
        try:
            (ack,) = [ack for response in call for ack in response.acks]
        finally:
            _forget(self._puts, run, call)
        return ack_of(ack)

    def break_stream(self, run: Run) -> None:
        self._puts[id(run)].cancel()

    def consume(self, handle: Any, consumer_id: int, seqs: Sequence[int], lease_nanos: int) -> tuple[int, int]:
        try:
            response = self._channels.Consume(consume_request(handle, consumer_id, seqs, lease_nanos))
        except grpc.RpcError as error:
            raise from_rpc_error(error, "the host") from error
        return response.consumed, response.lease_nanos

    def follow(self, subscribe: Callable[[], Any]) -> FollowedItems:
        followed = FollowedItems()
        followed.subscription = subscribe()
        followed.work = self._pool.submit(self._collect, followed)
        return followed

    def _collect(self, followed: FollowedItems) -> None:
        try:
            for item in followed.subscription:
                followed.items.append(item)
        except st.StampedeError as error:
            followed.error = error
        finally:
            followed.ended = True

    def close(self) -> None:
        self._wire.close()


class _InThread:
    def __init__(self, future: Future[Any]) -> None:
        self._future = future

    def is_done(self) -> bool:
        return self._future.done()

    def outcome(self) -> Any:
        try:
            return self._future.result(WAIT_SECONDS_MAX)
        except st.StampedeError as error:
            return error


class AwaitedSurface:
    """`stampede_rt.aio`, on an event loop that runs only during a call of this surface."""

    def __init__(self, connections: Sequence[Any], host: LoopbackHost, loop: asyncio.AbstractEventLoop) -> None:
        self.connections = connections
        self._loop = loop
        self._wire = self.do(lambda: _aio_channel(host))
        self._channels = ChannelServiceStub(self._wire)
        self._puts: dict[int, Any] = {}  # the runs under way, by the identity of the run

    def do(self, call: Callable[[], Any]) -> Any:
        async def performed() -> Any:
            return await call()

        return self._loop.run_until_complete(performed())

    def start(self, call: Callable[[], Any]) -> StartedCall:
        return _AsTask(self._loop.create_task(call()), self._loop)

    async def put_run(self, handle: Any, run: Run) -> Ack:
        call = self._puts[id(run)] = self._channels.Put(iter((put_request(handle, run),)))
        try:
            (ack,) = [ack async for response in call for ack in response.acks]
        finally:
            _forget(self._puts, run, call)
        return ack_of(ack)

    def break_stream(self, run: Run) -> None:
        self._puts[id(run)].cancel()

    async def consume(self, handle: Any, consumer_id: int, seqs: Sequence[int], lease_nanos: int) -> tuple[int, int]:
        try:
            response = await self._channels.Consume(consume_request(handle, consumer_id, seqs, lease_nanos))
        except grpc.RpcError as error:
            raise from_rpc_error(error, "the host") from error
        return response.consumed, response.lease_nanos

    def follow(self, subscribe: Callable[[], Any]) -> FollowedItems:
        followed = FollowedItems()
        followed.subscription = subscribe()
        self.do(followed.subscription.__aenter__)
        followed.work = self._loop.create_task(self._collect(followed))
        return followed

    async def _collect(self, followed: FollowedItems) -> None:
        try:
            async for item in followed.subscription:
                followed.items.append(item)
        except st.StampedeError as error:
            followed.error = error
        finally:
            followed.ended = True

    def close(self) -> None:
        self.do(lambda: self._wire.close(None))


def _wire(library: Any, host: LoopbackHost) -> Any:
    """Return a channel of `library` (`grpc` or `grpc.aio`) to the host."""
    if host.tls is None:
        return library.insecure_channel(host.target)
    return library.secure_channel(host.target, channel_credentials(TlsReader(host.tls).current()))


async def _aio_channel(host: LoopbackHost) -> Any:
    return _wire(grpc.aio, host)


class _AsTask:
    def __init__(self, task: asyncio.Task[Any], loop: asyncio.AbstractEventLoop) -> None:
        self._task = task
        self._loop = loop

    def is_done(self) -> bool:
        return self._task.done()

    def outcome(self) -> Any:
        try:
            return self._loop.run_until_complete(asyncio.wait_for(asyncio.shield(self._task), WAIT_SECONDS_MAX))
        except st.StampedeError as error:
            return error


def _forget(puts: dict[int, Any], run: Run, call: Any) -> None:
    """Forget a call that is over, unless the run has been sent again meanwhile."""
    if puts.get(id(run)) is call:
        del puts[id(run)]


def put_request(handle: Any, run: Run) -> pb.PutRequest:
    """The request that puts one run."""
    encoded = encode_run(run.payloads, times=run.offer.times, durations=run.offer.durations)
    info = handle.info
    request = pb.PutRequest(channel_id=info.channel_id, epoch=info.epoch, producer_id=run.producer_id)
    put = request.puts.add(first_number=run.first_number, wait_nanos=None if run.waits else 0)
    put.run.ParseFromString(encoded)
    return request


def ack_of(ack: pb.PutAck) -> Ack:
    """The ack as a value. Raises the error that refused the whole run."""
    if ack.HasField("error"):
        raise from_error_message(ack.error)
    refused = {one.index: from_error_message(one.error).reason for one in ack.rejections}
    stamp = ack.stamped_unix_nano if ack.HasField("stamped_unix_nano") else None
    parts = [(0, ack.first_seq, stamp)] if ack.HasField("first_seq") else []
    for one in ack.later_parts:
        parts.append((one.index, one.first_seq, one.stamped_unix_nano if one.HasField("stamped_unix_nano") else None))
    accepted: dict[int, tuple[int, int | None]] = {}
    for (index, first_seq, stamp), end in zip(parts, [*(one[0] for one in parts[1:]), ack.items], strict=False):
        positions = (position for position in range(index, end) if position not in refused)
        accepted |= {position: (seq, stamp) for seq, position in enumerate(positions, first_seq)}
    return Ack(accepted, refused, ack.host_time_unix_nano)


def consume_request(handle: Any, consumer_id: int, seqs: Sequence[int], lease_nanos: int) -> pb.ConsumeRequest:
    """The request of one consumer."""
    info = handle.info
    return pb.ConsumeRequest(
        channel_id=info.channel_id,
        epoch=info.epoch,
        consumer_id=consumer_id,
        seqs=seqs,
        incarnation=handle.incarnation,
        lease_nanos=lease_nanos,
    )


@contextmanager
def blocking_surface(host: LoopbackHost) -> Iterator[BlockingSurface]:
    """The synchronous client, connected over each transport."""
    with ExitStack() as stack:
        connections = [
            stack.enter_context(st.connect(host.frontend, transport=one, tls=host.tls)) for one in TRANSPORTS
        ]
        pool = stack.enter_context(ThreadPoolExecutor(THREADS_MAX))
        surface = BlockingSurface(connections, host, pool)
        try:
            yield surface
        finally:
            surface.close()


@contextmanager
def awaited_surface(host: LoopbackHost) -> Iterator[AwaitedSurface]:
    """The asynchronous client, connected over each transport, on an event loop of its own."""
    with asyncio.Runner() as runner:
        connections = [runner.run(_connected(host, transport)) for transport in TRANSPORTS]
        surface = AwaitedSurface(connections, host, runner.get_loop())
        try:
            yield surface
        finally:
            surface.close()
            for connection in connections:
                runner.run(connection.aclose())


async def _connected(host: LoopbackHost, transport: str) -> Any:
    return await aio.connect(host.frontend, transport=transport, tls=host.tls)
