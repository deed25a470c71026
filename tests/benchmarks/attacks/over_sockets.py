"""Attacks at a host's Unix socket, by a process of the same user."""

from __future__ import annotations

import asyncio
import itertools
from collections.abc import Awaitable, Callable
from contextlib import suppress

from stampede_rt.transports.grpc_options import PUT_METHOD
from stampede_rt.transports.machine import this_machine
from stampede_rt.v1 import gatekeeper_service_pb2 as gate_pb
from stampede_rt.v1.gatekeeper_service_pb2_grpc import GatekeeperServiceStub
from stampede_rt.wire.request_pieces import MESSAGE_BYTES_MAX
from stampede_rt.wire.stream_frames import FrameKind, frame_of, head_of
from tests.benchmarks.attacks.attacked_cluster import AttackedCluster, all_of
from tests.support.raw_stream import RawStream, raw_stream

SILENT, UNFINISHED, UNREAD = 1100, 1000, 200  # the sockets of each attack
UNREAD_MESSAGES = 10  # the messages that are not puts, for each socket of `malformed_frames`
PAUSE_SECONDS = 0.05  # between the end of a socket and the next one in its place


async def silent_sockets(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """1100 sockets that send nothing, not even the first frame. When a socket ends, the attacker opens another one."""

    await again_and_again(await _target(attacked), SILENT, RawStream.has_ended, on_begun)


async def unfinished_frames(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """1000 authenticated streams of puts over sockets. Each sends a frame of 256 KiB, except for its last byte."""

    async def begin(stream: RawStream) -> None:
        await stream.begin(PUT_METHOD, secret=attacked.secret)
        await stream.send_bytes(head_of(FrameKind.MESSAGE, MESSAGE_BYTES_MAX) + bytes(MESSAGE_BYTES_MAX - 1))
        await stream.has_ended()

    await again_and_again(await _target(attacked), UNFINISHED, begin, on_begun)


async def malformed_frames(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """200 sockets at a time that send bytes that are no frames, or messages that are not puts."""
    await again_and_again(await _target(attacked), UNREAD, garbage(attacked), on_begun)


def garbage(attacked: AttackedCluster) -> Callable[[RawStream], Awaitable[None]]:
    """Send bytes that are no frames on one connection, and messages that are not puts on the next one, in turn."""
    numbers = itertools.count()

    async def send(stream: RawStream) -> None:
        if next(numbers) % 2:
            await stream.send_bytes(b"\xff" * 77)
        else:
            await stream.begin(PUT_METHOD, secret=attacked.secret)
            await stream.send_bytes(frame_of(FrameKind.MESSAGE, b"\xff" * 77) * UNREAD_MESSAGES)
        await stream.has_ended()

    return send


async def again_and_again(
    target: str, sockets: int, play: Callable[[RawStream], Awaitable[None]], on_begun: Callable[[], None]
) -> None:
    """Play this number of connections at the same time. When a connection ends, open another one."""

    async def one() -> None:
        async with raw_stream(target) as stream:
            await play(stream)

    on_begun()
    await all_of(*(keep_on(one, PAUSE_SECONDS) for _ in range(sockets)))


async def keep_on(play: Callable[[], Awaitable[None]], pause_s: float) -> None:
    """Play again and again, whatever the host does."""
    while True:
        with suppress(OSError, TimeoutError):
            await play()
        await asyncio.sleep(pause_s)


async def _target(attacked: AttackedCluster) -> str:
    async with attacked.channel(attacked.host) as host:
        stub = GatekeeperServiceStub(host)
        request = gate_pb.ListDataEndpointsRequest(machine=this_machine())
        response = await stub.ListDataEndpoints(request, metadata=attacked.metadata)  # type: ignore[misc]
    return str(response.endpoints[0].target)
