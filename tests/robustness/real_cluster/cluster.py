"""A whole cluster as processes in namespaces: supernodes that come and go, a front-end, and channel hosts."""

from __future__ import annotations

import asyncio
import contextlib
import secrets
import sys
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path

import grpc

from stampede_rt.security.tls import TlsFiles
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt_local.namespaces import NetworkNamespace
from stampede_rt_runtime.identity import Role
from tests.robustness.real_cluster.certificates import Certificates
from tests.robustness.real_cluster.network import Network
from tests.robustness.real_cluster.placed_process import READY_SECONDS, PlacedProcess
from tests.robustness.real_cluster.relay_process import RelayProcess
from tests.robustness.real_cluster.supernode import PORT, Supernode
from tests.support.supernode.processes import clean_environment

SUPERNODES, SPARE_NAMESPACES = 3, 1
FRONTEND_PORT, HOST_PORT, INNER_HOST_PORT, DATA_PORT = 7580, 7570, 7571, 7572
OPERATOR = "operator"
COMMAND_SECONDS = 40.0


class Frontend(PlacedProcess):
    """The front-end for clients of the channel hosts."""

    package = "stampede_rt_frontend"

    def __init__(
        self, namespace: NetworkNamespace, folder: Path, tls: TlsFiles | None, supernodes: Sequence[Supernode]
    ) -> None:
        super().__init__("frontend", namespace, folder, FRONTEND_PORT, tls)
        self._seeds = ",".join(one.address for one in supernodes)

    def flags(self) -> Sequence[str]:
        """The flags of the front-end, with the addresses of the first supernodes."""
        return ["--supernodes", self._seeds, *self.listen_flags()]


ARCHIVE, MEMORY = "64MiB", "64MiB"


class Host(PlacedProcess):
    """One channel host. With `relayed` all other processes reach the host through a relay, and its TCP port through
    another relay.
    """

    package = "stampede_rt_channel_host"

    def __init__(
        self, name: str, namespace: NetworkNamespace, folder: Path, tls: TlsFiles | None, frontend: Frontend,
        *, relayed: bool = False,
    ) -> None:  # fmt: skip
        super().__init__(name, namespace, folder, HOST_PORT, tls)
        self._frontend = frontend
        self.data_address = f"{namespace.address}:{DATA_PORT}"
        self.relay = RelayProcess(namespace, self.address, INNER_HOST_PORT) if relayed else None
        self.data_relay = RelayProcess(namespace, self.data_address, DATA_PORT) if relayed else None

    @property
    def relays(self) -> Sequence[RelayProcess]:
        """The relays before both ports; none if callers reach the host directly."""
        return [one for one in (self.relay, self.data_relay) if one is not None]

    def flags(self) -> Sequence[str]:
        """The flags of the host. Its name stays the same over restarts."""
        words = ["--name", self.name, "--data-dir", str(self.data_dir), "--frontend", self._frontend.address]
        archive = ["--archive", str(self.data_dir / "archive"), "--archive-bytes-max", ARCHIVE]
        return [*words, *archive, "--memory-bytes-max", MEMORY, "--data-port", str(DATA_PORT), *self._where()]

    def _where(self) -> list[str]:
        if self.relay is None:
            return self.listen_flags()
        return ["--listen", f"localhost:{INNER_HOST_PORT}", "--advertise", self.address, *self.tls_flags()]

    async def start(self) -> bool:
        """Start the host, and its relays if it has some."""
        for relay in self.relays:
            await relay.start()
        return await super().start()

    async def close(self) -> None:
        """End the process and its relays."""
        await super().close()
        for relay in self.relays:
            await relay.close()


