"""Supernodes as processes, as a shell would start them."""

from __future__ import annotations

import asyncio
import contextlib
import os
import secrets
import signal
import sys
import time
from collections.abc import AsyncIterator, Awaitable
from pathlib import Path
from typing import Any, TypeVar

import grpc

from stampede_rt.cluster.cluster_ids import cluster_metadata
from stampede_rt.errors import LeaseExpired, StampedeError
from stampede_rt.status import from_rpc_error
from stampede_rt.v1 import directory_pb2, directory_service_pb2_grpc
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_local import ports
from stampede_rt_runtime.dial import dial

PATIENCE_SECONDS = 45.0

T = TypeVar("T")


class Supernode:
    """One process, and a stub for its calls, which also works after a restart."""

    def __init__(self, name: str, address: str, arguments: list[str]) -> None:
        self.name = name
        self.address = address
        self._arguments = arguments
        # The module that the process runs; another release has another module.
        self.module = "stampede_rt_supernode"
        self._process: asyncio.subprocess.Process | None = None
        self.channel = dial(address, secret=None)
        self.stub: Any = directory_service_pb2_grpc.DirectoryServiceStub(self.channel)

    @property
    def command(self) -> list[str]:
        """The command that starts the process."""
        return [sys.executable, "-m", self.module, "--log-level", "warning", *self._arguments]

    async def start(self) -> str:
        """Start the process, wait until it says that it is ready, and return that line."""
        self._process = await asyncio.create_subprocess_exec(
            *self.command,
            stdout=asyncio.subprocess.PIPE,
            env=clean_environment(),
        )
        assert self._process.stdout is not None
        async with asyncio.timeout(PATIENCE_SECONDS):
            line = await self._process.stdout.readline()
        assert line, f"{self.name} ended before it was ready"
        return line.decode().rstrip("\n")

    async def refused(self) -> tuple[int, str]:
        """Start the process, and wait until it ends by itself. Returns its exit status and its standard error."""
        process = await asyncio.create_subprocess_exec(
            *self.command, stdout=asyncio.subprocess.DEVNULL, stderr=asyncio.subprocess.PIPE, env=clean_environment()
        )
        try:
            async with asyncio.timeout(PATIENCE_SECONDS):
                _, output = await process.communicate()
        finally:
            if process.returncode is None:
                process.kill()
        assert process.returncode is not None
        return process.returncode, output.decode()

    async def end(self, number: signal.Signals) -> tuple[int, bytes]:
        """Send the process a signal, and wait for its end.

        Returns its exit status, and its output since the ready line.
        """
        assert self._process is not None
        self._process.send_signal(number)
        async with asyncio.timeout(PATIENCE_SECONDS):
            rest, _ = await self._process.communicate()
        code = self._process.returncode
        assert code is not None
        self._process = None
        return code, rest

    def cpu_seconds(self) -> float:
        """Return the CPU time of the process since its start (proc_pid_stat(5): utime and stime)."""
        assert self._process is not None
        fields = Path(f"/proc/{self._process.pid}/stat").read_text().rpartition(")")[2].split()
        return (int(fields[11]) + int(fields[12])) / os.sysconf("SC_CLK_TCK")

    async def ended(self) -> int:
        """Wait until the process ends by itself. Returns its exit code."""
        assert self._process is not None
        async with asyncio.timeout(PATIENCE_SECONDS):
            code = await self._process.wait()
        self._process = None
        return code

    def freeze(self) -> None:
        """Stop the process until `thaw`."""
        assert self._process is not None
        self._process.send_signal(signal.SIGSTOP)

    def thaw(self) -> None:
        assert self._process is not None
        self._process.send_signal(signal.SIGCONT)

    async def close(self) -> None:
        await self.channel.close()
        if self._process is not None and self._process.returncode is None:
            await self.end(signal.SIGKILL)


