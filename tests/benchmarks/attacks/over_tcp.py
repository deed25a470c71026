"""Attacks at the TCP port of a host for streams. For the last three the cluster has certificates."""

from __future__ import annotations

import asyncio
import itertools
import ssl
from collections.abc import Awaitable, Callable
from contextlib import suppress

from stampede_rt.transports.grpc_options import PUT_METHOD
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.wire.request_pieces import MESSAGE_BYTES_MAX
from stampede_rt.wire.stream_frames import FrameKind, head_of
from tests.benchmarks.attacks.attacked_cluster import AttackedCluster, all_of
from tests.benchmarks.attacks.memory import everything, held_channel
from tests.benchmarks.attacks.over_sockets import (
    PAUSE_SECONDS,
    SILENT,
    UNFINISHED,
    UNREAD,
    again_and_again,
    garbage,
    keep_on,
)
from tests.support.raw_stream import RawStream

GET_METHOD = "/stampede_rt.v1.ChannelService/Get"
READERS, GETS = 60, 16
FLOODERS = 64  # callers that begin a handshake, leave, and begin the next one

Play = Callable[[asyncio.StreamReader, asyncio.StreamWriter], Awaitable[None]]


async def tcp_silent(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """1100 TCP connections that send nothing, not even the first frame; as one ends, the attacker opens another one."""
    await again_and_again(attacked.data_target, SILENT, RawStream.has_ended, on_begun)


async def tcp_unfinished(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """1000 authenticated streams of puts over TCP. Each sends a frame of 256 KiB, except for its last byte."""

    async def begin(stream: RawStream) -> None:
        await stream.begin(PUT_METHOD, secret=attacked.secret)
        await stream.send_bytes(head_of(FrameKind.MESSAGE, MESSAGE_BYTES_MAX) + bytes(MESSAGE_BYTES_MAX - 1))
        await stream.has_ended()

    await again_and_again(attacked.data_target, UNFINISHED, begin, on_begun)


async def tcp_malformed(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """200 TCP connections at a time that send no frames, or messages that are not puts."""
    await again_and_again(attacked.data_target, UNREAD, garbage(attacked), on_begun)


async def tcp_silent_gets(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """60 streams over TCP with 16 gets of all items each, whose answers no reader reads."""
    async with attacked.connect() as rt:
        known = await held_channel(attacked, rt)

        async def ask(stream: RawStream) -> None:
            await stream.begin(GET_METHOD, secret=attacked.secret)
            for call_id in range(1, GETS + 1):
                request = pb.GetRequest(call_id=call_id, interval=everything(), **known)
                await stream.send(FrameKind.MESSAGE, request.SerializeToString())
            await asyncio.Event().wait()

        await again_and_again(attacked.data_target, READERS, ask, on_begun)


async def tcp_half_closed(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """1000 streams of puts over TCP whose callers close only their own side, read nothing, and open the next ones."""

    async def half_close(stream: RawStream) -> None:
        await stream.begin(PUT_METHOD, secret=attacked.secret)
        stream.writer.write_eof()
        await asyncio.sleep(1.0)

    await again_and_again(attacked.data_target, UNFINISHED, half_close, on_begun)


async def tls_unfinished(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """1100 connections that begin a handshake and never finish it; as one ends, the attacker opens another one."""

    async def begin(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(hello())
        while await reader.read(2**16):
            pass

    await _connections(attacked, SILENT, begin, on_begun)


async def tls_hellos(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """64 callers without a certificate begin handshakes and leave immediately, as fast as they can."""

    async def begin(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        writer.write(hello())
        await reader.read(1)

    await _connections(attacked, FLOODERS, begin, on_begun, pause_s=0.0)


async def tls_malformed(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """200 connections at a time that send no handshake, or break one off in its middle."""
    numbers = itertools.count()

    async def send(reader: asyncio.StreamReader, writer: asyncio.StreamWriter) -> None:
        first = hello()
        writer.write((b"\xff" * 77, first[: len(first) // 2] + b"\0" * 100, first + first)[next(numbers) % 3])
        await reader.read()

    await _connections(attacked, UNREAD, send, on_begun)


def hello() -> bytes:
    """The first bytes of a handshake with TLS 1.3, by a caller without a certificate."""
    outgoing = ssl.MemoryBIO()
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_CLIENT)
    made = context.wrap_bio(ssl.MemoryBIO(), outgoing, server_hostname="localhost")
    with suppress(ssl.SSLWantReadError):
        made.do_handshake()
    return outgoing.read()


async def _connections(
    attacked: AttackedCluster, count: int, play: Play, on_begun: Callable[[], None], pause_s: float = PAUSE_SECONDS
) -> None:
    host, _, port = attacked.data_port.rpartition(":")

    async def one() -> None:
        reader, writer = await asyncio.open_connection(host, int(port))
        try:
            await play(reader, writer)
        finally:
            writer.transport.abort()

    on_begun()
    await all_of(*(keep_on(one, pause_s) for _ in range(count)))