class Cluster:
    """All processes, on a network. `supernodes` are the members that the cluster should have at this moment."""

    def __init__(
        self, network: Network, folder: Path, *, relayed: bool, secured: bool, hosts: int, compacts_early: bool,
        relayed_hosts: bool = False,
    ) -> None:  # fmt: skip
        self.network, self.folder, self._compacts_early = network, folder, compacts_early
        folder.mkdir(parents=True, exist_ok=True)
        self.certificates = Certificates(folder / "certificates") if secured else None
        self._spare = network.namespaces[SUPERNODES : SUPERNODES + SPARE_NAMESPACES]
        namespaces = network.namespaces[:SUPERNODES]
        members = ",".join(f"s{number}={namespace.address}:{PORT}" for number, namespace in enumerate(namespaces, 1))
        self.supernodes = [
            self._supernode(f"s{number}", namespace, members, relayed) for number, namespace in enumerate(namespaces, 1)
        ]
        self.supernodes[-1].mount_small_disk()
        self._made = SUPERNODES
        self._former: list[Supernode] = []
        self.frontend: Frontend | None = None
        self.hosts: list[Host] = []
        if hosts:
            front, *others = network.namespaces[SUPERNODES + SPARE_NAMESPACES :]
            self.frontend = Frontend(front, folder, self._files(Role.FRONTEND, "frontend", front), self.supernodes)
            self.hosts = [
                self._host(f"h{number}", namespace, relayed_hosts) for number, namespace in enumerate(others, 1)
            ]

    def _files(self, role: Role, name: str, namespace: NetworkNamespace | None = None) -> TlsFiles | None:
        if self.certificates is None:
            return None
        return self.certificates.files(role, name, *([namespace.address] if namespace is not None else []))

    def caller_files(self, role: Role, name: str) -> TlsFiles | None:
        """The certificate of a caller; None in a cluster without certificates."""
        return self._files(role, name)

    def _supernode(self, name: str, namespace: NetworkNamespace, members: str, relayed: bool = False) -> Supernode:
        tls = self._files(Role.SUPERNODE, name, namespace)
        callers = self.caller_files
        early = self._compacts_early
        return Supernode(
            name,
            namespace,
            self.folder,
            members=members,
            tls=tls,
            callers=callers,
            relayed=relayed,
            compacts_early=early,
        )

    def _host(self, name: str, namespace: NetworkNamespace, relayed: bool) -> Host:
        assert self.frontend is not None
        tls = self._files(Role.HOST, name, namespace)
        return Host(name, namespace, self.folder, tls, self.frontend, relayed=relayed)

    @property
    def outside(self) -> NetworkNamespace:
        """A namespace without a service, unless a supernode is about to join."""
        return self._spare[-1]

    def newcomer(self) -> Supernode:
        """Prepare a supernode with an unused id in the free namespace. It has not joined yet, and does not run."""
        self._made += 1
        made = self._supernode(f"s{self._made}", self._spare.pop(), "")
        made.mount_small_disk()
        return made

    async def forget(self, one: Supernode) -> None:
        """Note that the supernode is no longer a member. Its namespace is free for the next newcomer."""
        self.supernodes = [other for other in self.supernodes if other is not one]
        self._former.append(one)  # some callers do not know of the removal yet
        await one.close()
        self._spare.append(one.namespace)

    async def command(self, *words: str, seconds: float = COMMAND_SECONDS) -> tuple[int, str]:
        """Run `stampede supernode WORDS` as the operator. Returns the exit code and the output. Raises TimeoutError."""
        environment = clean_environment()
        if (files := self._files(Role.OPERATOR, OPERATOR)) is not None:
            names = ("STAMPEDE_TLS_CA", "STAMPEDE_TLS_CERTIFICATE", "STAMPEDE_TLS_KEY")
            environment |= dict(zip(names, map(str, files.paths()), strict=True))
        running = await asyncio.create_subprocess_exec(
            *(sys.executable, "-m", "stampede_rt.cli", "supernode", *words),
            stdout=asyncio.subprocess.PIPE,
            stderr=asyncio.subprocess.STDOUT,
            env=environment,
        )
        try:
            async with asyncio.timeout(seconds):
                printed, _ = await running.communicate()
        finally:
            if running.returncode is None:
                running.kill()
        return running.returncode or 0, printed.decode()

    def processes(self) -> list[PlacedProcess]:
        """All services that should run."""
        return [*self.supernodes, *([self.frontend] if self.frontend is not None else []), *self.hosts]

    def others(self, one: Supernode) -> list[Supernode]:
        """The other members."""
        return [other for other in self.supernodes if other is not one]

    async def leader(self, seconds: float = READY_SECONDS) -> Supernode:
        """The supernode that calls itself the leader, as soon as there is one. Raises TimeoutError."""
        deadline = time.monotonic() + seconds
        while time.monotonic() < deadline:
            for one in self.supernodes:
                try:
                    leader, _ = await one.leader_and_applied_index()
                except grpc.aio.AioRpcError:
                    continue
                if leader == one.name:
                    return one
            await asyncio.sleep(0.05)
        raise TimeoutError(f"no supernode led within {seconds} s")

    async def all_serve(self, seconds: float = READY_SECONDS) -> float:
        """Wait until every supernode answers a confirmed read, and every host that was started holds a lease.

        Returns how long that took. Raises TimeoutError.
        """
        began = time.monotonic()
        for one in list(self.supernodes):
            await serves(one, began + seconds)
        await self._hosts_alive(began + seconds)
        return time.monotonic() - began

    async def _hosts_alive(self, deadline: float) -> None:
        missing = {host.name for host in self.hosts if host.running}
        while missing and time.monotonic() < deadline:
            with contextlib.suppress(grpc.aio.AioRpcError):
                listed = await self.supernodes[0].stub.ListHosts(pb.ListHostsRequest(), timeout=1)
                missing -= {host.name for host in listed.hosts}
            await asyncio.sleep(0.05)
        if missing:
            raise TimeoutError(f"no lease for {', '.join(sorted(missing))}")

    async def start(self) -> None:
        """Start everything, and wait until it serves."""
        await _started(self.supernodes)
        await self.all_serve()
        if self.frontend is not None:
            await _started([self.frontend])
            await _started(self.hosts)

    async def close(self) -> None:
        """End all processes."""
        await asyncio.gather(*(one.close_connections() for one in [*self.supernodes, *self._former]))
        await asyncio.gather(*(one.close() for one in self.processes()))


