"""One supernode under test. A test can fill its disk, and call it in any role and under any name."""

from __future__ import annotations

import shutil
import sqlite3
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path
from typing import Any

import grpc

from stampede_rt.security.tls import TlsFiles, TlsReader
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1 import directory_service_pb2_grpc
from stampede_rt_local.namespaces import NetworkNamespace
from stampede_rt_runtime.dial import dial
from stampede_rt_runtime.identity import Role
from stampede_rt_supernode.replication.storage.sqlite_store import DATABASE_NAME
from tests.robustness.real_cluster.placed_process import PlacedProcess
from tests.robustness.real_cluster.relay_process import RelayProcess
from tests.support.service_process import SNAPSHOT_EVERY

PORT, INNER_PORT = 7590, 7591
SNAPSHOT_ENTRIES = 400
LEASE_TTL_SECONDS = 2
SMALL_DISK = "size=48m"

CallerFiles = Callable[[Role, str], TlsFiles | None]


class Supernode(PlacedProcess):
    """One supernode. `members`: the founders, if it is one of them; empty if it joins.

    `callers`: the certificates of its callers.
    """

    package = "stampede_rt_supernode"

    def __init__(
        self,
        name: str,
        namespace: NetworkNamespace,
        folder: Path,
        *,
        members: str,
        tls: TlsFiles | None,
        callers: CallerFiles,
        relayed: bool = False,
        compacts_early: bool = True,
    ) -> None:
        super().__init__(name, namespace, folder, PORT, tls)
        self._members, self._callers = members, callers
        self._compacts_early = compacts_early
        self.relay = RelayProcess(self.namespace, self.address, INNER_PORT) if relayed else None
        self._channels: dict[tuple[Role, str], grpc.aio.Channel] = {}
        self._stubs: dict[tuple[Role, str], Any] = {}
        self.has_small_disk = False

    def flags(self) -> Sequence[str]:
        """The flags of a founder, or of a joined supernode, which finds the other settings in its folder."""
        founding = ["--id", self.name, "--members", self._members] if self._members else []
        listen = (
            ["--listen", f"localhost:{INNER_PORT}", *self.tls_flags()]
            if self.relay is not None
            else self.listen_flags()
        )
        return [*founding, "--data-dir", str(self.data_dir), "--lease-ttl", f"{LEASE_TTL_SECONDS}s", *listen]

    def environment(self) -> dict[str, str]:
        """The environment: compaction after few entries, or as in production."""
        early = {SNAPSHOT_EVERY: str(SNAPSHOT_ENTRIES)} if self._compacts_early else {}
        return super().environment() | early

    async def start(self) -> bool:
        """Start the supernode, and its relay if it has one."""
        if self.relay is not None:
            await self.relay.start()
        return await super().start()

    def channel(self, role: Role = Role.CLIENT, name: str = "caller") -> grpc.aio.Channel:
        """The connection of the caller with this role and name. This object keeps the connection."""
        if (role, name) not in self._channels:
            files = self._callers(role, name)
            reader = None if files is None else TlsReader(files)
            self._channels[role, name] = dial(self.address, secret=None, tls=reader)
        return self._channels[role, name]

    def stub_for(self, role: Role, name: str) -> Any:
        """The stub of the directory's service for the caller with this role and name."""
        if (role, name) not in self._stubs:
            self._stubs[role, name] = directory_service_pb2_grpc.DirectoryServiceStub(self.channel(role, name))
        return self._stubs[role, name]

    @property
    def stub(self) -> Any:
        """The stub of the directory's service for a client."""
        return self.stub_for(Role.CLIENT, "caller")

    async def leader_and_applied_index(self) -> tuple[str | None, int]:
        """The leader that this supernode knows, and the index up to which it has applied. Raises AioRpcError."""
        listed = await self.stub.ListSupernodes(pb.ListSupernodesRequest(), timeout=1)
        leaders = [one.supernode_id for one in listed.supernodes if one.is_leader]
        return (leaders[0] if leaders else None), listed.applied_index

    async def wall_clock_nanos(self) -> int:
        """The time that this supernode reports."""
        return int((await self.stub.Ping(pb.DirectoryServicePingRequest(), timeout=5)).time_unix_nano)

    def mount_small_disk(self) -> None:
        """Give the supernode a file system of its own, small enough to be filled. Call this before its first start."""
        self.data_dir.mkdir(parents=True, exist_ok=True)
        subprocess.run(["mount", "-t", "tmpfs", "-o", SMALL_DISK, "robustness", str(self.data_dir)], check=True)
        self.has_small_disk = True

    def first_index_kept(self) -> int:
        """The first index that the supernode's log still has. Earlier entries are in the snapshot only.

        Reads a copy of the store, because the running process has locked the store.
        """
        with tempfile.TemporaryDirectory(dir=self.folder) as copy:
            for file in self.data_dir.glob(f"{DATABASE_NAME}*"):
                shutil.copy(file, copy)
            with closing(sqlite3.connect(Path(copy, DATABASE_NAME))) as store:
                return int(store.execute("SELECT min(log_index) FROM entry").fetchone()[0])

    async def close_connections(self) -> None:
        """Close the callers' connections. Calls under way are cancelled."""
        for channel in self._channels.values():
            await channel.close()

    async def close(self) -> None:
        """End the process, and remove its disk."""
        await self.end()
        if self.relay is not None:
            await self.relay.close()
        self._unmount()

    def _unmount(self) -> None:
        if self.has_small_disk:
            self.has_small_disk = False
            subprocess.run(["umount", "--lazy", str(self.data_dir)], check=True)
