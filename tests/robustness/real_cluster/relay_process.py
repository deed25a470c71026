"""The relay before one service, which simulates a bad network (see `relay`)."""

from __future__ import annotations

import asyncio
import subprocess
import sys

from stampede_rt_local.namespaces import NetworkNamespace


class RelayProcess:
    """Relays `address` of the namespace to a port of its loopback interface."""

    def __init__(self, namespace: NetworkNamespace, address: str, inner_port: int) -> None:
        self._command = [
            sys.executable,
            "-m",
            "tests.robustness.real_cluster.relay",
            address,
            f"localhost:{inner_port}",
        ]
        self._namespace = namespace
        self._process: asyncio.subprocess.Process | None = None

    async def start(self) -> None:
        """Start the relay, and wait until it listens. Idempotent."""
        if self._process is not None:
            return
        self._process = await asyncio.create_subprocess_exec(
            *self._namespace.command(*self._command), stdin=subprocess.PIPE, stdout=subprocess.PIPE
        )
        assert self._process.stdout is not None
        await self._process.stdout.readline()

    async def set_conditions(self, *figures: float) -> list[int]:
        """Set the conditions of the link. Returns the counts of the former conditions (see `relay`)."""
        assert self._process is not None
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        self._process.stdin.write((" ".join(map(str, figures)) + "\n").encode())
        return [int(word) for word in (await self._process.stdout.readline()).split()]

    async def close(self) -> None:
        """End the relay."""
        if self._process is not None and self._process.returncode is None:
            self._process.kill()
            await self._process.wait()
