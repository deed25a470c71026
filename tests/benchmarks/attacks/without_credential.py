"""Attacks by callers without a credential, or with messages that they begin and never finish."""

from __future__ import annotations

import asyncio
from collections.abc import Callable, Iterator
from contextlib import suppress

import grpc

from stampede_rt.transports.grpc_options import PUT_METHOD
from stampede_rt.wire.request_pieces import MESSAGE_BYTES_MAX, messages_of
from tests.benchmarks.attacks.attacked_cluster import AttackedCluster, Uploads, all_of, for_ever
from tests.support.raw_http2 import RawConnection

CHECK = "/grpc.health.v1.Health/Check"
CALLS, CONNECTION_CALLS = 4096, 1024
UNFINISHED, UNFINISHED_BYTES = 50, 20 * 2**20
FLOOD_CONNECTIONS, FLOOD_CALLS = 10, 100
IDLE_CONNECTIONS = 1100
CALLERS = 8
NO_REQUEST = b"\xff" * 77
UNARY = {
    "host": ("GatekeeperService/Ping", "GatekeeperService/BindChannel", "ChannelService/GetChannelStatus"),
    "supernode": ("DirectoryService/ResolveChannel", "DirectoryService/RegisterHost", "DirectoryService/ListChannels"),
    "frontend": ("FrontendService/Bind",),
}


async def health_headers(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Keep 4096 calls of Health/Check open that have headers only. Replaces each call that ends."""
    raws = [await RawConnection.open(attacked.host) for _ in range(CALLS // CONNECTION_CALLS)]
    on_begun()
    while True:
        for raw in raws:
            for stream in [await raw.call(CHECK) for _ in range(CONNECTION_CALLS)]:
                with suppress(TimeoutError):
                    async with asyncio.timeout(1.0):
                        await raw.ended[stream].wait()


async def unfinished_health(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """50 calls of Health/Check with a message of 20 MiB each that is never finished."""
    await _unfinished(attacked, CHECK, {}, on_begun)


async def unfinished_puts(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """50 streams of puts with a request of 20 MiB each, of which the last piece never comes, with a client's token."""
    uploads, messages = Uploads(attacked, PUT_METHOD), [*messages_of(bytes(UNFINISHED_BYTES))][:-1]
    for _ in range(UNFINISHED):
        uploads.begin(messages)
    await uploads.until_stuck()
    on_begun()
    await for_ever()


async def unfinished_messages(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """1000 streams of puts with a message of 256 KiB each that is never finished, with a client's token."""
    await _unfinished(attacked, PUT_METHOD, dict(attacked.metadata), on_begun, 1000, MESSAGE_BYTES_MAX)


async def _unfinished(
    attacked: AttackedCluster,
    method: str,
    metadata: dict[str, str],
    on_begun: Callable[[], None],
    streams: int = UNFINISHED,
    message_bytes: int = UNFINISHED_BYTES,
) -> None:
    raw = await RawConnection.open(attacked.host)
    await raw.greeted.wait()
    begun = [await raw.call(method, metadata) for _ in range(streams)]
    await all_of(*(raw.send_as_allowed(stream, message_bytes, message_bytes - 1) for stream in begun))
    on_begun()
    await for_ever()


async def resets(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Calls that are reset as soon as they are made, on 10 connections."""
    on_begun()
    await all_of(*(_flood(attacked) for _ in range(FLOOD_CONNECTIONS)))


async def _flood(attacked: AttackedCluster) -> None:
    while True:
        with suppress(OSError, asyncio.IncompleteReadError):
            raw = await RawConnection.open(attacked.target)
            for _ in range(FLOOD_CALLS):
                await raw.reset(await raw.call(CHECK))
            await asyncio.sleep(0)
            await raw.aclose()


async def idle_connections(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """1100 connections on which nothing happens, to a host whose soft limit of open files is 1024."""
    name, _, port = attacked.host.rpartition(":")
    held = []
    for _ in range(IDLE_CONNECTIONS):
        with suppress(OSError, TimeoutError):
            async with asyncio.timeout(2.0):
                held.append(await asyncio.open_connection(name, int(port)))
    on_begun()
    await for_ever()


async def malformed(attacked: AttackedCluster, on_begun: Callable[[], None]) -> None:
    """Malformed requests of 77 bytes, to methods of all services. Half of the callers have the secret."""
    on_begun()
    await all_of(*(_send_malformed(attacked, with_secret=bool(number % 2)) for number in range(CALLERS)))


async def _send_malformed(attacked: AttackedCluster, *, with_secret: bool) -> None:
    channels = {part: attacked.channel(getattr(attacked, part)) for part in UNARY}
    while True:
        for part, method in _methods():
            call = channels[part].unary_unary(f"/stampede_rt.v1.{method}")
            with suppress(grpc.aio.AioRpcError):
                await call(NO_REQUEST, metadata=attacked.metadata if with_secret else (), timeout=10)


def _methods() -> Iterator[tuple[str, str]]:
    yield from ((part, method) for part, methods in UNARY.items() for method in methods)
