"""Supernodes as processes in namespaces of their own, and everything that can be done to one."""

from __future__ import annotations

import asyncio
import resource
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from typing import Any

import grpc

from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1 import directory_service_pb2_grpc
from stampede_rt_runtime.dial import dial
from tests.robustness.network import Network, Place
from tests.robustness.supernode_process import CLOCK_FILE, SNAPSHOT_EVERY
from tests.unit.supernode.processes import clean_environment

PORT, INNER_PORT = 7590, 7591
READY_SECONDS = 30.0
SNAPSHOT_ENTRIES = 400
LEASE_TTL_SECONDS = 2


class Supernode:
    """One supernode: its place, folder and address stay; the process comes and goes."""

    def __init__(self, name: str, place: Place, members: str, folder: Path, *, relayed: bool) -> None:
        self.name, self.place, self.folder = name, place, folder
        self.address = f"{place.address}:{PORT}"
        self.data_dir = folder / name
        self.data_dir.mkdir(parents=True, exist_ok=True)
        self.clock_file = folder / f"{name}.clock"
        self.clock_file.write_text("0")
        self.log_file = folder / f"{name}.log"
        self._relayed = relayed
        self._members = members
        self._process: asyncio.subprocess.Process | None = None
        self._relay: asyncio.subprocess.Process | None = None
        self.channel = dial(self.address, secret=None)
        self.stub: Any = directory_service_pb2_grpc.DirectoryServiceStub(self.channel)

    def _command(self) -> list[str]:
        listen = [f"localhost:{INNER_PORT}"] if self._relayed else [self.address, "--allow-insecure-anywhere"]
        flags = ["--id", self.name, "--members", self._members, "--data-dir", str(self.data_dir)]
        flags += ["--lease-ttl", f"{LEASE_TTL_SECONDS}s", "--log-level", "warning", "--listen", *listen]
        return self.place.command(sys.executable, "-m", "tests.robustness.supernode_process", *flags)

    async def launch(self) -> None:
        """Start the process and do not wait for it."""
        environment = clean_environment() | {CLOCK_FILE: str(self.clock_file), SNAPSHOT_EVERY: str(SNAPSHOT_ENTRIES)}
        with self.log_file.open("ab") as log:
            self._process = await asyncio.create_subprocess_exec(
                *self._command(), stdout=subprocess.PIPE, stderr=log, env=environment
            )

    async def start(self) -> bool:
        """Start it and wait until it says that it is ready; False if it ended instead."""
        if self._relayed and self._relay is None:
            await self._start_relay()
        await self.launch()
        return await self.said_ready()

    async def said_ready(self) -> bool:
        """Wait for the ready line of a launched process; False if it ended instead."""
        assert self._process is not None
        assert self._process.stdout is not None
        async with asyncio.timeout(READY_SECONDS):
            return bool(await self._process.stdout.readline())

    async def _start_relay(self) -> None:
        command = [sys.executable, "-m", "tests.robustness.relay", self.address, f"localhost:{INNER_PORT}"]
        self._relay = await asyncio.create_subprocess_exec(
            *self.place.command(*command), stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        assert self._relay.stdout is not None
        await self._relay.stdout.readline()

    def set_weather(self, *figures: float) -> None:
        """What the relay before it does from now on, see `relay`."""
        assert self._relay is not None
        assert self._relay.stdin is not None
        self._relay.stdin.write((" ".join(map(str, figures)) + "\n").encode())

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    @property
    def running(self) -> bool:
        return self._process is not None and self._process.returncode is None

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal, if it still runs."""
        if self.running:
            assert self._process is not None
            self._process.send_signal(number)

    async def ended(self) -> int:
        """Wait for its end; returns the exit code."""
        assert self._process is not None
        return await self._process.wait()

    async def kill(self) -> None:
        """kill -9, and wait until it is gone."""
        self.signal(signal.SIGKILL)
        if self._process is not None:
            await self._process.wait()

    def last_words(self) -> str:
        """The last line that it logged, without the name of its folder."""
        lines = self.log_file.read_text(errors="replace").splitlines() if self.log_file.exists() else []
        return lines[-1].replace(f"{self.data_dir}/", "") if lines else ""

    def limit_descriptors(self, spare: int | None) -> None:
        """Leave it `spare` file descriptors more than it has open; None: as many as this process may have."""
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        opened = len(list(Path(f"/proc/{self.pid}/fd").iterdir()))
        soft = hard if spare is None else opened + spare
        resource.prlimit(self.pid, resource.RLIMIT_NOFILE, (soft, hard))

    def step_wall_clock(self, seconds: float) -> None:
        """Its wall clock is off by so much from now on."""
        draft = self.clock_file.with_suffix(".next")
        draft.write_text(f"{int(seconds * 1e9)}".ljust(31))
        self.clock_file.write_text(draft.read_text())

    async def members_seen(self) -> tuple[str | None, int]:
        """Whom it takes for the leader, and how far it has applied. Raises AioRpcError."""
        listed = await self.stub.ListSupernodes(pb.ListSupernodesRequest(), timeout=1)
        leaders = [one.supernode_id for one in listed.supernodes if one.is_leader]
        return (leaders[0] if leaders else None), listed.applied_index

    async def close(self) -> None:
        await self.channel.close()
        self.signal(signal.SIGCONT)
        await self.kill()
        if self._relay is not None and self._relay.returncode is None:
            self._relay.kill()
            await self._relay.wait()


class Cluster:
    """All supernodes, on a network."""

    def __init__(self, network: Network, folder: Path, *, relayed: bool) -> None:
        self.network = network
        names = [f"s{number}" for number in range(1, len(network.places) + 1)]
        members = ",".join(f"{name}={place.address}:{PORT}" for name, place in zip(names, network.places, strict=True))
        self.supernodes = [
            Supernode(name, place, members, folder, relayed=relayed)
            for name, place in zip(names, network.places, strict=True)
        ]

    def named(self, name: str) -> Supernode:
        return next(one for one in self.supernodes if one.name == name)

    def others(self, one: Supernode) -> list[Supernode]:
        return [other for other in self.supernodes if other is not one]

    async def leader(self, seconds: float = READY_SECONDS) -> Supernode:
        """The one that takes itself for the leader, as soon as there is one."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            for one in self.supernodes:
                try:
                    leader, _ = await one.members_seen()
                except grpc.aio.AioRpcError:
                    continue
                if leader == one.name:
                    return one
            await asyncio.sleep(0.05)
        raise TimeoutError(f"no supernode led within {seconds} s")

    async def all_serve(self, seconds: float = READY_SECONDS) -> float:
        """Wait until every supernode answers a confirmed read; returns how long that took."""
        began = time.monotonic()
        for one in self.supernodes:
            await _serves(one, began + seconds)
        return time.monotonic() - began

    async def close(self) -> None:
        await asyncio.gather(*(one.close() for one in self.supernodes))


async def _serves(one: Supernode, deadline: float) -> None:
    while time.monotonic() < deadline:
        try:
            await one.stub.ListHosts(pb.ListHostsRequest(page_size=1), timeout=1)
            return
        except grpc.aio.AioRpcError:
            await asyncio.sleep(0.05)
    raise TimeoutError(f"{one.name} does not serve; its last words: {one.last_words()!r}")


@asynccontextmanager
async def running_cluster(folder: Path, *, size: int = 3, relayed: bool = False) -> AsyncIterator[Cluster]:
    """A cluster that serves, gone without a trace afterwards; its folder stays."""
    with Network(size) as network:
        cluster = Cluster(network, folder, relayed=relayed)
        try:
            await asyncio.gather(*(one.start() for one in cluster.supernodes))
            await cluster.all_serve()
            yield cluster
        finally:
            await cluster.close()


def request_id() -> bytes:
    """Names a request; repeated with it."""
    return secrets.token_bytes(16)
