"""`ServerEndpoint.share_memory` on asyncio: a ring is closed if its caller no longer wants it."""

from __future__ import annotations

import asyncio
import threading
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.transports import grpc_async


class Ring:
    """The parts of a mapped ring that an endpoint uses."""

    def __init__(self) -> None:
        self.closed = asyncio.Event()

    def close(self) -> None:
        self.closed.set()


async def test_a_ring_that_comes_after_its_caller_was_cancelled_is_closed(monkeypatch: pytest.MonkeyPatch) -> None:
    loop, begun, may_come, ring = asyncio.get_running_loop(), asyncio.Event(), threading.Event(), Ring()

    async def connect(route: Any, ask: Any) -> None:
        return None

    def receive(*_: Any) -> Ring:
        loop.call_soon_threadsafe(begun.set)
        may_come.wait(10)
        return ring

    monkeypatch.setattr(grpc_async, "connect", connect)
    monkeypatch.setattr(grpc_async, "receive_ring", receive)
    endpoint: Any = SimpleNamespace(route=None, _ask_for_sockets=None, _metadata=list)
    opening = asyncio.ensure_future(grpc_async.ServerEndpoint.share_memory(endpoint, b"channel", 1))
    await begun.wait()
    opening.cancel()
    with pytest.raises(asyncio.CancelledError):
        await opening
    assert not ring.closed.is_set()
    may_come.set()
    async with asyncio.timeout(45):
        await ring.closed.wait()
