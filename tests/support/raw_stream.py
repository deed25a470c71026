"""A caller that writes the frames of a stream over a socket itself, so that it can stop anywhere."""

from __future__ import annotations

import asyncio
import ssl
from collections import deque
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

from stampede_rt.v1 import rpc_status_pb2, socket_stream_pb2
from stampede_rt.wire.stream_frames import PROTOCOL_VERSION, FrameKind, FrameReader, frame_of

SECONDS_MAX = 20
SECURED: dict[str, ssl.SSLContext] = {}
"""The TLS contexts with which tests call these targets. The standard library makes the TLS, not the product."""


class RawStream:
    """One connection to a Unix socket or a TCP port of a host."""

    def __init__(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        self.reader, self.writer = reader, writer
        self.signs_of_life = 0
        self.is_greeted = False
        """Whether a TCP port has greeted."""
        self._frames = FrameReader({FrameKind.MESSAGE: 2**25, FrameKind.STATUS: 2**16, FrameKind.ALIVE: 0})
        self._received: deque[tuple[int, bytes]] = deque()

    async def begin(
        self, method: str, *, version: int = PROTOCOL_VERSION, secret: str = "", cluster: str = "", ticket: bytes = b""
    ) -> None:
        """Send the opening."""
        opening = socket_stream_pb2.StreamOpening(
            method=method,
            protocol_version=version,
            authorization=f"Bearer {secret}" if secret else "",
            cluster_id=cluster,
            ticket=ticket,
        )
        await self.send(FrameKind.OPENING, opening.SerializeToString())

    async def send(self, kind: FrameKind, body: bytes = b"") -> None:
        """Send a frame."""
        await self.send_bytes(frame_of(kind, body))

    async def send_bytes(self, data: bytes) -> None:
        """Send these bytes."""
        self.writer.write(data)
        async with asyncio.timeout(SECONDS_MAX):
            await self.writer.drain()

    async def frame(self) -> tuple[int, bytes] | None:
        """Return the next frame, or None at the end of the connection."""
        async with asyncio.timeout(SECONDS_MAX):
            while not self._received:
                try:
                    data = await self.reader.read(2**16)
                except ConnectionError:
                    return None
                if not data:
                    return None
                self._received.extend(self._frames.feed(data))
        return self._received.popleft()

    async def take_greeting(self) -> None:
        """Take the greeting, which is the first frame of a TCP port. If it is a refusal, leave it for the test."""
        frame = await self.frame()
        self.is_greeted = frame is not None and frame[0] == FrameKind.ALIVE
        if frame is not None and not self.is_greeted:
            self._received.appendleft(frame)

    async def message(self) -> bytes:
        """Return the next message."""
        frame = await self.frame()
        while frame is not None and frame[0] == FrameKind.ALIVE:
            self.signs_of_life += 1
            frame = await self.frame()
        assert frame is not None, "the connection has ended"
        assert frame[0] == FrameKind.MESSAGE, frame
        return frame[1]

    async def status(self) -> rpc_status_pb2.Status:
        """Return the status, after all messages."""
        while (frame := await self.frame()) is not None:
            if frame[0] == FrameKind.STATUS:
                return rpc_status_pb2.Status.FromString(frame[1])
        raise AssertionError("the connection ended without a status")

    async def has_ended(self) -> None:
        """Wait until the server has closed the connection."""
        while await self.frame() is not None:
            pass


@asynccontextmanager
async def raw_stream(target: str, tls: ssl.SSLContext | None = None) -> AsyncIterator[RawStream]:
    """Yield a new connection to "unix:PATH", or to "tcp:HOST:PORT" after the greeting.

    `tls`: the TLS of a TCP connection; None: the TLS of SECURED.
    """
    if target.startswith("tcp:"):
        host, _, port = target.removeprefix("tcp:").rpartition(":")
        reader, writer = await asyncio.open_connection(host, int(port), ssl=tls or SECURED.get(target))
    else:
        reader, writer = await asyncio.open_unix_connection(target.removeprefix("unix:"))
    stream = RawStream(reader, writer)
    try:
        if target.startswith("tcp:"):
            await stream.take_greeting()
        yield stream
    finally:
        writer.transport.abort()
