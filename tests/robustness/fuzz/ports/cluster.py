"""The cluster whose ports the fuzzer calls: one host, one supernode, one front-end, and their logs."""

from __future__ import annotations

import asyncio
import resource
import time
from collections.abc import AsyncIterator, Sequence
from contextlib import asynccontextmanager
from pathlib import Path
from tempfile import TemporaryDirectory
from typing import Any

import grpc

import stampede_rt as st
from stampede_rt.security.tls import CLIENT_VARIABLES, TlsReader
from stampede_rt.security.tls_contexts import client_context
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.values import parse_address
from tests.robustness.fuzz.ports.hostile_caller import Metadata
from tests.robustness.fuzz.ports.methods import DATA_PORT
from tests.robustness.fuzz.ports.outcome import Finding, Outcome
from tests.robustness.fuzz.ports.socket_calls import SocketPort
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
            on_line=self._read_log_line,
            on_exit=self._ended,
            log_level="warning",
            archive=archive,
            data_ports=True,
        )
        self.processes.hosts[0].arguments += ["--memory-bytes-max", MEMORY_BUDGET]
        self._tls, self._stopping = tls, False
        self.leases_lost_at: list[float] = []
        self.waits = ProcessorWaits(self._pids)

    @property
    def metadata(self) -> Metadata:
        """The metadata with the secret. Empty if callers have certificates instead."""
        return () if self._tls else (("authorization", f"Bearer {self.processes.secret.text}"),)

    def channel(self, address: str, role: Role) -> grpc.aio.Channel:
        """A new connection, with the certificate of that role if there are certificates."""
        files = self.processes.tls_files(NAMES[role], role)
        if files is None:
            return grpc.aio.insecure_channel(address, options=OPTIONS)
        ca, certificate, key = (path.read_bytes() for path in files.paths())
        return grpc.aio.secure_channel(address, grpc.ssl_channel_credentials(ca, key, certificate), options=OPTIONS)

    def socket(self, targets: Sequence[str], role: Role) -> SocketPort | None:
        """The host's socket for callers of that role; None: they use only gRPC."""
        unix, tcp = (next((one for one in targets if one.startswith(kind)), "") for kind in ("unix:", "tcp:"))
        if self.outcome.port == DATA_PORT:
            host, files = parse_address(self.target.address).host, self.processes.tls_files(NAMES[role], role)
            tls = None if files is None else client_context(TlsReader(files).current())
            return SocketPort(f"tcp:{host}:{tcp.removeprefix('tcp:')}", tls)
        return SocketPort(unix, percent=50) if unix and not self._tls else None

    def connect(self) -> Any:
        """Connect as a client with all rights, because hostile operators make rules of access."""
        transport = "tcp" if self.outcome.port == DATA_PORT else "best"
        address, files = self.processes.address, self.processes.tls_files("good", Role.OPERATOR)
        if files is not None:
            return st.aio.connect(address, tls=files, transport=transport)
        return st.aio.connect(address, secret=self.processes.secret.text, transport=transport)

    def environment(self) -> dict[str, str]:
        """The environment variables for the command line."""
        files = self.processes.tls_files("good", Role.OPERATOR)
        if files is None:
            credentials = {"STAMPEDE_SECRET_FILE": str(self.processes.secret_file)}
        else:
            credentials = dict(zip(CLIENT_VARIABLES, map(str, files.paths()), strict=True))
        return {"STAMPEDE_URL": self.processes.address, **credentials}

    def stop(self) -> None:
        """Stop all processes. After this call the end of a process is no finding."""
        self._stopping = True
        self.processes.stop()

    @property
    def target(self) -> ServiceProcess:
        """The process whose port the fuzzer calls."""
        one = self.processes
        parts = {"supernode": one.supernodes, "frontend": one.frontends}
        return parts.get(self.outcome.port, one.hosts)[0]

    def memory_mib(self) -> float:
        """The resident memory of the process now, in MiB."""
        pages = int(Path(f"/proc/{self.target.pid}/statm").read_text().split()[1])
        return pages * resource.getpagesize() / 2**20

    def _pids(self) -> list[int]:
        """The ids of the processes that renew a lease or grant it."""
        return [one.pid for one in (*self.processes.hosts, *self.processes.supernodes) if one.alive]

    def _read_log_line(self, process: ServiceProcess, line: str) -> None:
        if not process.is_ready:  # during the start, services log errors about each other
            return
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
    """Yield a running cluster."""
    with TemporaryDirectory(prefix="stampede-fuzz-") as archive:
        one = FuzzedCluster(outcome, tls=tls, archive=Path(archive))
        await asyncio.to_thread(one.processes.start)
        try:
            yield one
        finally:
            await asyncio.to_thread(one.stop)
