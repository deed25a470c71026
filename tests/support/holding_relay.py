"""A TCP relay that can hold the bytes of callers, like a network that is slow in one direction."""

from __future__ import annotations

import asyncio
import contextlib
from collections.abc import AsyncIterator

CHUNK_BYTES = 64 * 1024


class HoldingRelay:
    """Forwards bytes in both directions. After `hold`, the bytes of callers wait here, in order, until `release`."""

    def __init__(self) -> None:
        self._may_pass = asyncio.Event()
        self._may_pass.set()
        self.holds_something = asyncio.Event()

    def hold(self) -> None:
        """Hold all bytes of callers from now on."""
        self.holds_something.clear()
        self._may_pass.clear()

    def release(self) -> None:
        """Forward all held bytes."""
        self._may_pass.set()

    async def forward(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, to_port: int) -> None:
        """Serve one connection, until either side ends it."""
        far_reader, far_writer = await asyncio.open_connection("127.0.0.1", to_port)
        ways = [self._to_far(reader, far_writer), _copy(far_reader, writer)]
        tasks = [asyncio.ensure_future(way) for way in ways]
        try:
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for task in tasks:
                task.cancel()
            await asyncio.gather(*tasks, return_exceptions=True)
            writer.transport.abort()
            far_writer.transport.abort()

    async def _to_far(self, reader: asyncio.StreamReader, far_writer: asyncio.StreamWriter) -> None:
        while chunk := await reader.read(CHUNK_BYTES):
            if not self._may_pass.is_set():
                self.holds_something.set()
                await self._may_pass.wait()
            far_writer.write(chunk)


async def _copy(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
    while chunk := await reader.read(CHUNK_BYTES):
        writer.write(chunk)


@contextlib.asynccontextmanager
async def holding_relay(to_address: str) -> AsyncIterator[tuple[HoldingRelay, str]]:
    """Yield a relay to `to_address`, and the relay's address."""
    relay, to_port = HoldingRelay(), int(to_address.rpartition(":")[2])
    connections: set[asyncio.Task[None]] = set()

    def accept(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        connections.add(asyncio.ensure_future(relay.forward(reader, writer, to_port)))

    async with await asyncio.start_server(accept, "127.0.0.1", 0) as server:
        try:
            yield relay, f"127.0.0.1:{server.sockets[0].getsockname()[1]}"
        finally:
            for connection in connections:
                connection.cancel()
            await asyncio.gather(*connections, return_exceptions=True)
