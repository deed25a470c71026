"""Serves DirectoryService (proto/stampede_rt/v1/directory_service.proto). Each method checks the request, asks the core
or the log, and encodes the response.
"""

# ruff: noqa: N802  # methods have the names of the RPCs
from __future__ import annotations

import secrets
from collections.abc import AsyncIterator

from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1 import directory_service_pb2_grpc
from stampede_rt.values.model import Policy
from stampede_rt_runtime.access.control import AccessControl, allowed_to, caller_name, check_known, creation_limit
from stampede_rt_runtime.access.messages import status_message
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.clock import HostClock
from stampede_rt_runtime.quotas.limits import Quota
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_runtime.version import PROTOCOL_VERSION, software_version
from stampede_rt_supernode.codecs.host_codec import endpoints_from, host_record, load_from
from stampede_rt_supernode.codecs.queue_codec import queue_record
from stampede_rt_supernode.codecs.record_codec import (
    change_message,
    channel_record,
    policy_from,
)
from stampede_rt_supernode.core import page_tokens
from stampede_rt_supernode.core.callers import check_protocol
from stampede_rt_supernode.core.channels.commands import (
    ChannelDeleted,
    ChannelOpened,
    ChannelUpdated,
    DeleteChannel,
    OpenChannel,
    UpdateChannel,
)
from stampede_rt_supernode.core.channels.transitions import open_unchanged
from stampede_rt_supernode.core.channels.waiting import check_waited
from stampede_rt_supernode.core.cluster.feature_levels import ARCHIVE_LEVEL, LAGGING_REPLICAS_LEVEL, LOADS_LEVEL
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.hosts.commands import DeregisterHost, HostDeregistered, HostRegistered, RegisterHost
from stampede_rt_supernode.core.lookups import channel_by_id, channel_by_name, host_by_id, host_by_name
from stampede_rt_supernode.core.queries import HostPage, channel_page, channels_of, host_page
from stampede_rt_supernode.core.queues.queries import queues_of
from stampede_rt_supernode.core.records import ID_BYTES, ChannelRecord, HostRecord, QueueRecord
from stampede_rt_supernode.core.validation import check_max_bytes
from stampede_rt_supernode.joining.members import Members
from stampede_rt_supernode.replica import DirectoryReplica
from stampede_rt_supernode.servicers.archive_waits import ArchiveWaits
from stampede_rt_supernode.servicers.calls import DirectoryCalls, seconds_left
from stampede_rt_supernode.servicers.lease_keeper import LeaseKeeper
from stampede_rt_supernode.servicers.listing import SearchStep, list_shown
from stampede_rt_supernode.servicers.own_cluster import OwnCluster
from stampede_rt_supernode.servicers.submission import Submission
from stampede_rt_supernode.servicers.visible_changes import visible_to_caller
from stampede_rt_supernode.servicers.watch import Watches

# How long ListHosts shows a lost host that owns nothing.
LOST_SHOWN_NANOS = 3600 * 10**9


