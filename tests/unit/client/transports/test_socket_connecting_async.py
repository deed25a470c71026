"""Sockets that asyncio callers open and give up."""

from __future__ import annotations

import asyncio
import socket
from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.transports import socket_connecting_async
from stampede_rt.transports.tcp_route import SocketConnection


@pytest.mark.parametrize("turns", range(8))
async def test_a_connection_is_closed_if_its_caller_gives_up_in_any_turn_of_the_loop(
    monkeypatch: pytest.MonkeyPatch, turns: int
) -> None:
    """In an earlier version, a connection stayed open if it was made in the turn in which its caller was cancelled."""
    ours, theirs = socket.socketpair()

    async def reach(*_: object) -> SocketConnection:
        await asyncio.sleep(0)
        return SocketConnection(ours)

    monkeypatch.setattr(socket_connecting_async, "_reach", reach)
    route: Any = SimpleNamespace(is_forced=True, tcp=SimpleNamespace(is_slow=False, reaching=None))
    call = asyncio.ensure_future(socket_connecting_async._reached(route, 1))
    for _ in range(turns):
        await asyncio.sleep(0)
    call.cancel()
    if (await asyncio.gather(call, return_exceptions=True))[0].__class__ is SocketConnection:
        ours.close()  # the caller has got the connection, so the caller closes it
    for _ in range(5):
        await asyncio.sleep(0)
    reached = route.tcp.reaching is not None
    assert ours.fileno() == -1 or not reached
    ours.close()
    theirs.close()
