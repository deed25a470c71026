"""The channel host as a process: `stampede host`."""

from __future__ import annotations

import asyncio
import sys
from collections.abc import Sequence
from functools import partial

from stampede_rt_channel_host.cluster.identity import default_name
from stampede_rt_channel_host.process_arguments import process_arguments
from stampede_rt_channel_host.served_host import ServedHost
from stampede_rt_channel_host.settings import HostSettings
from stampede_rt_channel_host.supervisor import Supervisor
from stampede_rt_runtime.garbage import GarbageCollection
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.main import EXIT_FAILED, announce, run_service
from stampede_rt_runtime.metrics.serving import serving_metrics


class _Service:
    """One host process, from start to end."""

    def __init__(self, settings: HostSettings) -> None:
        self._settings = settings
        self._served = ServedHost(settings, settings.load_credentials(Role.HOST), self._end)
        self._failed = False

    async def run(self) -> int:
        """Serve until a stop signal. Returns the exit code. Raises the error that keeps the host from starting."""
        settings, served = self._settings, self._served
        await served.listen()
        sources = served.host.metrics(settings.metrics_names).collect
        async with serving_metrics(settings.metrics_address(), "host", served.server, sources):
            return await self._run()

    async def _run(self) -> int:
        """Enter the cluster, and serve until a stop signal. Returns the exit code."""
        served, server, host = self._served, self._served.server, self._served.host
        seconds = self._settings.drain_seconds
        before = partial(host.give_away, seconds) if seconds else None
        running = asyncio.create_task(server.run(host.leave, before))  # from here on the server handles stop signals
        entering = asyncio.create_task(host.enter(served.advertise, local_target=served.local, tcp_target=served.tcp))
        await asyncio.wait({running, entering}, return_when=asyncio.FIRST_COMPLETED)
        failure: BaseException | None = None
        if not server.stopping.is_set():
            failure = entering.exception()
            if failure is None:
                announce(f"stampede host {host.identity.name} ready on {served.address}")
            else:
                server.stopping.set()
        await running
        if failure is not None:
            raise failure
        return EXIT_FAILED if self._failed else 0

    def _end(self, _failure: BaseException) -> None:
        """Stop the process, because one of its own tasks failed. The failing part has logged the reason."""
        self._failed = True
        self._served.server.stopping.set()


async def serve(settings: HostSettings, words: Sequence[str]) -> int:
    """Serve until a stop signal. Returns the exit code. Raises the error that keeps the host from starting.

    `words`: the arguments of this process, which a supervisor passes on to its host processes.
    """
    if settings.processes > 1:
        base_name = settings.name or ("" if settings.tls_certificate else default_name())
        return await Supervisor(process_arguments(settings, words, base_name), settings.drain_seconds).run()
    async with GarbageCollection():
        return await _Service(settings).run()


def main(argv: Sequence[str] | None = None) -> int:
    """Run `stampede host`; returns the exit code."""
    words = sys.argv[1:] if argv is None else argv
    return run_service(HostSettings, "host", words, lambda settings: serve(settings, words))
