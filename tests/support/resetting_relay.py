"""A relay of HTTP/2 that resets the streams of a connection, and keeps the connection open.

A proxy does this, and so does a server whose own connection broke. If a stream is reset with INTERNAL_ERROR, gRPC
reports INTERNAL to the caller.
"""

from __future__ import annotations

import asyncio
import contextlib
import struct
import threading
from dataclasses import dataclass, field

PREFACE_BYTES = 24
HEADER_BYTES = 9
HEADERS, RST_STREAM = 1, 3
INTERNAL_ERROR, CANCEL = 2, 8


@dataclass(eq=False)
class _Connection:
    """Both ends of a connection. The relay writes only whole frames, so that it can add other frames between them."""

    client: asyncio.StreamWriter
    server: asyncio.StreamWriter
    streams: set[int] = field(default_factory=set)  # the streams that the client opened


class ResettingRelay:
    """Forwards every connection from `port` to `to_port`, on a separate thread. A context manager."""

    def __init__(self, port: int, to_port: int) -> None:
        self._port = port
        self._to_port = to_port
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="resetting relay", daemon=True)
        self._ready = threading.Event()
        self._stopped = asyncio.Event()
        self._opened = asyncio.Event()
        self._connections: set[_Connection] = set()
        self.resets = 0

    def __enter__(self) -> ResettingRelay:
        self._thread.start()
        self._ready.wait(10)
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._stopped.set)
        self._thread.join(10)

    def wait_for_a_stream(self) -> None:
        """Wait until a caller has a stream open. Do not call it on the relay's thread.

        Raises TimeoutError after 10 s.
        """
        asyncio.run_coroutine_threadsafe(self._one_is_open(), self._loop).result(10)

    async def _one_is_open(self) -> None:
        while not any(connection.streams for connection in self._connections):
            self._opened.clear()
            await self._opened.wait()

    def reset(self) -> None:
        """Reset all streams of callers, and return when the frames are sent. Do not call it on the relay's thread."""
        asyncio.run_coroutine_threadsafe(self._reset(), self._loop).result(10)

    async def _reset(self) -> None:
        for connection in self._connections:
            for stream in sorted(connection.streams):
                connection.client.write(_reset_frame(stream, INTERNAL_ERROR))
                connection.server.write(_reset_frame(stream, CANCEL))
                self.resets += 1
            connection.streams.clear()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        async with await asyncio.start_server(self._pass, "localhost", self._port):
            self._ready.set()
            await self._stopped.wait()
            for connection in tuple(self._connections):
                connection.client.transport.abort()
                connection.server.transport.abort()

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        far_reader, far_writer = await asyncio.open_connection("localhost", self._to_port)
        connection = _Connection(writer, far_writer)
        self._connections.add(connection)
        ways = [
            asyncio.ensure_future(self._from_client(reader, connection)),
            asyncio.ensure_future(self._from_server(far_reader, connection)),
        ]
        await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        self._connections.discard(connection)
        for way in ways:
            way.cancel()
        await asyncio.gather(*ways, return_exceptions=True)
        for end in (writer, far_writer):
            end.transport.abort()

    async def _from_client(self, reader: asyncio.StreamReader, connection: _Connection) -> None:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            connection.server.write(await reader.readexactly(PREFACE_BYTES))
            while True:
                kind, stream, frame = await _frame(reader)
                if kind == HEADERS:
                    connection.streams.add(stream)
                    self._opened.set()
                elif kind == RST_STREAM:
                    connection.streams.discard(stream)
                connection.server.write(frame)
                await connection.server.drain()

    async def _from_server(self, reader: asyncio.StreamReader, connection: _Connection) -> None:
        with contextlib.suppress(OSError, asyncio.IncompleteReadError):
            while True:
                _, _, frame = await _frame(reader)
                connection.client.write(frame)
                await connection.client.drain()


async def _frame(reader: asyncio.StreamReader) -> tuple[int, int, bytes]:
    """Return the next frame: its type, its stream and all its bytes (RFC 9113, section 4.1)."""
    header = await reader.readexactly(HEADER_BYTES)
    length = int.from_bytes(header[:3], "big")
    stream = int.from_bytes(header[5:], "big") & 0x7FFFFFFF
    return header[3], stream, header + await reader.readexactly(length)


def _reset_frame(stream: int, code: int) -> bytes:
    return struct.pack(">I", 4)[1:] + struct.pack(">BBII", RST_STREAM, 0, stream, code)