async def _started(several: Sequence[PlacedProcess]) -> None:
    """Wait until all processes are ready. Raises OSError with the last log line of a process that ended instead."""
    for one, ready in zip(several, await asyncio.gather(*(one.start() for one in several)), strict=True):
        if not ready:
            raise OSError(f"{one.name} did not start: {one.last_log_line()!r}")


async def serves(one: Supernode, deadline: float) -> None:
    """Wait until the supernode answers a confirmed read. Raises TimeoutError with its last log line."""
    while time.monotonic() < deadline:
        try:
            await one.stub.ListHosts(pb.ListHostsRequest(page_size=1), timeout=1)
            return
        except grpc.aio.AioRpcError:
            await asyncio.sleep(0.05)
    raise TimeoutError(f"{one.name} does not serve; its last log line: {one.last_log_line()!r}")


@asynccontextmanager
async def running_cluster(
    folder: Path, *, relayed: bool = False, secured: bool = False, hosts: int = 0, compacts_early: bool = True,
    relayed_hosts: bool = False,
) -> AsyncIterator[Cluster]:  # fmt: skip
    """Yield a cluster that serves, and remove it afterwards, except its folder."""
    with Network(SUPERNODES + SPARE_NAMESPACES + (hosts + 1 if hosts else 0)) as network:
        cluster = Cluster(
            network, folder, relayed=relayed, secured=secured, hosts=hosts, compacts_early=compacts_early,
            relayed_hosts=relayed_hosts,
        )  # fmt: skip
        try:
            await cluster.start()
            yield cluster
        finally:
            await cluster.close()


def request_id() -> bytes:
    """A random id for a request. A repetition of the request has the same id."""
    return secrets.token_bytes(16)
