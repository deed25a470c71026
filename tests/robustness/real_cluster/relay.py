"""A TCP relay that simulates a bad network: `python -m tests.robustness.real_cluster.relay LISTEN_HOST:PORT
TO_HOST:PORT`.

Lines on stdin set the conditions of the link: `delay_s jitter_s stall_share cut_share [bytes_per_s]`. The relay answers
each line with the counts of the former conditions: chunks, stalled chunks, milliseconds of all waits, and cut
connections. Every chunk waits for the delay and a random part of the jitter. A `stall_share` of the chunks waits 0.2 to
0.6 s more, like a TCP reader for a lost segment (RFC 6298). At a `cut_share` of the chunks the relay resets the
connection. All connections share `bytes_per_s` in each direction. The bytes of one connection stay in order; the bytes
of different connections may overtake each other.
"""

from __future__ import annotations

import asyncio
import contextlib
import math
import random
import sys
from dataclasses import dataclass

CHUNK_BYTES = 64 * 1024
CHUNKS_WAITING_MAX = 256


@dataclass(slots=True)
class LinkConditions:
    """The delays and cuts of chunks, with counts of them."""

    delay_s: float = 0.0
    jitter_s: float = 0.0
    stall_share: float = 0.0
    cut_share: float = 0.0
    bytes_per_s: float = math.inf
    chunks: int = 0
    stalled: int = 0
    waited_s: float = 0.0
    cuts: int = 0

    def wait_s(self) -> float:
        """The time that the next chunk waits."""
        stalled = random.random() < self.stall_share
        wait_s = self.delay_s + random.random() * self.jitter_s + (random.uniform(0.2, 0.6) if stalled else 0.0)
        self.chunks, self.stalled, self.waited_s = self.chunks + 1, self.stalled + stalled, self.waited_s + wait_s
        return wait_s

    def cuts_now(self) -> bool:
        """Whether the relay resets the connection at this chunk."""
        cut = random.random() < self.cut_share
        self.cuts += cut
        return cut

    def counts(self) -> str:
        """The line with the counts."""
        return f"{self.chunks} {self.stalled} {round(1000 * self.waited_s)} {self.cuts}"


class _Way:
    """One direction, with a limit of bytes per second. A sender beyond the limit waits."""

    def __init__(self) -> None:
        self._free_at = 0.0

    async def carry(self, size_bytes: int, bytes_per_s: float) -> None:
        now = asyncio.get_running_loop().time()
        self._free_at = max(now, self._free_at) + size_bytes / bytes_per_s
        await asyncio.sleep(self._free_at - now)


class Relay:
    """Relays each connection to `target`, under the present conditions."""

    def __init__(self, target: tuple[str, int]) -> None:
        self.conditions = LinkConditions()
        self._target = target
        self._inward, self._outward = _Way(), _Way()

    async def serve(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        """Relay one connection, until either side closes it or the relay resets it."""
        try:
            far_reader, far_writer = await asyncio.open_connection(*self._target)
        except OSError:
            writer.transport.abort()
            return
        ways = [
            asyncio.create_task(self._pass(reader, far_writer, self._inward)),
            asyncio.create_task(self._pass(far_reader, writer, self._outward)),
        ]
        try:
            await asyncio.wait(ways, return_when=asyncio.FIRST_COMPLETED)
        finally:
            for way in ways:
                way.cancel()
            await asyncio.gather(*ways, return_exceptions=True)
            for end in (writer, far_writer):
                end.transport.abort()

    async def _pass(self, reader: asyncio.StreamReader, writer: asyncio.StreamWriter, way: _Way) -> None:
        waiting: asyncio.Queue[tuple[float, bytes]] = asyncio.Queue(CHUNKS_WAITING_MAX)
        sending = asyncio.create_task(_send(waiting, writer))
        now = asyncio.get_running_loop().time
        try:
            with contextlib.suppress(OSError):
                while chunk := await reader.read(CHUNK_BYTES):
                    if self.conditions.cuts_now() or sending.done():
                        return
                    await way.carry(len(chunk), self.conditions.bytes_per_s)
                    await waiting.put((now() + self.conditions.wait_s(), chunk))
        finally:
            sending.cancel()
            await asyncio.gather(sending, return_exceptions=True)


async def _send(waiting: asyncio.Queue[tuple[float, bytes]], writer: asyncio.StreamWriter) -> None:
    now = asyncio.get_running_loop().time
    while True:
        due, chunk = await waiting.get()
        await asyncio.sleep(max(0.0, due - now()))
        writer.write(chunk)
        await writer.drain()


async def main(listen: str, to: str) -> None:
    """Relay until stdin closes."""
    host, _, port = to.rpartition(":")
    relay = Relay((host, int(port)))
    host, _, port = listen.rpartition(":")
    async with await asyncio.start_server(relay.serve, host, int(port)):
        print("ready", flush=True)
        while line := await asyncio.to_thread(sys.stdin.readline):
            former, relay.conditions = relay.conditions, LinkConditions(*map(float, line.split()))
            print(former.counts(), flush=True)


if __name__ == "__main__":
    asyncio.run(main(*sys.argv[1:]))
