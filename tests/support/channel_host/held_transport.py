"""A stream over a host's socket.

The test passes the bytes itself, and sees in the same turn which bytes the host writes.
"""

from __future__ import annotations

import asyncio
import os
from collections.abc import Iterable
from typing import Any

from stampede_rt.v1 import socket_stream_pb2
from stampede_rt.wire.stream_frames import PROTOCOL_VERSION, FrameKind, FrameReader, frame_of
from stampede_rt_runtime.sockets.server import SocketServer, _Stream
from stampede_rt_runtime.sockets.stream_socket import StreamSocket
from tests.support.socket_port import until


class HeldTransport:
    """The transport and the socket of a stream. Keeps the frames that the host writes, without signs of life."""

    def __init__(self) -> None:
        self.frames: list[tuple[int, bytes]] = []
        self._reader = FrameReader({FrameKind.MESSAGE: 2**25, FrameKind.STATUS: 2**16, FrameKind.ALIVE: 0})
        self.is_closed = False

    def write(self, data: bytes) -> None:
        self.frames += [frame for frame in self._reader.feed(data) if frame[0] != FrameKind.ALIVE]

    def writelines(self, parts: Iterable[bytes]) -> None:
        self.write(b"".join(parts))

    def get_extra_info(self, _name: str) -> HeldTransport:
        return self

    def fileno(self) -> int:
        return os.open(os.devnull, os.O_RDONLY)

    def is_closing(self) -> bool:
        return self.is_closed

    def abort(self) -> None:
        self.is_closed = True

    def can_write_eof(self) -> bool:
        return False

    def __getattr__(self, name: str) -> Any:
        return lambda *arguments: 0


def receive(connection: StreamSocket, data: bytes) -> None:
    """Hand over these bytes as the event loop does: each time as many as fit into the buffer."""
    while data:
        buffer = connection.get_buffer(-1)
        size = min(len(buffer), len(data))
        buffer[:size] = data[:size]
        connection.buffer_updated(size)
        data = data[size:]


class HeldStream:
    """One stream at a host's sockets."""

    def __init__(self, connection: StreamSocket, transport: HeldTransport) -> None:
        self.connection, self._transport = connection, transport

    def send(self, *messages: bytes) -> list[bytes]:
        """Pass these messages on together. Returns the bytes that the host has written before the call returned."""
        return self.send_frames(b"".join(frame_of(FrameKind.MESSAGE, one) for one in messages))

    def send_frames(self, data: bytes) -> list[bytes]:
        before = len(self._transport.frames)
        receive(self.connection, data)
        return self.written()[before:]

    def written(self) -> list[bytes]:
        return [body for _, body in self._transport.frames]

    async def until_written(self, count: int) -> list[bytes]:
        await until(lambda: len(self._transport.frames) >= count)
        return self.written()

    def close(self) -> None:
        self.connection.connection_lost(None)


async def held_stream(sockets: SocketServer, method: str) -> HeldStream:
    """Return a new stream, once the method waits for its first message."""
    connection, transport = sockets._connection(), HeldTransport()
    sockets._streams[connection] = _Stream(connection)
    sockets._hangups.watch = lambda *_: None  # type: ignore[method-assign]  # epoll takes no such files
    connection.connection_made(transport)
    opening = socket_stream_pb2.StreamOpening(method=method, protocol_version=PROTOCOL_VERSION)
    receive(connection, frame_of(FrameKind.OPENING, opening.SerializeToString()))
    await until(lambda: connection._waiter is not None)
    await asyncio.sleep(0)
    return HeldStream(connection, transport)
