"""The channel host as a process: `stampede host`."""

from __future__ import annotations

import asyncio
import logging
import socket
import sys
from collections.abc import Sequence
from functools import partial

from stampede_rt.cluster.addresses import is_loopback
from stampede_rt.transports.machine import this_machine
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.cluster.identity import (
    HomeCluster,
    HostIdentity,
    default_name,
    load_host_id,
    new_boot_incarnation,
)
from stampede_rt_channel_host.host import ChannelHost
from stampede_rt_channel_host.process_arguments import process_arguments
from stampede_rt_channel_host.settings import HostSettings
from stampede_rt_channel_host.supervisor import Supervisor
from stampede_rt_runtime.clock import SystemClock
from stampede_rt_runtime.garbage import GarbageCollection
from stampede_rt_runtime.identity import Role
from stampede_rt_runtime.listen import CannotListen, NotAllowed
from stampede_rt_runtime.main import EXIT_FAILED, announce, run_service
from stampede_rt_runtime.metrics.serving import serving_metrics
from stampede_rt_runtime.routes import address_towards
from stampede_rt_runtime.server import ServiceServer
from stampede_rt_runtime.settings import SettingsError
from stampede_rt_runtime.values import Address, parse_address

logger = logging.getLogger(__name__)

_ANYWHERE = frozenset({"0.0.0.0", "::"})


class _Service:
    """One host process, from start to end."""

    def __init__(self, settings: HostSettings) -> None:
        self._settings = settings
        self._credentials = settings.load_credentials(Role.HOST)
        self._home = HomeCluster(settings.data_dir)
        credentials = self._credentials
        self._server = ServiceServer(
            secret=credentials.secret,
            client_secret=credentials.client_secret,
            tls=credentials.tls,
            judge_cluster=self._home.judge,
            reflection=settings.reflection,
        )
        self._failed = False
        # kept here, because the loop keeps only weak references to its tasks
        self._health: asyncio.Task[None] | None = None

    async def run(self) -> int:
        """Serve until a stop signal. Returns the exit code. Raises the error that keeps the host from starting."""
        settings = self._settings
        host = self._make_host()
        host.add_to(self._server.grpc)
        self._server.sockets.register(host.add_to)
        secured = self._credentials.tls is not None
        own = settings.listen or where_to_listen(settings, secured=secured)
        address = self._server.bind(own, allow_insecure_anywhere=settings.allow_insecure_anywhere)
        advertise = settings.advertise or where_to_call(address, settings.frontend, self._names_certified())
        if self._credentials.tls is not None:
            self._credentials.tls.require_address(advertise)
        await self._server.start()
        local = await self._listen_locally()
        sources = host.metrics(settings.metrics_names).collect
        async with serving_metrics(settings.metrics_address(), "host", self._server, sources):
            return await self._run(host, address, advertise, local)

    async def _run(self, host: ChannelHost, address: str, advertise: str, local: str) -> int:
        """Enter the cluster, and serve until a stop signal. Returns the exit code."""
        seconds = self._settings.drain_seconds
        before = partial(host.give_away, seconds) if seconds else None
        running = asyncio.create_task(self._server.run(host.leave, before))  # from here on it handles stop signals
        entering = asyncio.create_task(host.enter(advertise, local_target=local))
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

    async def _listen_locally(self) -> str:
        """Listen at a Unix socket, too. Returns its target; empty if the system does not let it."""
        if not this_machine():
            return ""
        try:
            return await self._server.sockets.listen_locally()
        except CannotListen as error:
            logger.warning(
                "callers of this machine use gRPC only: %s", error, extra={"event": "local_socket_unavailable"}
            )
            return ""

    def _make_host(self) -> ChannelHost:
        settings = self._settings
        identity = HostIdentity(
            host_id=load_host_id(settings.data_dir or settings.archive),
            name=self._name(),
            boot_incarnation=new_boot_incarnation(),
            zone=settings.zone,
        )
        archive = None if settings.archive is None else ArchiveFolder(settings.archive)
        if archive is not None:
            archive.open(identity.host_id)
        return ChannelHost(
            identity,
            frontends=settings.frontend,
            dial=self._credentials,
            dial_for_lease=self._credentials.dial_from_any_loop,
            explain=self._credentials.explain,
            clock=SystemClock(),
            memory_bytes_max=settings.memory_bytes_max,
            copy_bytes_per_second=settings.copy_bytes_per_second,
            archive=archive,
            on_serving=self._serving_changed,
            on_defect=self._end,
            home=self._home,
            access=self._server.access,
            tickets=self._server.sockets.tickets,
            refused_calls=self._server.refused_calls,
        )

    def _name(self) -> str:
        """The host's name in the directory: with certificates the name in its own certificate, else `--name` or a new
        name.
        """
        tls, name = self._credentials.tls, self._settings.name
        if tls is None:
            return name or default_name()
        tls.require_name(name or tls.identity.name, "--name")
        return tls.identity.name

    def _names_certified(self) -> tuple[str, ...]:
        return self._credentials.tls.addresses if self._credentials.tls else ()

    def _serving_changed(self, serving: bool) -> None:
        if not self._server.stopping.is_set():
            self._health = asyncio.create_task(self._server.set_serving(serving))

    def _end(self, _failure: BaseException) -> None:
        """Stop the process, because one of its own tasks failed. The failing part has logged the reason."""
        self._failed = True
        self._server.stopping.set()


def where_to_listen(settings: HostSettings, *, secured: bool) -> str:
    """The address at which a host without `--listen` listens: this machine's address towards the front-ends, any port.

    The address is "localhost" if all front-ends are on this machine. `secured`: the host has certificates. Raises
    NotAllowed if other machines could call the host without certificates and no setting allows it. Raises CannotListen
    if no route leads to a front-end.
    """
    own = address_towards(settings.frontend)
    if own != "localhost" and not (secured or settings.allow_insecure_anywhere):
        raise NotAllowed(
            f"a front-end ({', '.join(settings.frontend)}) is on another machine, so this host must listen at {own}, "
            "where others can call it, and without certificates everything, the secret included, would cross the "
            "network in clear text; give it certificates (--tls-ca and the others), or, on a network that you trust, "
            "add --allow-insecure-anywhere"
        )
    return str(Address(own, 0))


def where_to_call(address: str, frontends: Sequence[str], certified: Sequence[str]) -> str:
    """The address at which others reach a host that listens at `address`.

    If the host listens at all addresses of its machine, the result has the machine's name if all front-ends are on
    this machine or if `certified` has that name; else the machine's address towards the front-ends. `certified`: the
    names and addresses in the host's certificate. Raises SettingsError if only this machine can call `address` and a
    front-end is on another machine.
    """
    own_address = parse_address(address)
    if own_address.host in _ANYWHERE:
        own = address_towards(frontends)
        by_name = own == "localhost" or socket.gethostname() in certified
        return str(Address(socket.gethostname() if by_name else own, own_address.port))
    if is_loopback(address) and (own := address_towards(frontends)) != "localhost":
        raise SettingsError(
            f"this host would be known as {address}, which only its own machine can call, and a front-end "
            f"({', '.join(frontends)}) is on another machine; listen at {own} (--listen "
            f"{Address(own, own_address.port)}), or name with --advertise the address at which others reach this host"
        )
    return address


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
