"""Gives both clients and the core in memory the same awaitable methods, so that one suite tests all of them."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import asynccontextmanager
from typing import Any

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.cluster.embedding import InProcessHost

_names = itertools.count()


class AwaitableObject:
    """A blocking object with awaitable methods. Each call runs in a thread of the object's pool."""

    def __init__(self, wrapped: Any, pool: ThreadPoolExecutor) -> None:
        self._wrapped = wrapped
        self._pool = pool

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._wrapped, name)
        if not callable(value):
            return value

        async def call(*args: Any, **kwargs: Any) -> Any:
            loop = asyncio.get_running_loop()
            bare, named = [_bare(one) for one in args], {name: _bare(one) for name, one in kwargs.items()}
            return await loop.run_in_executor(self._pool, lambda: value(*bare, **named))

        return call

    def subscribe(self, *args: Any, **kwargs: Any) -> BlockingIterator:
        return BlockingIterator(lambda: self._wrapped.subscribe(*args, **kwargs), self._pool)

    def producer(self) -> BlockingProducer:
        return BlockingProducer(self._wrapped.producer(), self._pool)


def waits_in_memory(channel: Any) -> int:
    """Return how many callers wait in shared memory over the connection of this handle. Its host cannot count them."""
    session = getattr(_bare(channel), "_session", None)
    return 0 if session is None else session.rings.waits.waiting


def _bare(argument: Any) -> Any:
    """Return the client's own object, without the wrapper."""
    if isinstance(argument, list):
        return [_bare(one) for one in argument]
    return argument._wrapped if isinstance(argument, AwaitableObject) else argument


class BlockingGroup(AwaitableObject):
    """A group. Its descriptors have awaitable methods, too."""

    def __getitem__(self, channel: Any) -> AwaitableObject:
        return AwaitableObject(self._wrapped[_bare(channel)], self._pool)

    def match(self, *args: Any, **kwargs: Any) -> BlockingIterator:
        bare = [_bare(one) for one in args]
        return BlockingIterator(lambda: self._wrapped.match(*bare, **kwargs), self._pool)


class BlockingIterator:
    """A blocking iterator, stepped in threads."""

    def __init__(self, make: Any, pool: ThreadPoolExecutor) -> None:
        self._make = make
        self._pool = pool
        self._made: Any = None

    async def _run(self, function: Any) -> Any:
        return await asyncio.get_running_loop().run_in_executor(self._pool, function)

    async def __aenter__(self) -> BlockingIterator:
        self._made = await self._run(self._make)
        return self

    async def __aexit__(self, *_: object) -> None:
        self._made.close()

    def __aiter__(self) -> BlockingIterator:
        return self

    async def __anext__(self) -> Any:
        item = await self._run(lambda: next(self._made, None))
        if item is None:
            raise StopAsyncIteration
        return item

    def batches(self) -> BlockingIterator:
        """See `Subscription.batches`."""
        batches = BlockingIterator(None, self._pool)
        batches._made = self._made.batches()
        return batches

    def __getattr__(self, name: str) -> Any:
        return getattr(self._made, name)


class BlockingProducer(AwaitableObject):
    async def __aenter__(self) -> BlockingProducer:
        return self

    async def __aexit__(self, *error: object) -> None:
        await asyncio.get_running_loop().run_in_executor(self._pool, lambda: self._wrapped.__exit__(*error))


class Surface:
    """Opens channels with names that no other test uses."""

    def __init__(self, connection: Any, pool: ThreadPoolExecutor | None = None) -> None:
        self.connection = AwaitableObject(connection, pool) if pool else connection
        self._pool = pool

    def live_in(self, host: InProcessHost) -> None:
        """Give the connection the host that its own program runs."""
        _bare(self.connection)._session.here = host

    async def channel(self, name: str | None = None, **policy: Any) -> Any:
        channel = await self.connection.channel(name or f"contract/{next(_names)}-{st.now()}", **policy)
        return AwaitableObject(channel, self._pool) if self._pool else channel

    async def group(self, name: str, *args: Any, **settings: Any) -> Any:
        group = await self.connection.group(name, *args, **settings)
        return BlockingGroup(group, self._pool) if self._pool else group

    async def cross_section(self, *args: Any, **settings: Any) -> Any:
        return await self.connection.cross_section(*args, **settings)


async def take(items: AsyncIterator[Any], count: int) -> list[Any]:
    """Return the next `count` items. Waits for at most 45 s."""
    async with asyncio.timeout(45):
        return [await anext(items) for _ in range(count)]


@asynccontextmanager
async def connected(client: str, address: str) -> AsyncIterator[Surface]:
    """Yield a connection to a cluster, with the `client` "aio" or "sync"."""
    if client == "aio":
        async with aio.connect(address) as connection:
            yield Surface(connection)
        return
    with st.connect(address) as blocking, ThreadPoolExecutor(16) as pool:
        yield Surface(blocking, pool)
