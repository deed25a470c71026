"""A channel whose certificates are renewed while it is used."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from typing import Any, cast

import grpc

from stampede_rt.security.tls import TlsMaterial, TlsReader
from stampede_rt_runtime.renewing import RenewingChannel


class Call:
    """One call. The test ends it."""

    def __init__(self, connection: Connection) -> None:
        self.connection = connection
        self._callbacks: list[Callable[[Any], None]] = []

    def add_done_callback(self, callback: Callable[[Any], None]) -> None:
        self._callbacks.append(callback)

    def end(self) -> None:
        for callback in self._callbacks:
            callback(self)


class Connection:
    """One gRPC channel."""

    def __init__(self) -> None:
        self.closed = asyncio.Event()

    def unary_unary(self, method: str) -> Any:
        return lambda: Call(self)

    async def close(self, grace: float | None = None) -> None:
        self.closed.set()


class Renewals:
    """A reader of certificate files for the test, and the connections that were made with its certificates."""

    def __init__(self) -> None:
        self.material = object()
        self.made: list[Connection] = []

    def current(self) -> TlsMaterial:
        return cast(TlsMaterial, self.material)

    def renew(self) -> None:
        self.material = object()

    def connect(self, material: TlsMaterial) -> grpc.aio.Channel:
        self.made.append(Connection())
        return cast(grpc.aio.Channel, self.made[-1])

    def channel(self) -> RenewingChannel:
        return RenewingChannel(self.connect, cast(TlsReader, self))


async def test_calls_after_a_renewal_use_a_new_connection_and_earlier_calls_keep_theirs() -> None:
    renewals = Renewals()
    call = renewals.channel().unary_unary("/test.Probe/Echo")
    before = call()
    for _ in range(3):
        renewals.renew()
        assert call().connection is renewals.made[-1]
    assert before.connection is renewals.made[0]
    assert not renewals.made[0].closed.is_set()


async def test_a_former_connection_is_closed_when_its_last_call_has_ended() -> None:
    """In an earlier version, no code closed the former connection. gRPC opened it again and again with certificates
    that no server accepts.
    """
    renewals = Renewals()
    call = renewals.channel().unary_unary("/test.Probe/Echo")
    first, second = call(), call()
    first.end()
    renewals.renew()
    last = call()
    second.end()
    last.end()
    async with asyncio.timeout(45):
        await renewals.made[0].closed.wait()
    assert not renewals.made[1].closed.is_set()


async def test_an_idle_connection_is_closed_at_the_renewal() -> None:
    renewals = Renewals()
    channel = renewals.channel()
    renewals.renew()
    channel.current()
    async with asyncio.timeout(45):
        await renewals.made[0].closed.wait()


async def test_after_the_close_no_call_opens_a_connection() -> None:
    renewals = Renewals()
    channel = renewals.channel()
    call = channel.unary_unary("/test.Probe/Echo")
    await channel.close()
    renewals.renew()
    assert call().connection is renewals.made[0]
    assert len(renewals.made) == 1
    assert renewals.made[0].closed.is_set()