class Cluster:
    """Three supernodes with data folders."""

    def __init__(self, folder: Path, *settings: str) -> None:
        ports = free_ports(3)
        addresses = {f"s{number}": f"127.0.0.1:{port}" for number, port in enumerate(ports, start=1)}
        members = ",".join(f"{name}={address}" for name, address in addresses.items())
        self.supernodes = [
            Supernode(
                name,
                address,
                ["--listen", address, "--id", name, "--members", members, "--data-dir", str(folder / name), *settings],
            )
            for name, address in addresses.items()
        ]

    async def start(self) -> None:
        await asyncio.gather(*(one.start() for one in self.supernodes))

    async def leader(self) -> Supernode:
        """Return the leader, as soon as there is one."""
        async for _ in attempts():
            for one in self.supernodes:
                with contextlib.suppress(grpc.aio.AioRpcError):
                    listed = await one.stub.ListSupernodes(pb.ListSupernodesRequest(), timeout=1)
                    leads = {record.supernode_id: record.is_leader for record in listed.supernodes}
                    if leads[one.name]:
                        return one
        raise AssertionError("unreachable")

    def others(self, one: Supernode) -> list[Supernode]:
        return [other for other in self.supernodes if other is not one]

    async def close(self) -> None:
        for one in self.supernodes:
            await one.close()


@contextlib.asynccontextmanager
async def running_cluster(folder: Path, *settings: str) -> AsyncIterator[Cluster]:
    cluster = Cluster(folder, *settings)
    try:
        await cluster.start()
        yield cluster
    finally:
        await cluster.close()


def clean_environment() -> dict[str, str]:
    """Return this process's environment, without the settings and secrets of the user who runs the tests."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith("STAMPEDE_")}
    return {**kept, "XDG_CONFIG_HOME": "/nonexistent"}


def free_ports(count: int) -> list[int]:
    return ports.free_ports(count, "127.0.0.1")


async def attempts() -> AsyncIterator[None]:
    """Yield attempts with a short pause between them. Fails the test after a limited time."""
    deadline = time.monotonic() + PATIENCE_SECONDS
    while time.monotonic() < deadline:
        yield
        await asyncio.sleep(0.02)
    raise AssertionError(f"the awaited event did not happen within {PATIENCE_SECONDS} s")


async def register(supernode: Supernode, number: int, *, cluster_id: str = "") -> pb.RegisterHostResponse:
    request = pb.RegisterHostRequest(
        request_id=secrets.token_bytes(16),
        host_id=number.to_bytes(16, "big"),
        name=f"host-{number}",
        gatekeepers=[directory_pb2.Endpoint(target=f"localhost:{7000 + number}")],
        boot_incarnation=1,
    )
    metadata = cluster_metadata(cluster_id)
    answer: pb.RegisterHostResponse = await called(
        supernode.stub.RegisterHost(request, timeout=PATIENCE_SECONDS, wait_for_ready=True, metadata=metadata),
        supernode,
    )
    return answer


async def open_channel(supernode: Supernode, name: str) -> pb.OpenChannelResponse:
    request = pb.OpenChannelRequest(request_id=secrets.token_bytes(16), name=name, create=True)
    answer: pb.OpenChannelResponse = await called(
        supernode.stub.OpenChannel(request, timeout=PATIENCE_SECONDS, wait_for_ready=True), supernode
    )
    return answer


async def resolve(supernode: Supernode, name: str) -> pb.ResolveChannelResponse:
    request = pb.ResolveChannelRequest(name=name)
    answer: pb.ResolveChannelResponse = await called(
        supernode.stub.ResolveChannel(request, timeout=PATIENCE_SECONDS, wait_for_ready=True), supernode
    )
    return answer


async def renew(supernode: Supernode, number: int) -> bool:
    """Return whether that supernode renewed the lease. Raises LeaseExpired if the lease has ended."""
    request = pb.RenewHostLeaseRequest(host_id=number.to_bytes(16, "big"), boot_incarnation=1)
    try:
        await called(supernode.stub.RenewHostLease(request, timeout=1), supernode)
    except LeaseExpired:
        raise
    except StampedeError:
        return False
    return True


async def called(pending: Awaitable[T], supernode: Supernode) -> T:
    """Return the answer. Raises the StampedeError of the call."""
    try:
        return await pending
    except grpc.aio.AioRpcError as error:
        raise from_rpc_error(error, supernode.name) from error
