"""The ways to a channel under test, behind one face that blocks: a further transport is one more `Surface`.

`do` performs a call and gives what it gives; `start` performs one that may block, beside everything else.
"""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from contextlib import contextmanager
from typing import Any, Protocol

import grpc

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1.channel_service_pb2_grpc import ChannelServiceStub

WAIT_SECONDS_MAX = 20.0
THREADS_MAX = 24


class Started(Protocol):
    """A call under way."""

    def is_done(self) -> bool:
        """It has its outcome."""

    def outcome(self) -> Any:
        """Wait for the result or the StampedeError; fails after 20 s."""


class Followed:
    """A subscription and all that came of it, in a background of its own, until it ended with `error`."""

    def __init__(self) -> None:
        self.items: list[st.Item] = []
        self.subscription: Any = None
        self.error: st.StampedeError | None = None
        self.ended = False
        self.work: Any = None  # held, or an event loop would forget it


class Surface(Protocol):
    """One way to a host."""

    connection: Any

    def do(self, call: Callable[[], Any]) -> Any:
        """The result of a call of the surface, awaited if that is its way."""

    def start(self, call: Callable[[], Any]) -> Started:
        """Begin a call."""

    def put_run(self, request: pb.PutRequest) -> pb.PutAck:
        """The ack of the one run in the request, as any producer would send it."""

    def follow(self, subscribe: Callable[[], Any]) -> Followed:
        """Begin a subscription; when this returns it has begun."""


class BlockingSurface:
    """`stampede_rt`, each blocking call in a thread."""

    def __init__(self, connection: Any, target: str, pool: ThreadPoolExecutor) -> None:
        self.connection = connection
        self._pool = pool
        self._wire = grpc.insecure_channel(target)
        self._channels = ChannelServiceStub(self._wire)

    def do(self, call: Callable[[], Any]) -> Any:
        return call()

    def start(self, call: Callable[[], Any]) -> Started:
        return _InThread(self._pool.submit(call))

    def put_run(self, request: pb.PutRequest) -> pb.PutAck:
        (ack,) = [ack for response in self._channels.Put(iter((request,))) for ack in response.acks]
        return ack

    def follow(self, subscribe: Callable[[], Any]) -> Followed:
        followed = Followed()
        followed.subscription = subscribe()
        followed.work = self._pool.submit(self._collect, followed)
        return followed

    def _collect(self, followed: Followed) -> None:
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
    """`stampede_rt.aio`, on a loop that runs while something is done or waited for."""

    def __init__(self, connection: Any, target: str, loop: asyncio.AbstractEventLoop) -> None:
        self.connection = connection
        self._loop = loop
        self._wire = self.do(lambda: _aio_channel(target))
        self._channels = ChannelServiceStub(self._wire)

    def do(self, call: Callable[[], Any]) -> Any:
        async def performed() -> Any:
            return await call()

        return self._loop.run_until_complete(performed())

    def start(self, call: Callable[[], Any]) -> Started:
        return _AsTask(self._loop.create_task(call()), self._loop)

    def put_run(self, request: pb.PutRequest) -> pb.PutAck:
        async def put() -> pb.PutAck:
            (ack,) = [ack async for response in self._channels.Put(iter((request,))) for ack in response.acks]
            return ack

        return self.do(put)  # type: ignore[no-any-return]

    def follow(self, subscribe: Callable[[], Any]) -> Followed:
        followed = Followed()
        followed.subscription = subscribe()
        self.do(followed.subscription.__aenter__)
        followed.work = self._loop.create_task(self._collect(followed))
        return followed

    async def _collect(self, followed: Followed) -> None:
        try:
            async for item in followed.subscription:
                followed.items.append(item)
        except st.StampedeError as error:
            followed.error = error
        finally:
            followed.ended = True

    def close(self) -> None:
        self.do(lambda: self._wire.close(None))


async def _aio_channel(target: str) -> Any:
    return grpc.aio.insecure_channel(target)


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


@contextmanager
def blocking_surface(frontend: str, target: str) -> Iterator[BlockingSurface]:
    """The synchronous client, connected."""
    with st.connect(frontend) as connection, ThreadPoolExecutor(THREADS_MAX) as pool:
        surface = BlockingSurface(connection, target, pool)
        try:
            yield surface
        finally:
            surface.close()


@contextmanager
def awaited_surface(frontend: str, target: str) -> Iterator[AwaitedSurface]:
    """The asynchronous client, connected, on a loop of its own."""
    with asyncio.Runner() as runner:
        connection = runner.run(_connected(frontend))
        surface = AwaitedSurface(connection, target, runner.get_loop())
        try:
            yield surface
        finally:
            surface.close()
            runner.run(connection.aclose())


async def _connected(frontend: str) -> Any:
    return await aio.connect(frontend)
