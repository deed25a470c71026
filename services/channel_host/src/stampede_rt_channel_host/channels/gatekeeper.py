"""GatekeeperService: the first service of a host that a client calls (paper, section 4.1)."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt.cluster.request_age import age_clock_s, request_age_nanos
from stampede_rt.errors import InvalidArgument
from stampede_rt.transports.futexes import is_supported
from stampede_rt.transports.machine import this_machine
from stampede_rt.v1 import gatekeeper_service_pb2 as pb
from stampede_rt.v1 import gatekeeper_service_pb2_grpc
from stampede_rt_channel_host.channels.channel_changes import ChannelChanges
from stampede_rt_channel_host.channels.listing import page_of
from stampede_rt_channel_host.channels.store import ChannelStore
from stampede_rt_channel_host.cluster.identity import ID_BYTES, HostIdentity
from stampede_rt_channel_host.cluster.records import channel_message, policy_change
from stampede_rt_runtime.access.control import AccessControl, allowed_to, check_known
from stampede_rt_runtime.access.messages import status_message
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.globs import matcher
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_runtime.sockets.tickets import SocketTickets
from stampede_rt_runtime.version import software_version

PAGE_SIZE_MAX = 1000
GLOB_LENGTH_MAX = 256


class GatekeeperServicer(gatekeeper_service_pb2_grpc.GatekeeperServiceServicer):
    """Binds callers to channels, and changes channels at the host and in the directory."""

    def __init__(
        self, store: ChannelStore, changes: ChannelChanges, identity: HostIdentity, access: AccessControl,
        tickets: SocketTickets | None = None,
    ) -> None:  # fmt: skip
        """`tickets`: the tickets of the host's sockets; None if no caller has a certificate."""
        self._tickets = tickets or SocketTickets()
        self._store = store
        self._changes = changes
        self._identity = identity
        self._access = access
        # the addresses of the data services; set as soon as the server listens, before the host gets a lease
        self.target = ""
        self.local_target = self.tcp_target = ""

    async def Ping(  # noqa: N802
        self, request: pb.GatekeeperServicePingRequest, context: Context
    ) -> pb.GatekeeperServicePingResponse:
        """The host's name, id and version, the clock that stamps items, its memory, and its counts of refusals."""
        memory, archive = self._store.memory, self._store.recordings.archive
        return pb.GatekeeperServicePingResponse(
            time_unix_nano=self._store.now(),
            host_id=self._identity.host_id,
            name=self._identity.name,
            lease_held=self._store.lease_held(),
            version=software_version(),
            refused_items=memory.overload.refused,
            refused_ago_nanos=memory.refused_ago_nanos(),
            held_bytes=memory.used_bytes,
            memory_bytes_max=memory.bytes_max,
            refused_calls=self._store.refused_calls.count,
            refused_call_ago_nanos=self._store.refused_calls.ago_nanos(),
            access=status_message(self._access),
            archive_failure="" if archive is None else archive.failure,
            archive_failing_channels=0 if archive is None else archive.failing_channels,
            archive_store_failure="" if archive is None else archive.store_failure,
            refused_for_archive=memory.refused_for_archive,
        )

    @errors_as_status
    async def BindChannel(self, request: pb.BindChannelRequest, context: Context) -> pb.BindChannelResponse:  # noqa: N802
        """The address of the channel's data.

        Asks the directory first if this host does not know the channel, or knows another epoch or an older spec.
        """
        _check_id(request.channel_id)
        hosted = await self._store.bind(request.channel_id, request.epoch, request.spec_version)
        check_known(AccessKind.CHANNEL, hosted.record.name)
        endpoints = self._sockets(request.machine, context)
        endpoints.append(pb.DataEndpoint(transport=pb.TRANSPORT_GRPC, target=self.target))
        fed = hosted.fed if request.wants_copy else None
        return pb.BindChannelResponse(
            endpoints=endpoints,
            channel=channel_message(hosted.record),
            copy_target=fed.for_gets() if fed is not None else "",
        )

    async def ListDataEndpoints(  # noqa: N802
        self, request: pb.ListDataEndpointsRequest, context: Context
    ) -> pb.ListDataEndpointsResponse:
        """The sockets of this host that the caller can use."""
        return pb.ListDataEndpointsResponse(endpoints=self._sockets(request.machine, context))

    def _sockets(self, machine: str, context: Context) -> list[pb.DataEndpoint]:
        """The sockets for a caller on that machine, best first."""
        local = self._local_sockets(machine, context)
        if self.tcp_target:
            local.append(pb.DataEndpoint(transport=pb.TRANSPORT_SOCKET, target=self.tcp_target))
        return local

    def _local_sockets(self, machine: str, context: Context) -> list[pb.DataEndpoint]:
        if not self.local_target or not machine or machine != this_machine():
            return []
        ticket = self._tickets.issue(context.auth_context())
        if ticket is None:
            return []
        transports = (pb.TRANSPORT_SHARED_MEMORY, pb.TRANSPORT_SOCKET) if is_supported() else (pb.TRANSPORT_SOCKET,)
        return [pb.DataEndpoint(transport=one, target=self.local_target, ticket=ticket) for one in transports]

    async def _wait_for_move(self, channel_id: bytes) -> None:
        """While a move holds the changes of the channel, wait. Raises Overloaded after 5 s."""
        hosted = self._store.known(channel_id)
        if hosted is not None and hosted.moving is not None:
            await hosted.moving.decided()

    @errors_as_status
    async def DropChannel(self, request: pb.DropChannelRequest, context: Context) -> pb.DropChannelResponse:  # noqa: N802
        """Delete the channel in the directory, then at this host. Its readers' streams end with CHANNEL_NOT_FOUND."""
        _check_id(request.channel_id)
        _check_request_id(request.request_id)
        since_s = _first_sent_s(context)
        await self._wait_for_move(request.channel_id)
        await self._changes.drop(request.channel_id, request.epoch, request.request_id, since_s)
        return pb.DropChannelResponse()

    @errors_as_status
    async def ConfigureChannel(  # noqa: N802
        self, request: pb.ConfigureChannelRequest, context: Context
    ) -> pb.ConfigureChannelResponse:
        """Change the policy in the directory, then at this host. When the call returns, the new policy is in force."""
        _check_id(request.channel_id)
        _check_request_id(request.request_id)
        await self._wait_for_move(request.channel_id)
        hosted = await self._changes.configure(
            request.channel_id, request.epoch, policy_change(request.spec), request.request_id, _first_sent_s(context)
        )
        return pb.ConfigureChannelResponse(channel=channel_message(hosted.record))

    @errors_as_status
    async def ListHostedChannels(  # noqa: N802
        self, request: pb.ListHostedChannelsRequest, context: Context
    ) -> pb.ListHostedChannelsResponse:
        """A page of the channels that callers have bound at this host, sorted by name.

        The token of the next page is the last name on this page.
        """
        matches = _glob(request.name_glob)
        size = min(request.page_size or PAGE_SIZE_MAX, PAGE_SIZE_MAX)
        is_shown = allowed_to(AccessVerb.LIST, AccessKind.CHANNEL)
        listing = page_of(self._store, lambda name: matches(name) and is_shown(name), request.page_token, size)
        page = await self._store.scheduler.do(listing)
        return pb.ListHostedChannelsResponse(
            channels=page.channels, next_page_token=page.channels[-1].record.name if page.has_more else ""
        )


def _check_id(channel_id: bytes) -> None:
    if len(channel_id) != ID_BYTES:
        raise InvalidArgument(
            f"channel_id has {len(channel_id)} bytes; give the {ID_BYTES} bytes that the directory gave"
        )


def _first_sent_s(context: Context) -> float:
    """The time at which the caller made the request, in seconds of `age_clock_s`.

    Raises InvalidArgument for a malformed age.
    """
    return age_clock_s() - request_age_nanos(context.invocation_metadata()) / 1e9


def _check_request_id(request_id: bytes) -> None:
    if len(request_id) != ID_BYTES:
        raise InvalidArgument(
            f"request_id has {len(request_id)} bytes; choose {ID_BYTES} random bytes, and repeat them in each retry"
        )


def _glob(text: str) -> Callable[[str], bool]:
    """A function that returns whether a name matches the pattern `text`. Raises InvalidArgument if `text` is too
    long.
    """
    if len(text) > GLOB_LENGTH_MAX:
        raise InvalidArgument(f"name_glob has {len(text)} characters; it has at most {GLOB_LENGTH_MAX}")
    return matcher(text)
