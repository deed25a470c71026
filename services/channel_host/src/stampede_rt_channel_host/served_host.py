"""One channel host with its server: where it listens, and how callers reach it.

`stampede host` runs it as a process, and `embedded` inside another program's process.
"""

from __future__ import annotations

import asyncio
import logging
import secrets
import socket
from collections.abc import Callable, Sequence

from stampede_rt.cluster.addresses import is_loopback
from stampede_rt.cluster.transport_choice import Transport
from stampede_rt.transports.machine import this_machine
from stampede_rt_channel_host.archive.archive_folder import ArchiveFolder
from stampede_rt_channel_host.archive.objects.object_archive import ObjectSettings
from stampede_rt_channel_host.archive.objects.segment_store import StoreError, advice, check_store
from stampede_rt_channel_host.channels.multicast.group_socket import MulticastGroup, loopback_or_empty
from stampede_rt_channel_host.channels.multicast.multicasts import Multicasts
from stampede_rt_channel_host.cluster.identity import (
    HomeCluster,
    HostIdentity,
    default_name,
    load_host_id,
    new_boot_incarnation,
)
from stampede_rt_channel_host.host import ChannelHost
from stampede_rt_channel_host.settings import HostSettings
from stampede_rt_runtime.access.move_permits import KEY_BYTES
from stampede_rt_runtime.clock import SystemClock
from stampede_rt_runtime.dial import Dialer
from stampede_rt_runtime.listen import AddressNotAllowed, CannotListen
from stampede_rt_runtime.routes import address_towards
from stampede_rt_runtime.server import ServiceServer
from stampede_rt_runtime.settings import SettingsError
from stampede_rt_runtime.values import Address, parse_address

logger = logging.getLogger(__name__)

_ANYWHERE = frozenset({"0.0.0.0", "::"})


class ServedHost:
    """One host and its server. Order of use: make it on the loop that serves, `listen`, and then enter `host`.

    `on_defect` gets the error if a task of the host fails.
    """

    def __init__(self, settings: HostSettings, credentials: Dialer, on_defect: Callable[[BaseException], None]) -> None:
        self._settings = settings
        self._credentials = credentials
        self._on_defect = on_defect
        self._home = HomeCluster(settings.data_dir)
        self.server = ServiceServer(
            secret=credentials.secret,
            client_secret=credentials.client_secret,
            tls=credentials.tls,
            judge_cluster=self._home.judge,
            reflection=settings.reflection,
        )
        # kept here, because the loop keeps only weak references to its tasks
        self._health: asyncio.Task[None] | None = None
        self._objects = _objects_of(settings)
        self._archive: ArchiveFolder | None = None
        try:
            self.host = self._make_host()
        except BaseException:
            if self._archive is not None:
                self._archive.close()
            raise
        self.address = self.advertise = self.local = self.tcp = ""

    def close_archive_in_child(self) -> None:
        """Close the copy of the archive's lock that a forked child has. The lock of its parent stays."""
        if self._archive is not None:
            self._archive.close_copy()

    async def listen(self) -> None:
        """Listen, at a Unix socket and the TCP port for data, too.

        Raises CannotListen, AddressNotAllowed, SettingsError, PermissionDenied.
        """
        settings, tls = self._settings, self._credentials.tls
        if self._objects is not None:
            await check_store(self._objects.store)
        self.host.add_to(self.server.grpc)
        self.server.sockets.register(self.host.add_to)
        own = settings.listen or where_to_listen(settings, secured=tls is not None)
        self.address = self.server.bind(own, allow_insecure_anywhere=settings.allow_insecure_anywhere)
        names = tls.addresses if tls else ()
        self.advertise = settings.advertise or where_to_call(self.address, settings.frontend, names)
        if tls is not None:
            tls.require_address(self.advertise)
        await self.server.start()
        self.local = await self._listen_locally()
        self._begin_multicast()
        if settings.data_port is not None:
            insecure = settings.allow_insecure_anywhere
            self.tcp = f"tcp:{self.server.bind_sockets(settings.data_port, allow_insecure_anywhere=insecure)}"

    def _begin_multicast(self) -> None:
        """Let readers take items from datagrams, if the settings name a group. Raises CannotListen."""
        settings = self._settings
        if not settings.multicast:
            return
        interface = settings.multicast_interface or loopback_or_empty(parse_address(self.address).host)
        try:
            group = MulticastGroup(settings.multicast, interface, settings.multicast_bytes_per_second)
        except OSError as error:
            raise CannotListen(
                f"this machine cannot multicast from {interface or 'any interface'} ({error}); name with "
                "--multicast-interface an IPv4 address of this machine"
            ) from error
        self.host.store.multicasts = Multicasts(group, self.host.store.now)

    async def _listen_locally(self) -> str:
        """Listen at a Unix socket, too. Returns its target; empty if the system does not allow this."""
        if not this_machine():
            return ""
        try:
            return await self.server.sockets.listen_locally()
        except CannotListen as error:
            logger.warning(
                "callers of this machine use gRPC only: %s", error, extra={"event": "local_socket_unavailable"}
            )
            return ""

    def _make_host(self) -> ChannelHost:
        settings = self._settings
        folder = settings.folder_of_archive
        host_id = load_host_id(settings.data_dir or folder)
        archive = None if folder is None else ArchiveFolder(folder, settings.archive_bytes_max)
        if archive is not None:
            archive.open(host_id)
            self._archive = archive
        identity = HostIdentity(
            host_id=host_id,
            name=self._name(),
            boot_incarnation=new_boot_incarnation(),
            zone=settings.zone,
            has_archive=archive is not None,
            continues=0 if archive is None else archive.boot_of_last_stop(),
            move_key=secrets.token_bytes(KEY_BYTES),
            is_private=settings.private,
            archive_wait_nanos=settings.archive_wait_nanos,
            archive_place="" if archive is None else archive.place_text(self._objects and self._objects.store.url),
        )
        return ChannelHost(
            identity,
            frontends=settings.frontend,
            dial=self._credentials,
            dial_streams=self._credentials.dial_streams(Transport(settings.feed_transport)),
            dial_for_lease=self._credentials.dial_from_any_loop,
            explain=self._credentials.explain,
            clock=SystemClock(),
            memory_bytes_max=settings.memory_bytes_max,
            copy_bytes_per_second=settings.copy_bytes_per_second,
            archive=archive,
            objects=self._objects,
            on_serving=self._serving_changed,
            on_defect=self._on_defect,
            home=self._home,
            access=self.server.access,
            tickets=self.server.sockets.tickets,
            refused_calls=self.server.refused_calls,
        )

    def _name(self) -> str:
        """The host's name in the directory: with certificates the name in its own certificate; otherwise `--name` or a
        new name.
        """
        tls, name = self._credentials.tls, self._settings.name
        if tls is None:
            return name or default_name()
        tls.require_name(name or tls.identity.name, "--name")
        return tls.identity.name

    def _serving_changed(self, serving: bool) -> None:
        if not self.server.stopping.is_set():
            self._health = asyncio.create_task(self.server.set_serving(serving))


