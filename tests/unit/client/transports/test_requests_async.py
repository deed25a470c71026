"""The requests of a stream whose other side takes none."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import pytest

from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.transports.grpc_async import GetExchange
from stampede_rt.transports.socket_routes import SocketRoute
from stampede_rt.v1 import channel_service_pb2 as pb


class StoppedCall:
    """A call that takes `room` requests and no more, and answers nothing."""

    def __init__(self, room: int) -> None:
        self.written: list[Any] = []
        self._room = room

    def add_done_callback(self, _: Any) -> None:
        pass

    async def write(self, request: Any) -> None:
        if len(self.written) == self._room:
            await asyncio.get_running_loop().create_future()
        self.written.append(request)

    async def __aiter__(self) -> AsyncIterator[Any]:
        await asyncio.get_running_loop().create_future()
        yield


@pytest.mark.parametrize("gives_up", ["cancelled", "too late"])
async def test_abandoned_gets_use_no_memory_while_a_host_is_stopped(gives_up: str) -> None:
    call, tasks = StoppedCall(room=3), set[asyncio.Task[None]]()
    exchange = GetExchange(call, "a host", tasks, SocketRoute("a host", Transport.GRPC))
    for _ in range(5000):
        timeout_s = 0 if gives_up == "too late" else None
        get = asyncio.ensure_future(exchange.get(pb.GetRequest(channel_id=bytes(16)), timeout_s))
        await asyncio.sleep(0)
        get.cancel()
        await asyncio.wait([get])
    await asyncio.sleep(0)
    assert len(call.written) == 3
    assert len(exchange._requests) <= 4  # the calls that the host may have are cancelled, and no others
    for task in tasks:
        task.cancel()
