"""A service process in its own namespace. Tests can kill, stop and limit it, and check the effects."""

from __future__ import annotations

import asyncio
import contextlib
import os
import resource
import signal
import subprocess
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from stampede_rt.security.tls import TlsFiles
from stampede_rt_local.namespaces import NetworkNamespace
from tests.support.service_process import CLOCK_FILE
from tests.support.supernode.processes import clean_environment

READY_SECONDS = 30.0
SEEN_SECONDS = 2.0


class FaultHadNoEffect(AssertionError):
    """A fault was injected, but had no visible effect. The campaign would prove nothing."""


class PlacedProcess:
    """A service whose folder and address stay while its process is started and ended. `package` names the service."""

    package = ""

    def __init__(self, name: str, namespace: NetworkNamespace, folder: Path, port: int, tls: TlsFiles | None) -> None:
        self.name, self.namespace, self.folder, self.port, self.tls = name, namespace, folder, port, tls
        self.address = f"{namespace.address}:{port}"
        self.data_dir = folder / name
        self.log_file = folder / f"{name}.log"
        self.clock_file = folder / f"{name}.clock"
        self.clock_file.write_text("0")
        self._process: asyncio.subprocess.Process | None = None
        self._launched = 0.0
        self.start_seconds = 0.0  # the time of the last start, from the launch to the ready line

    def flags(self) -> Sequence[str]:
        """The flags of the process, without those for its address and certificates."""
        raise NotImplementedError

    def listen_flags(self) -> list[str]:
        """The flags for its address."""
        if self.tls is None:
            return ["--listen", self.address, "--allow-insecure-anywhere"]
        return ["--listen", self.address, *self.tls_flags()]

    def tls_flags(self) -> list[str]:
        """The flags for its certificates, if the cluster has any."""
        if self.tls is None:
            return []
        ca, certificate, key = map(str, self.tls.paths())
        return ["--tls-ca", ca, "--tls-certificate", certificate, "--tls-key", key]

    def environment(self) -> dict[str, str]:
        """The environment variables of the process."""
        return clean_environment() | {CLOCK_FILE: str(self.clock_file)}

    async def launch(self) -> None:
        """Start the process without waiting for it."""
        module = "tests.support.service_process"
        words = [sys.executable, "-m", module, self.package, *self.flags(), "--log-level", "warning"]
        self._launched = time.monotonic()
        with self.log_file.open("ab") as log:
            self._process = await asyncio.create_subprocess_exec(
                *self.namespace.command(*words), stdout=subprocess.PIPE, stderr=log, env=self.environment()
            )

    async def start(self) -> bool:
        """Start the process, and wait until it is ready. Returns False if it ended instead."""
        await self.launch()
        return await self.wait_until_ready()

    async def wait_until_ready(self) -> bool:
        """Wait for the ready line of the process. Returns False if it ended instead."""
        assert self._process is not None
        assert self._process.stdout is not None
        async with asyncio.timeout(READY_SECONDS):
            ready = bool(await self._process.stdout.readline())
        self.start_seconds = time.monotonic() - self._launched
        return ready

    @property
    def pid(self) -> int:
        assert self._process is not None
        return self._process.pid

    @property
    def running(self) -> bool:
        return self._process is not None and self._process.returncode is None

    def signal(self, number: signal.Signals) -> None:
        """Send a signal, if the process still runs.

        This does not use Process.send_signal, which may reap the child and lose its exit code.
        """
        if self.running:
            with contextlib.suppress(ProcessLookupError):  # the process has ended, and asyncio does not know yet
                os.kill(self.pid, number)

    async def ended(self) -> int:
        """Wait for the end of the process. Returns the exit code."""
        assert self._process is not None
        return await self._process.wait()

    async def kill(self) -> None:
        """Kill the process with SIGKILL, and wait for its end. Raises FaultHadNoEffect if it had ended by itself."""
        self.signal(signal.SIGKILL)
        if self._process is not None and await self.ended() != -signal.SIGKILL:
            raise FaultHadNoEffect(f"{self.name} had ended before it was killed: {self.last_log_line()!r}")

    async def freeze(self) -> None:
        """Stop the process with SIGSTOP, and wait until the kernel shows it as stopped.

        Raises FaultHadNoEffect if the kernel never shows that.
        """
        self.signal(signal.SIGSTOP)
        deadline = time.monotonic() + SEEN_SECONDS
        while self.kernel_state() != "T":
            if time.monotonic() > deadline:
                raise FaultHadNoEffect(f"{self.name} is in state {self.kernel_state()} after SIGSTOP")
            await asyncio.sleep(0.01)

    def thaw(self) -> None:
        """Let the process go on (SIGCONT)."""
        self.signal(signal.SIGCONT)

    def kernel_state(self) -> str:
        """The state letter of the process, see proc(5)."""
        return Path(f"/proc/{self.pid}/stat").read_text().rpartition(")")[2].split()[0]

    def last_log_line(self) -> str:
        """Its last log line, without the name of its folder."""
        lines = self.log_file.read_text(errors="replace").splitlines() if self.log_file.exists() else []
        return lines[-1].replace(f"{self.data_dir}/", "") if lines else ""

    def limit_descriptors(self, spare: int | None) -> int:
        """Let the process open only `spare` more file descriptors than it has open. None: remove this limit.

        Returns the limit.
        """
        _, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        soft = hard if spare is None else self.descriptors() + spare
        resource.prlimit(self.pid, resource.RLIMIT_NOFILE, (soft, hard))
        return soft

    def descriptors(self) -> int:
        """The number of its open file descriptors."""
        return len(list(Path(f"/proc/{self.pid}/fd").iterdir()))

    def step_wall_clock(self, seconds: float) -> None:
        """Set its wall clock wrong by `seconds` from now on (see `service_process`)."""
        self.clock_file.write_text(f"{int(seconds * 1e9)}".ljust(31))

    def memory_bytes(self) -> int:
        """Its resident memory now."""
        return int(Path(f"/proc/{self.pid}/statm").read_text().split()[1]) * resource.getpagesize()

    def forget_memory_peak(self) -> None:
        """Begin a new measurement of `memory_peak_bytes` (proc(5), clear_refs)."""
        Path(f"/proc/{self.pid}/clear_refs").write_text("5")

    def memory_peak_bytes(self) -> int:
        """The greatest resident memory of the process so far."""
        status = Path(f"/proc/{self.pid}/status").read_text()
        return next(int(line.split()[1]) for line in status.splitlines() if line.startswith("VmHWM")) * 1024

    async def end(self) -> None:
        """End the process, whatever its state."""
        self.thaw()
        self.signal(signal.SIGKILL)
        if self._process is not None:
            await self.ended()

    async def close(self) -> None:
        """End the process, and remove everything that belongs to it."""
        await self.end()
