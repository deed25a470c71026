"""A TCP relay whose connections a test can cut: with RST, with FIN, or in the middle of a frame."""

from __future__ import annotations

import asyncio
import contextlib
import random
import socket
import struct
import threading
from collections.abc import Awaitable, Callable, Collection, Mapping
from contextlib import AsyncExitStack
from functools import partial
from typing import Literal, NamedTuple

CHUNK_BYTES = 64 * 1024
Cut = Literal["reset", "close", "half"]
CUTS: tuple[Cut, ...] = ("reset", "close", "half")


class CuttingRelay:
    """Forwards every connection from the ports to their targets, on a separate thread. A context manager.

    `targets`: the host and port behind each port. Any thread may call `cut` and `stop_after`. "reset" ends all
    connections with RST, "close" with FIN. "half" forwards a part of the next chunk, so that a frame is incomplete, and
    then resets. While `refuses` is True, the relay resets new connections immediately.
    """

    def __init__(self, targets: Mapping[int, tuple[str, int]], seed: int = 0) -> None:
        self._targets = targets
        self._random_source = random.Random(seed)
        self._loop = asyncio.new_event_loop()
        self._thread = threading.Thread(target=self._run, name="relay", daemon=True)
        self._ready = threading.Event()
        self._stopped = asyncio.Event()
        self._writers: set[asyncio.StreamWriter] = set()
        self._breaks_off = False  # whether the next chunk is forwarded in part, and then its connection is reset
        self._stop: _StopPoint | None = None
        self.refuses = False
        self.cuts = 0  # the number of connections that the relay has ended

    def __enter__(self) -> CuttingRelay:
        self._thread.start()
        self._ready.wait(10)
        return self

    def __exit__(self, *_: object) -> None:
        self._loop.call_soon_threadsafe(self._stopped.set)
        self._thread.join(10)

    def cut(self, how: Cut) -> None:
        """Cut all connections; with "half", when the next chunk comes."""
        self._loop.call_soon_threadsafe(self._cut, how)

    def _cut(self, how: Cut) -> None:
        self._breaks_off = how == "half"
        if how == "half":
            return
        for writer in tuple(self._writers):
            self._end(writer, reset=how == "reset")

    def stop_after(self, byte_count: int, ports: Collection[int], then: Callable[[], bool]) -> None:
        """Forward this many bytes to and from `ports`, and then call `then` once, in the thread of the relay.

        If `then` returns True, the relay resets the connection that has the next byte.
        """
        self._loop.call_soon_threadsafe(setattr, self, "_stop", _StopPoint(byte_count, ports, then))

    def _end(self, writer: asyncio.StreamWriter, *, reset: bool) -> None:
        if writer in self._writers:
            self._writers.discard(writer)
            self.cuts += 1
            if reset:
                linger = struct.pack("ii", 1, 0)  # the close then sends RST
                with contextlib.suppress(OSError):
                    writer.get_extra_info("socket").setsockopt(socket.SOL_SOCKET, socket.SO_LINGER, linger)
            writer.transport.abort()

    def _run(self) -> None:
        with asyncio.Runner(loop_factory=lambda: self._loop) as runner:
            runner.run(self._serve())

    async def _serve(self) -> None:
        async with AsyncExitStack() as stack:
            for port, target in self._targets.items():
                server = await asyncio.start_server(partial(self._pass, port, target), "localhost", port)
                await stack.enter_async_context(server)
            self._ready.set()
            await self._stopped.wait()
            self._cut("close")

    async def _pass(
        self, port: int, target: tuple[str, int], reader: asyncio.StreamReader, writer: asyncio.StreamWriter
    ) -> None:
        self._writers.add(writer)
        if self.refuses:
            self._end(writer, reset=True)
            return
        try:
            far_reader, far_writer = await asyncio.open_connection(*target)
        except OSError:
            self._end(writer, reset=True)
            return
        self._writers.add(far_writer)
        ends = (writer, far_writer)
        await _first_to_end(self._flow(port, reader, far_writer, ends), self._flow(port, far_reader, writer, ends))
        for end in ends:
            self._end(end, reset=False)

    async def _flow(
        self, port: int, reader: asyncio.StreamReader, writer: asyncio.StreamWriter,
        ends: tuple[asyncio.StreamWriter, ...],
    ) -> None:  # fmt: skip
        with contextlib.suppress(OSError):
            while chunk := await reader.read(CHUNK_BYTES):
                position, then = self._place_of_fault(port, len(chunk))
                writer.write(chunk[:position])
                if then is not None:
                    await asyncio.sleep(0)  # the event loop sends the part first
                    if then():
                        for end in ends:
                            self._end(end, reset=True)
                        return
                writer.write(chunk[position:])
                await writer.drain()

    def _place_of_fault(self, port: int, byte_count: int) -> tuple[int, Callable[[], bool] | None]:
        """The number of next bytes before a fault, and the fault; all bytes and None if there is no fault."""
        if self._breaks_off:
            self._breaks_off = False
            return self._random_source.randrange(byte_count), lambda: True
        stop = self._stop
        if stop is None or port not in stop.ports:
            return byte_count, None
        if stop.byte_count < byte_count:
            self._stop = None
            return stop.byte_count, stop.then
        self._stop = stop._replace(byte_count=stop.byte_count - byte_count)
        return byte_count, None


class _StopPoint(NamedTuple):
    """See `CuttingRelay.stop_after`."""

    byte_count: int
    ports: Collection[int]
    then: Callable[[], bool]


async def _first_to_end(*ways: Awaitable[None]) -> None:
    tasks = [asyncio.ensure_future(way) for way in ways]
    await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)
