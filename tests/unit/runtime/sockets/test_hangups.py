"""A service notices that a caller has closed its socket."""

from __future__ import annotations

import asyncio
import contextlib
import os
import socket
from collections import Counter

import pytest

from stampede_rt_runtime.sockets import server
from stampede_rt_runtime.sockets.hangups import CLOSES_PER_TURN_MAX, HangupWatcher
from stampede_rt_runtime.sockets.stream_socket import StreamSocket
from tests.support.raw_stream import raw_stream
from tests.support.socket_port import ECHO, HOLD, Open, port_fixture, until

port = port_fixture()


async def test_the_close_of_a_watched_socket_is_reported_once_without_a_read() -> None:
    hangups = HangupWatcher()
    near, far = socket.socketpair()
    events = asyncio.Queue[str]()
    with near:
        hangups.watch(near, lambda: events.put_nowait("gone"))
        far.sendall(b"more")
        far.close()
        assert await asyncio.wait_for(events.get(), 20) == "gone"
        hangups.forget(near)
    hangups.close()
    assert events.empty()


async def test_a_socket_with_the_file_number_of_a_closed_socket_is_watched() -> None:
    hangups = HangupWatcher()
    closed, closed_far = socket.socketpair()
    near, far = socket.socketpair()
    events = asyncio.Queue[str]()
    hangups.watch(closed, lambda: events.put_nowait("closed"))
    os.dup2(near.fileno(), closed.fileno())  # the system closes the former file, and gives its number to another one
    with socket.socket(fileno=closed.detach()) as successor, closed_far:
        near.close()
        hangups.watch(successor, lambda: events.put_nowait("successor"))
        hangups.forget(closed)
        far.close()
        assert await asyncio.wait_for(events.get(), 20) == "successor"
    hangups.close()


@pytest.mark.parametrize(("method", "unread"), [(ECHO, b""), (ECHO, b"an answer"), (HOLD, b"")])
async def test_a_service_closes_a_few_streams_of_a_disconnected_caller_in_each_turn(
    port: Open, monkeypatch: pytest.MonkeyPatch, method: str, unread: bytes
) -> None:
    """The service is reading from the streams of ECHO, so asyncio notices the end of each. It reads nothing from HOLD.

    A connection with bytes that the caller has not read breaks (ECONNRESET) instead of ending.
    """
    lost_in: Counter[int] = Counter()
    turn, lose, loop = 0, server.SocketServer.lost, asyncio.get_running_loop()

    def count_turns() -> None:
        nonlocal turn
        turn += 1
        if lost_in.total() < 40:
            loop.call_soon(count_turns)

    def lost(self: server.SocketServer, connection: StreamSocket) -> None:
        lost_in[turn] += 1
        lose(self, connection)

    monkeypatch.setattr(server.SocketServer, "lost", lost)
    async with port() as one, contextlib.AsyncExitStack() as stack:
        streams = [await stack.enter_async_context(raw_stream(one.target)) for _ in range(40)]
        for stream in streams:
            await stream.begin(method)
        served = one.server.sockets._streams
        await until(lambda: len(served) == 40 and all(found.task is not None for found in served.values()))
        await until(lambda: all(found._is_paused is (method == HOLD) for found in served))
        count_turns()
        for stream in streams:
            stream.writer.transport.pause_reading()
        for found in served if unread else ():
            found._write_message(unread)
        for stream in streams:
            stream.writer.transport.abort()
        await until(lambda: not served)
        assert lost_in.total() == 40
        assert max(lost_in.values()) <= CLOSES_PER_TURN_MAX
