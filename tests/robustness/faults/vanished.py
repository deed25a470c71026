"""The link of a client goes down, so no packet of the client arrives, not even a FIN. The host must end its calls."""

from __future__ import annotations

import asyncio
import sys
import time
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager, suppress
from typing import Any

from stampede_rt import aio
from stampede_rt.security.tls import CLIENT_VARIABLES
from stampede_rt_local.namespaces import NetworkNamespace
from stampede_rt_runtime.identity import Role
from tests.robustness.faults.host_faults import PinnedChannel, pin
from tests.robustness.faults.scene import Fault, Scene
from tests.robustness.real_cluster.placed_process import FaultHadNoEffect
from tests.robustness.real_cluster.traffic import CLIENT
from tests.support.supernode.processes import clean_environment

FORGOTTEN_SECONDS_MAX = 45.0
"""The time in which a host must end the calls. Over TCP sockets it sends a sign of life every 2.5 s, and its kernel
waits 30 s for the acknowledgement. gRPC needs the same time.
"""
VANISHED_PATIENCE_SECONDS = 90.0
POLL_SECONDS = 0.1
PROGRAM = "tests.robustness.real_cluster.waiting_client"


async def vanish_client(scene: Scene) -> None:
    """Cut the link of a client with a subscription, a waiting get and a waiting put. The host must end all three."""
    pinned = await pin(scene)
    full = await _full(scene, pinned)
    transport, channels = scene.rng.choice(("tcp", "grpc")), (pinned.channel, full)
    async with _waiting_client(scene, pinned.channel.name, transport):
        await _until(lambda: _waiting(*channels), 3)
        began = time.monotonic()
        async with _unplugged(scene, scene.cluster.outside):
            await _until(lambda: _waiting(*channels), 0)
            recovery = time.monotonic() - began
    scene.ended(
        f"client over {transport}: its link is gone",
        began,
        recovery,
        limit_s=FORGOTTEN_SECONDS_MAX,
        evidence=f"{pinned.host.name} had a subscription, a waiting get and a waiting put, and after that none",
    )


async def _full(scene: Scene, pinned: PinnedChannel) -> aio.Channel:
    """A full channel at the host of the pinned channel."""
    assert scene.traffic is not None
    policy: dict[str, Any] = {"max_items": 1, "max_age": "1h", "on_full": "block"}
    full = await scene.traffic.rt.channel(f"{pinned.channel.name}/full", host=pinned.host.name, **policy)
    await full.put(b"all the room")
    return full


async def _waiting(channel: aio.Channel, full: aio.Channel) -> int:
    """The number of waiting calls and subscriptions at the host."""
    stats, full_stats = await channel.stats(), await full.stats()
    return stats.subscriptions + stats.waiting_gets + full_stats.waiting_puts


async def _until(count: Callable[[], Awaitable[int]], wanted: int) -> None:
    """Wait until `count` returns `wanted`. Raises TimeoutError."""
    async with asyncio.timeout(VANISHED_PATIENCE_SECONDS):
        while await count() != wanted:  # noqa: ASYNC110  # the host reports no event for it
            await asyncio.sleep(POLL_SECONDS)


@asynccontextmanager
async def _unplugged(scene: Scene, namespace: NetworkNamespace) -> AsyncIterator[None]:
    """Cut the link of the namespace during the block. Raises FaultHadNoEffect."""
    network, other = scene.cluster.network, scene.cluster.supernodes[0].namespace
    network.set_link(namespace, up=False)
    try:
        if await asyncio.to_thread(network.open_directions, (namespace, other)):
            raise FaultHadNoEffect(f"datagrams of {namespace.address} still arrive")
        yield
    finally:
        network.set_link(namespace, up=True)


@asynccontextmanager
async def _waiting_client(scene: Scene, name: str, transport: str) -> AsyncIterator[None]:
    """Run the client in the namespace without a service during the block."""
    cluster = scene.cluster
    assert cluster.frontend is not None
    environment = clean_environment()
    if (files := cluster.caller_files(Role.CLIENT, CLIENT)) is not None:
        environment |= dict(zip(CLIENT_VARIABLES, map(str, files.paths()), strict=True))
    command = (sys.executable, "-m", PROGRAM, cluster.frontend.address, name, transport)
    process = await asyncio.create_subprocess_exec(*cluster.outside.command(*command), env=environment)
    try:
        yield
    finally:
        with suppress(ProcessLookupError):
            process.kill()
        await process.wait()


FAULTS: dict[str, Fault] = {"vanish_client": vanish_client}
