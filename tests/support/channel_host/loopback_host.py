"""A channel host on real gRPC in a process of its own, whose clock stands still until a test moves it.

The process also serves a directory. The test steers the process by the lines `tick NANOS WALL_STEP` and `settle` on its
standard input. The process answers each line with the host's time. With certificates, the directory and the host take
callers with certificates only.
"""

from __future__ import annotations

import asyncio
import os
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from stampede_rt.errors import ChannelNotFound
from stampede_rt.security.tls import TlsFiles
from stampede_rt.status import abort
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.host import ChannelHost
from stampede_rt_local.certificates import ClusterCertificates
from stampede_rt_runtime.dial import dial, dial_from_any_loop
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.server import ServiceServer, serving
from stampede_rt_runtime.tls import load_tls
from tests.support.channel_host.fake_directory import FakeDirectory
from tests.support.clock import ManualClock
from tests.support.processes import started

HOST_ID = b"the-loopback-hst"
LEASE_TTL_NANOS = 10**18  # all scenarios together last less than this time
STOP_SECONDS_MAX = 20.0


class LoopbackHost:
    """Clients connect to `frontend`; data travels to `target`; `tick` moves the time.

    `tls`: the certificate with which a test calls a host that has certificates.
    """

    def __init__(self, process: subprocess.Popen[str], tls: TlsFiles | None) -> None:
        self._process = process
        self.tls = tls
        self.frontend, self.target = self._answer().split()
        self.boot_nanos = ManualClock().boot_nanos
        """The host's reading of CLOCK_BOOTTIME."""

    def tick(self, nanos: int, *, wall_step: int = 0) -> int:
        """Let `nanos` pass, and set the wall clock on or back by `wall_step`. Returns the host's time afterwards."""
        time = self._ask(f"tick {nanos} {wall_step}")
        self.boot_nanos += nanos
        return time

    def settle_wall_clock(self) -> int:
        """Set the wall clock to the host's time, so that the host has no difference to make up. Returns this time."""
        return self._ask("settle")

    def _ask(self, line: str) -> int:
        assert self._process.stdin is not None
        self._process.stdin.write(line + "\n")
        self._process.stdin.flush()
        return int(self._answer())

    def _answer(self) -> str:
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "the host's process has ended"
        return line


@contextmanager
def loopback_host(certificates: ClusterCertificates | None = None) -> Iterator[LoopbackHost]:
    """A host that serves for as long as the block lasts. With `certificates`, all its ports have TLS."""
    files = [certificates.issue(role, "loopback") for role in (Role.HOST, Role.SUPERNODE)] if certificates else []
    tls = certificates.issue(Role.OPERATOR, "tests") if certificates else None
    arguments = [sys.executable, "-m", __name__, *(str(path) for one in files for path in one.paths())]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    with started(arguments, env=environment) as process:
        try:
            yield LoopbackHost(process, tls)
        finally:
            assert process.stdin is not None
            process.stdin.close()
            status = process.wait(STOP_SECONDS_MAX)
        assert status == 0, "the host failed"


class Directory(FakeDirectory):
    """A directory that also opens channels, each at the only host."""

    async def Ping(self, request: Any, context: Any) -> pb.DirectoryServicePingResponse:  # noqa: N802
        return pb.DirectoryServicePingResponse(supernode_id=self.target, ready=True, cluster_id="c")

    async def OpenChannel(self, request: pb.OpenChannelRequest, context: Any) -> pb.OpenChannelResponse:  # noqa: N802
        await self._begin("OpenChannel", context)
        found = [record for record in self.channels.values() if record.name == request.name]
        if not found and not request.create:
            await abort(context, ChannelNotFound(f"no channel is called {request.name!r}"))
        record = found[0] if found else self.add_channel(request.name, HOST_ID, request.spec)
        return pb.OpenChannelResponse(channel=record, host=self.hosts[HOST_ID])


class SteeredClockHost:
    """The host and its clock.

    Its methods run on the host's event loop, so that no code sees the clock change in between.
    """

    def __init__(self, host: ChannelHost, clock: ManualClock) -> None:
        self._host = host
        self._clock = clock

    def perform(self, line: str) -> int:
        """Perform the command of a line. Returns the host's time afterwards."""
        command, *numbers = line.split()
        if command == "settle":
            self._clock.set_wall_clock(self._host.store.now())
        else:
            nanos, wall_step = map(int, numbers)
            self._clock.set_wall_clock(self._clock.time_unix_nano() + wall_step)
            self._clock.advance(nanos)
        self._host.store.rings.refresh()
        return self._host.store.now()


async def serve(paths: Sequence[str]) -> None:
    """Serve until standard input ends. `paths`: the files of the host's and of the directory's certificates, if any."""
    files = [
        TlsFiles(ca=ca, certificate=certificate, key=key)
        for ca, certificate, key in zip(paths[::3], paths[1::3], paths[2::3], strict=True)
    ]
    own, directory_tls = (load_tls(files[0], Role.HOST), load_tls(files[1], Role.SUPERNODE)) if files else (None, None)
    reader = own.reader if own else None
    directory = Directory(lease_ttl_nanos=LEASE_TTL_NANOS)
    async with serving(directory.register, tls=directory_tls) as supernode:
        directory.target = supernode.address
        clock = ManualClock()
        server = ServiceServer(secret=None, tls=own)
        host = ChannelHost(
            HostIdentity(host_id=HOST_ID, name="loopback", boot_incarnation=1),
            frontends=[directory.target],
            dial=lambda target: dial(target, secret=None, tls=reader),
            dial_for_lease=lambda target: dial_from_any_loop(target, secret=None, tls=reader),
            clock=clock,
            memory_bytes_max=2**30,
            on_serving=lambda serving: None,
            on_defect=lambda failure: os._exit(1),
            tickets=server.sockets.tickets if own else None,
        )
        target = server.bind("localhost:0")
        host.add_to(server.grpc)
        server.sockets.register(host.add_to)
        await server.start()
        local = await server.sockets.listen_locally()
        await host.enter(target, local_target=local, tcp_target=f"tcp:{server.bind_sockets(0)}")
        print(directory.target, target, flush=True)
        await _perform_lines(SteeredClockHost(host, clock))
        await server.stop(host.leave)


async def _perform_lines(steered: SteeredClockHost) -> None:
    lines = asyncio.StreamReader()
    await asyncio.get_running_loop().connect_read_pipe(lambda: asyncio.StreamReaderProtocol(lines), sys.stdin)
    while line := await lines.readline():
        print(steered.perform(line.decode()), flush=True)


if __name__ == "__main__":
    asyncio.run(serve(sys.argv[1:]))
