"""Wraps objects of the blocking client, so that tests can await their methods like those of `stampede_rt.aio`."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import stampede_rt as st

_BLOCKING = (
    st.Channel, st.Group, st.Queue, st.Mailbox, st.Message, st.Connection, st.Subscription, st.CutSubscription,
    st.MatchSubscription, st.Watch, st.PeerWatch,
)  # fmt: skip


def awaitable(value: Any, pool: ThreadPoolExecutor | None) -> Any:
    """Return `value`, wrapped if it is of the blocking client. `pool` None: it is of `stampede_rt.aio`, or plain."""
    return AwaitableBlocking(value, pool) if pool is not None and isinstance(value, _BLOCKING) else value


class AwaitableBlocking:
    """A blocking object with awaitable methods. They return wrapped objects, too."""

    def __init__(self, wrapped: Any, pool: ThreadPoolExecutor) -> None:
        self._wrapped = wrapped
        self._pool = pool

    async def _run(self, function: Any, *args: Any, **kwargs: Any) -> Any:
        call = asyncio.get_running_loop().run_in_executor(self._pool, lambda: function(*args, **kwargs))
        return awaitable(await call, self._pool)

    def __getattr__(self, name: str) -> Any:
        value = getattr(self._wrapped, {"aclose": "close"}.get(name, name))
        if not callable(value):
            return awaitable(value, self._pool)

        async def call(*args: Any, **kwargs: Any) -> Any:
            return await self._run(value, *map(_plain, args), **{key: _plain(one) for key, one in kwargs.items()})

        return call

    def __getitem__(self, name: str) -> Any:
        return AwaitableBlocking(self._wrapped[name], self._pool)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, AwaitableBlocking) and other._wrapped == self._wrapped

    def __hash__(self) -> int:
        return hash(self._wrapped)

    async def __aenter__(self) -> Any:
        await self._run(self._wrapped.__enter__)
        return self

    async def __aexit__(self, *error: Any) -> None:
        await self._run(self._wrapped.__exit__, *error)

    def __aiter__(self) -> AwaitableBlocking:
        return self

    async def __anext__(self) -> Any:
        found = await self._run(next, self._wrapped, None)
        if found is None:
            raise StopAsyncIteration
        return found


def _plain(argument: Any) -> Any:
    """Return the client's own object, without the wrapper."""
    if isinstance(argument, list):
        return [_plain(one) for one in argument]
    return argument._wrapped if isinstance(argument, AwaitableBlocking) else argument