class DirectoryServicer(directory_service_pb2_grpc.DirectoryServiceServicer):
    """One supernode's answers about channels and hosts.

    Reads are linearizable unless `stale_ok` is set. The directory performs an update only once for each request id.
    """

    def __init__(
        self,
        replica: DirectoryReplica,
        submission: Submission,
        leases: LeaseKeeper,
        watches: Watches,
        members: Members,
        clock: HostClock,
        own_cluster: OwnCluster,
        access: AccessControl,
    ) -> None:
        self._replica = replica
        self._calls = DirectoryCalls(replica, submission)
        self._submission = submission
        self._leases = leases
        self._watches = watches
        self._members = members
        self._clock = clock
        self._own_cluster = own_cluster
        self._access = access
        self._archive_waits = ArchiveWaits(replica, clock)

    async def Ping(self, request: pb.DirectoryServicePingRequest, context: Context) -> pb.DirectoryServicePingResponse:
        """Answers from the local state. Needs no leader."""
        return pb.DirectoryServicePingResponse(
            time_unix_nano=self._clock.time_unix_nano(),
            supernode_id=self._members.self_id,
            ready=self._members.ready(),
            cluster_id=self._own_cluster.id(),
            boot_incarnation=self._members.boot_incarnation,
            former_cluster_ids=self._replica.read(lambda directory: directory.former_cluster_ids),
            version=software_version(),
            refused_supernodes=self._members.refused(),
            feature_level=self._replica.feature_level,
            highest_feature_level=self._replica.highest_level,
            access=status_message(self._access),
        )

    async def _check_levels(self, context: Context, policy: Policy) -> None:
        """Check that all supernodes know the features that the stated policy uses. Raises Unavailable."""
        if policy.is_recorded or policy.ack == "disk":
            await self._calls.check_level(context, "a recorded channel", ARCHIVE_LEVEL)
        if policy.ack != "replica" and policy.replicas:
            await self._calls.check_level(context, "a replica for which no put waits", LAGGING_REPLICAS_LEVEL)

    @errors_as_status
    async def OpenChannel(self, request: pb.OpenChannelRequest, context: Context) -> pb.OpenChannelResponse:
        """Open a channel. If nothing changes, a confirmed read answers the first attempt without a log entry."""
        as_of = self._calls.applied_index()
        check_known(AccessKind.CHANNEL, request.name)
        if request.beside:
            check_known(AccessKind.CHANNEL, request.beside)
            await self._calls.check_level(context, "a channel that opens beside another", LOADS_LEVEL)
        policy = policy_from(request.spec)
        check_max_bytes("channel", request.name, policy.max_bytes)
        await self._check_levels(context, policy)
        operation = OpenChannel(
            name=request.name,
            policy=policy,
            create=request.create,
            host_name=request.host_name,
            beside=request.beside,
            new_channel_id=secrets.token_bytes(ID_BYTES),
            new_incarnation=_random_incarnation(),
            created_by=caller_name(),
            created_max=creation_limit(Quota.CHANNELS),
            waited_for_index=self._archive_waits.waited_for(request.name),
        )

        async def check(operation: OpenChannel) -> None:
            self._replica.read(lambda directory: check_waited(directory.tables, operation))
            self._calls.check_opening(AccessKind.CHANNEL, operation)

        opened = await self._calls.open(
            context,
            operation,
            ChannelOpened,
            request.request_id,
            as_of_index=as_of,
            unchanged=open_unchanged,
            check=check,
        )
        return pb.OpenChannelResponse(
            channel=channel_record(opened.channel), host=host_record(opened.host), created=opened.created
        )

    @errors_as_status
    async def ResolveChannel(self, request: pb.ResolveChannelRequest, context: Context) -> pb.ResolveChannelResponse:

        def find(directory: Directory) -> tuple[ChannelRecord, HostRecord, int]:
            tables = directory.tables
            by_id = request.WhichOneof("key") == "channel_id"
            channel = channel_by_id(tables, request.channel_id) if by_id else channel_by_name(tables, request.name)
            return channel, tables.hosts[channel.host_id], directory.applied_index

        if request.WhichOneof("key") == "name":
            check_known(AccessKind.CHANNEL, request.name)
        channel, host, index = await self._calls.read(context, find, stale_ok=request.stale_ok)
        check_known(AccessKind.CHANNEL, channel.name, by_id=True)
        return pb.ResolveChannelResponse(channel=channel_record(channel), host=host_record(host), applied_index=index)

    @errors_as_status
    async def ListChannels(self, request: pb.ListChannelsRequest, context: Context) -> pb.ListChannelsResponse:
        def search(directory: Directory, after: str, most: int) -> SearchStep[tuple[ChannelRecord, HostRecord], str]:
            page = channel_page(directory.tables, request.name_glob, after, most)
            hosts = directory.tables.hosts
            return SearchStep([(one.name, (one, hosts[one.host_id])) for one in page.channels], page.last_name)

        may_list = allowed_to(AccessVerb.LIST, AccessKind.CHANNEL)
        page = await list_shown(
            self._calls,
            context,
            search,
            lambda found: may_list(found[0].name),
            page_tokens.read_name(request.page_token),
            request.page_size,
            stale_ok=request.stale_ok,
        )
        return pb.ListChannelsResponse(
            channels=[channel_record(channel) for channel, _ in page.things],
            hosts=map(host_record, {host.host_id: host for _, host in page.things}.values()),
            next_page_token=page_tokens.write_name(page.last),
            applied_index=page.applied_index,
        )

    @errors_as_status
    async def UpdateChannel(self, request: pb.UpdateChannelRequest, context: Context) -> pb.UpdateChannelResponse:
        await self._calls.check_thing(context, AccessVerb.CONFIGURE, AccessKind.CHANNEL, request.channel_id)
        policy = policy_from(request.spec)
        check_max_bytes("channel", request.channel_id.hex(), policy.max_bytes)
        await self._check_levels(context, policy)
        operation = UpdateChannel(channel_id=request.channel_id, epoch=request.epoch, policy=policy)
        updated = await self._calls.submit(context, operation, ChannelUpdated, request.request_id)
        return pb.UpdateChannelResponse(channel=channel_record(updated.channel))

    @errors_as_status
    async def DeleteChannel(self, request: pb.DeleteChannelRequest, context: Context) -> pb.DeleteChannelResponse:
        await self._calls.check_thing(context, AccessVerb.DELETE, AccessKind.CHANNEL, request.channel_id)
        operation = DeleteChannel(channel_id=request.channel_id)
        await self._calls.submit(context, operation, ChannelDeleted, request.request_id)
        return pb.DeleteChannelResponse()

    @errors_as_status
    async def RegisterHost(self, request: pb.RegisterHostRequest, context: Context) -> pb.RegisterHostResponse:
        """The lease begins when the leader sees the registration, which is after the host has sent the request."""
        check_protocol(request.protocol_version, request.version)
        self._calls.check_host(context, request.host_id, request.name)
        operation = RegisterHost(
            host_id=request.host_id,
            name=request.name,
            gatekeepers=endpoints_from(request.gatekeepers),
            boot_incarnation=request.boot_incarnation,
            version=request.version,
            new_incarnation=_random_incarnation(),
            registration_epoch=request.registration_epoch,
            has_archive=request.has_archive,
            continues_boot_incarnation=request.continues_boot_incarnation,
            move_key=request.move_key,
            is_private=request.private,
            machine=request.machine,
            archive_wait_nanos=request.archive_wait_nanos,
            archive_place=request.archive_place,
        )
        registered = await self._calls.submit(context, operation, HostRegistered, request.request_id)
        ttl_nanos, channels, queues = self._replica.read(lambda directory: _owned(directory, request.host_id))
        return pb.RegisterHostResponse(
            host=host_record(registered.host),
            lease_ttl_nanos=ttl_nanos,
            channels=[channel_record(channel) for channel in channels],
            cluster_id=registered.cluster_id,
            protocol_version=PROTOCOL_VERSION,
            queues=[queue_record(queue) for queue in queues],
            former_cluster_ids=self._replica.read(lambda directory: directory.former_cluster_ids),
            registered_index=registered.host.registered_index,
        )

    @errors_as_status
    async def RenewHostLease(self, request: pb.RenewHostLeaseRequest, context: Context) -> pb.RenewHostLeaseResponse:
        """Makes no log entry. A changed load gets into the log with the loads of other hosts, see `host_loads`."""
        self._calls.check_host(context, request.host_id)
        ttl_nanos, tenure = await self._leases.renew(
            request.host_id, request.boot_incarnation, request.registered_index, seconds=seconds_left(context)
        )
        if request.HasField("load"):
            self._leases.loads.note(request.host_id, load_from(request.load))
        cluster_id, former = self._replica.read(lambda directory: (directory.cluster_id, directory.former_cluster_ids))
        return pb.RenewHostLeaseResponse(
            lease_ttl_nanos=ttl_nanos,
            tenure=tenure,
            cluster_id=cluster_id,
            former_cluster_ids=former,
            time_unix_nano=self._clock.time_unix_nano(),
        )

    @errors_as_status
    async def DeregisterHost(self, request: pb.DeregisterHostRequest, context: Context) -> pb.DeregisterHostResponse:
        self._calls.check_host(context, request.host_id)
        operation = DeregisterHost(host_id=request.host_id, boot_incarnation=request.boot_incarnation)
        await self._calls.submit(context, operation, HostDeregistered, request.request_id)
        return pb.DeregisterHostResponse()

    @errors_as_status
    async def ResolveHost(self, request: pb.ResolveHostRequest, context: Context) -> pb.ResolveHostResponse:

        def find(directory: Directory) -> tuple[HostRecord, int]:
            by_id = request.WhichOneof("key") == "host_id"
            tables = directory.tables
            host = host_by_id(tables, request.host_id) if by_id else host_by_name(tables, request.name)
            return host, directory.applied_index

        host, index = await self._calls.read(context, find, stale_ok=request.stale_ok)
        return pb.ResolveHostResponse(host=host_record(host), applied_index=index)

    @errors_as_status
    async def ListHosts(self, request: pb.ListHostsRequest, context: Context) -> pb.ListHostsResponse:
        after = page_tokens.read_host(request.page_token)
        since, with_dead = self._clock.time_unix_nano() - LOST_SHOWN_NANOS, request.include_dead

        def find(directory: Directory) -> tuple[HostPage, int]:
            page = host_page(directory.tables, after, request.page_size, include_dead=with_dead, lost_since=since)
            return page, directory.applied_index

        page, index = await self._calls.read(context, find, stale_ok=request.stale_ok)
        return pb.ListHostsResponse(
            hosts=[host_record(host) for host in page.hosts],
            next_page_token=page_tokens.write_host(page.last_key),
            applied_index=index,
        )

    async def ListSupernodes(self, request: pb.ListSupernodesRequest, context: Context) -> pb.ListSupernodesResponse:
        """Answers from the local state, so that the call works also without a majority."""
        records, term = self._members.records()
        index = self._replica.read(lambda directory: directory.applied_index)
        return pb.ListSupernodesResponse(
            supernodes=records, term=term, applied_index=index, feature_level=self._replica.feature_level
        )

    @errors_as_status
    async def Watch(self, request: pb.WatchRequest, context: Context) -> AsyncIterator[pb.WatchResponse]:
        await self._submission.confirm(seconds=seconds_left(context))
        batches = self._watches.follow(
            request.name_glob,
            request.after_index,
            include_hosts=request.include_hosts,
            include_groups=request.include_groups,
            include_queues=request.include_queues,
            include_access=request.include_access,
            is_shown=visible_to_caller(),
        )
        async for batch in batches:
            yield pb.WatchResponse(
                changes=[change_message(change) for change in batch.changes], applied_index=batch.applied_index
            )


def _owned(directory: Directory, host_id: bytes) -> tuple[int, tuple[ChannelRecord, ...], tuple[QueueRecord, ...]]:
    """The TTL of leases, and the first 1000 channels and queues that the host owns."""
    return directory.lease_ttl_nanos, channels_of(directory.tables, host_id), queues_of(directory.tables, host_id)


def _random_incarnation() -> int:
    return secrets.randbits(64) or 1
