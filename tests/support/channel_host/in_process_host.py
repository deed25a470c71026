"""A channel host on the test's event loop behind real gRPC, registered at a directory. All rigs use it."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from pathlib import Path
from typing import NamedTuple, TypeVar

import grpc

from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.objects.object_archive import ObjectSettings
from stampede_rt_channel_host.archive.objects.segment_store import SegmentStore
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.host import ChannelHost
from stampede_rt_runtime.clock import HostClock, SystemClock
from stampede_rt_runtime.dial import dial, dial_from_any_loop
from stampede_rt_runtime.limits import Limits
from stampede_rt_runtime.server import ServiceServer
from tests.support.waiting import pause

HOST_ID = b"the-host-id-here"
WAIT_SECONDS_MAX = 45.0

Status = TypeVar("Status")


class InProcessHost(NamedTuple):
    """A host and its port."""

    host: ChannelHost
    server: ServiceServer

    @property
    def target(self) -> str:
        return self.server.address

    def connect(self) -> grpc.aio.Channel:
        """A connection to the host. Its streams have small windows on every machine, so a stream that nobody reads is
        soon full.
        """
        options = [*Limits().channel_options(), ("grpc.http2.bdp_probe", 0)]
        return grpc.aio.insecure_channel(self.target, options=options)

    async def stop(self) -> None:
        await self.server.stop(self.host.leave)


async def started_host(
    frontend: str,
    *,
    host_id: bytes = HOST_ID,
    name: str = "h1",
    boot: int = 7,
    clock: HostClock | None = None,
    memory_bytes_max: int = 2**30,
    listen: str = "localhost:0",
    archive: Path | None = None,
    store: SegmentStore | None = None,
) -> InProcessHost:
    """Return a host once it has registered. The same id with another `boot` is a restarted host.

    `archive`: the folder of its archive; None: it has none. `store`: the object store to which closed files move.
    """
    server = ServiceServer(secret=None)
    folder = None if archive is None else ArchiveFolder(archive)
    if folder is not None:
        folder.open(host_id)
    host = ChannelHost(
        HostIdentity(host_id=host_id, name=name, boot_incarnation=boot),
        frontends=[frontend],
        dial=lambda target: dial(target, secret=None),
        dial_for_lease=lambda target: dial_from_any_loop(target, secret=None),
        clock=clock or SystemClock(),
        memory_bytes_max=memory_bytes_max,
        on_serving=lambda serving: None,
        on_defect=_fail,
        refused_calls=server.refused_calls,
        access=server.access,
        archive=folder,
        objects=None if store is None else ObjectSettings(store, 2**20, 600),
    )
    server.bind(listen)
    host.add_to(server.grpc)
    server.sockets.register(host.add_to)
    await server.start()
    await host.enter(server.address, local_target=await server.sockets.listen_locally())
    return InProcessHost(host, server)


async def until_status(ask: Callable[[], Awaitable[Status]], condition: Callable[[Status], bool]) -> Status:
    """Ask for the status again and again, until `condition` holds."""
    async with asyncio.timeout(WAIT_SECONDS_MAX):
        while not condition(status := await ask()):
            await pause()
    return status


def _fail(failure: BaseException) -> None:
    raise AssertionError("a task of the host died") from failure