def _objects_of(settings: HostSettings) -> ObjectSettings | None:
    """The object store of the settings, or None. Raises SettingsError if its URL or its environment is not valid."""
    if not isinstance(settings.archive, str):
        return None
    from stampede_rt_channel_host.archive.objects.opened_store import OpenedStore  # needs the extra `objects`

    try:
        store = OpenedStore(settings.archive)
    except StoreError as error:
        raise SettingsError(f"--archive: {error.strerror}; {advice(settings.archive)}") from error
    return ObjectSettings(store, settings.archive_cache_bytes, settings.archive_move_seconds)


def where_to_listen(settings: HostSettings, *, secured: bool) -> str:
    """The address at which a host without `--listen` listens: this machine's address towards the front-ends, any port.

    The address is "localhost" if all front-ends are on this machine. `secured`: the host has certificates. Raises
    AddressNotAllowed if other machines could call the host without certificates and no setting allows it. Raises
    CannotListen if no route leads to a front-end.
    """
    own = address_towards(settings.frontend)
    if own != "localhost" and not (secured or settings.allow_insecure_anywhere):
        raise AddressNotAllowed(
            f"a front-end ({', '.join(settings.frontend)}) is on another machine, so this host must listen at {own}, "
            "where others can call it, and without certificates everything, the secret included, would cross the "
            "network in clear text; give it certificates (--tls-ca and the others), or, on a network that you trust, "
            "add --allow-insecure-anywhere"
        )
    return str(Address(own, 0))


def where_to_call(address: str, frontends: Sequence[str], certified: Sequence[str]) -> str:
    """The address at which callers reach a host that listens at `address`.

    If the host listens at all addresses of its machine, the result has the machine's name if all front-ends are on this
    machine or if `certified` has that name; otherwise the machine's address towards the front-ends. `certified`: the
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
