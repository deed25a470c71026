"""The channel host as a process: `stampede host`."""

from __future__ import annotations

import asyncio
import gc
import socket
from collections.abc import Sequence

from stampede_rt_channel_host.cluster.identity import HostIdentity, default_name, load_host_id, new_boot_incarnation
from stampede_rt_channel_host.host import ChannelHost
from stampede_rt_channel_host.settings import HostSettings
from stampede_rt_runtime.clock import SystemClock
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.main import EXIT_FAILED, announce, run_service
from stampede_rt_runtime.server import ServiceServer
from stampede_rt_runtime.values import Address, parse_address

_ANYWHERE = frozenset({"0.0.0.0", "::"})


class _Service:
    """One host process, from its start to its end."""

    def __init__(self, settings: HostSettings) -> None:
        self._settings = settings
        self._credentials = settings.load_credentials(Role.HOST)
        self._server = ServiceServer(secret=self._credentials.secret, tls=self._credentials.tls)
        self._failed = False
        self._health: asyncio.Task[None] | None = None  # kept here, since the loop holds its tasks weakly

    async def run(self) -> int:
        """Serve until a stop signal; gives the exit code. Raises what keeps the host from starting."""
        settings = self._settings
        _tune_garbage_collection()
        host = self._make_host()
        host.add_to(self._server.grpc)
        address = self._server.bind(settings.listen, allow_insecure_anywhere=settings.allow_insecure_anywhere)
        advertise = settings.advertise or _reachable(address)
        if self._credentials.tls is not None:
            self._credentials.tls.require_address(advertise)
        await self._server.start()
        running = asyncio.create_task(self._server.run(host.leave))  # from here on a stop signal is heeded
        entering = asyncio.create_task(host.enter(advertise))
        await asyncio.wait({running, entering}, return_when=asyncio.FIRST_COMPLETED)
        failure: BaseException | None = None
        if not self._server.stopping.is_set():
            failure = entering.exception()
            if failure is None:
                announce(f"stampede host {host.identity.name} ready on {address}")
            else:
                self._server.stopping.set()
        await running
        if failure is not None:
            raise failure
        return EXIT_FAILED if self._failed else 0

    def _make_host(self) -> ChannelHost:
        settings = self._settings
        identity = HostIdentity(
            host_id=load_host_id(settings.data_dir),
            name=self._name(),
            boot_incarnation=new_boot_incarnation(),
            zone=settings.zone,
        )
        return ChannelHost(
            identity,
            frontends=settings.frontend,
            dial=self._credentials,
            explain=self._credentials.explain,
            clock=SystemClock(),
            memory_bytes_max=settings.memory_bytes_max,
            on_serving=self._serving_changed,
            on_defect=self._end,
        )

    def _name(self) -> str:
        """What it is told to be called; with certificates that is what they say."""
        tls, told = self._credentials.tls, self._settings.name
        if tls is None:
            return told or default_name()
        tls.require_name(told or tls.identity.name, "--name")
        return tls.identity.name

    def _serving_changed(self, serving: bool) -> None:
        if not self._server.stopping.is_set():
            self._health = asyncio.create_task(self._server.set_serving(serving))

    def _end(self, _failure: BaseException) -> None:
        """A host whose own tasks die must not linger half alive; it was logged where it was noticed."""
        self._failed = True
        self._server.stopping.set()


def _tune_garbage_collection() -> None:
    """Items are freed by their last reference; only what refers in circles needs the collector.

    With Python's defaults it walks over every held item time and again: 80 ms at a stretch for 400,000 of them, as
    measured, during which nobody is served.
    """
    gc.freeze()
    gc.set_threshold(5_000, 5, 1_000)


def _reachable(address: str) -> str:
    """Where others find a server that listens at `address`: a place to listen at may stand for all of a machine's."""
    place = parse_address(address)
    return str(Address(socket.gethostname(), place.port)) if place.host in _ANYWHERE else address


async def serve(settings: HostSettings) -> int:
    """Serve until a stop signal; gives the exit code. Raises what keeps the host from starting."""
    return await _Service(settings).run()


def main(argv: Sequence[str] | None = None) -> int:
    """Run `stampede host`; returns the exit code."""
    return run_service(HostSettings, "host", argv, serve)
