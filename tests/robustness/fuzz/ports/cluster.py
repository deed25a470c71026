"""The cluster with the called ports: one host, one supernode, one front-end, and their logs."""

from __future__ import annotations

import asyncio
import resource
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt.security.tls import CLIENT_VARIABLES
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from stampede_rt_runtime.identity import Role
from tests.robustness.fuzz.ports.hostile_caller import Metadata
from tests.robustness.fuzz.ports.outcome import Finding, Outcome
from tests.robustness.processor_waits import ProcessorWaits

LEASE_LOST = "the lease has ended"
MEMORY_BUDGET = "64MiB"
NAMES = {Role.CLIENT: "fuzz", Role.HOST: "h9", Role.OPERATOR: "fuzz", Role.SUPERNODE: "s9"}
OPTIONS = [("grpc.use_local_subchannel_pool", 1), ("grpc.max_receive_message_length", -1)]


class FuzzedCluster:
    """The processes, the credentials of callers, and the findings in the logs.

    With `tls`, callers need certificates.
    """

    def __init__(self, outcome: Outcome, *, tls: bool, archive: Path) -> None:
        self.outcome = outcome
        self.processes = LocalCluster(
            hosts=1,
            supernodes=1,
            tls=tls,
            on_line=self._hear,
            on_exit=self._ended,
            log_level="warning",
            archive=archive,
        )
        self.processes.hosts[0].arguments += ["--memory-bytes-max", MEMORY_BUDGET]
        self._tls, self._stopping = tls, False
        self.leases_lost_at: list[float] = []
        self.waits = ProcessorWaits(self._pids)

    @property
    def metadata(self) -> Metadata:
        """The metadata with the caller's credential, beside its certificate."""
        return () if self._tls else (("authorization", f"Bearer {self.processes.secret.text}"),)

    def channel(self, address: str, role: Role) -> grpc.aio.Channel:
        """A new connection, with the certificate of that role if there are certificates."""
        files = self.processes.tls_files(NAMES[role], role)
        if files is None:
            return grpc.aio.insecure_channel(address, options=OPTIONS)
        ca, certificate, key = (path.read_bytes() for path in files.paths())
        return grpc.aio.secure_channel(address, grpc.ssl_channel_credentials(ca, key, certificate), options=OPTIONS)

    def connect(self) -> Any:
        """Connect as a client with all rights, because hostile operators make rules of access."""
        if self._tls:
            return st.aio.connect(self.processes.address, tls=self.processes.tls_files("good", Role.OPERATOR))
        return st.aio.connect(self.processes.address, secret=self.processes.secret.text)

    def environment(self) -> dict[str, str]:
        """For the command line."""
        files = self.processes.tls_files("good", Role.OPERATOR)
        if files is None:
            credentials = {"STAMPEDE_SECRET_FILE": str(self.processes.secret_file)}
        else:
            credentials = dict(zip(CLIENT_VARIABLES, map(str, files.paths()), strict=True))
        return {"STAMPEDE_URL": self.processes.address, **credentials}

    def stop(self) -> None:
        """Stop all processes. From here on their ends are not findings."""
        self._stopping = True
        self.processes.stop()

    @property
    def target(self) -> ServiceProcess:
        """The process behind the port."""
        one = self.processes
        return {"host": one.hosts, "supernode": one.supernodes, "frontend": one.frontends}[self.outcome.port][0]

    def memory_mib(self) -> float:
        """Resident now."""
        pages = int(Path(f"/proc/{self.target.pid}/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 2**20

    def _pids(self) -> list[int]:
        """The processes on which a lease depends."""
        return [one.pid for one in (*self.processes.hosts, *self.processes.supernodes) if one.alive]

    def _hear(self, process: ServiceProcess, line: str) -> None:
        if LEASE_LOST in line:
            self.outcome.leases_lost += 1
            self.leases_lost_at.append(time.monotonic())
        if "Traceback" in line or "level=error" in line:
            self.outcome.add(Finding(what=f"{process.name} logs: {line[:3000]}", method=line[-120:]))

    def _ended(self, process: ServiceProcess) -> None:
        if not self._stopping:
            last = "\n".join(process.last_lines[-5:])
            self.outcome.add(Finding(what=f"{process.name} ended with {process.exit_code}: {last}", method="a process"))


@asynccontextmanager
async def fuzzed_cluster(outcome: Outcome, *, tls: bool) -> AsyncIterator[FuzzedCluster]:
    """Running."""
    with TemporaryDirectory(prefix="stampede-fuzz-") as archive:
        one = FuzzedCluster(outcome, tls=tls, archive=Path(archive))
        await asyncio.to_thread(one.processes.start)
        try:
            yield one
        finally:
            await asyncio.to_thread(one.stop)
