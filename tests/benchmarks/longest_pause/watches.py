"""Cases of supernodes: many watches of the directory, over gRPC."""

from __future__ import annotations

import asyncio
import sys
from contextlib import AsyncExitStack

import grpc

from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1.directory_service_pb2_grpc import DirectoryServiceStub
from tests.benchmarks.longest_pause.sizes import WATCHED_CHANGES
from tests.benchmarks.longest_pause.watch import PATIENCE_SECONDS, Work, until
from tests.support.channel_host.rig import Rig
from tests.support.supernode.node import running_node


async def watches(_: Rig, count: int) -> tuple[str, Work]:
    """Prepare changes of the directory that `count` watches of another process receive. The watches end with that
    process.
    """
    stack = AsyncExitStack()
    node = await stack.enter_async_context(running_node())
    await node.register(1, name="one")
    words = [node.address, "watch", str(count), "0"]
    client = await asyncio.create_subprocess_exec(
        sys.executable, "-m", "tests.benchmarks.longest_pause", "--client", *words
    )
    listening = node.watches._notifier._listening
    async with asyncio.timeout(PATIENCE_SECONDS):
        await until(lambda: len(listening) == count)

    async def work() -> None:
        for number in range(WATCHED_CHANGES):
            await node.open(f"c{number}")
        async with asyncio.timeout(PATIENCE_SECONDS):
            assert await client.wait() == 0, "the client failed"
            await until(lambda: not listening)
        await stack.aclose()

    return f"{WATCHED_CHANGES} changes of the directory with {count:,} watches, which then end", work


async def watch(target: str, count: int) -> None:
    """Open `count` watches, each of which gets all changes."""

    async def one(connection: grpc.aio.Channel) -> None:
        events = 0
        async for response in DirectoryServiceStub(connection).Watch(pb.WatchRequest()):
            events += len(response.changes)
            if events >= WATCHED_CHANGES:
                return

    options = [("grpc.use_local_subchannel_pool", 1)]
    connections = [grpc.aio.insecure_channel(target, options=options) for _ in range(20)]
    await asyncio.gather(*(one(connections[at % 20]) for at in range(count)))
    for connection in connections:
        await connection.close()
