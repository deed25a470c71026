"""Serves PeerService (proto/stampede_rt/v1/peer_service.proto). Each method checks the request, asks the core or the
log, and encodes the response.
"""

# ruff: noqa: N802  # methods have the names of the RPCs
from __future__ import annotations

import hashlib
import secrets
from collections.abc import AsyncIterator

from stampede_rt.v1 import peer_pb2, peer_service_pb2_grpc
from stampede_rt.v1 import peer_service_pb2 as pb
from stampede_rt.values.peering import ClockOffset
from stampede_rt.wire.peers import clock_offset
from stampede_rt_runtime.access.control import (
    allowed_to,
    audit_change,
    caller_name,
    check_access,
    check_known,
    creation_limit,
    owner_name,
)
from stampede_rt_runtime.access.rules import AccessKind, AccessVerb
from stampede_rt_runtime.quotas.limits import Quota
from stampede_rt_runtime.rpc import Context, errors_as_status
from stampede_rt_supernode.codecs.host_codec import host_record
from stampede_rt_supernode.codecs.peer_codec import attributes_from, peer_record
from stampede_rt_supernode.codecs.queue_codec import queue_record, queue_spec_from
from stampede_rt_supernode.codecs.record_codec import peer_change_message
from stampede_rt_supernode.core import page_tokens
from stampede_rt_supernode.core.cluster.feature_levels import QUEUE_REPLICAS_LEVEL
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.lookups import peer_by_id, peer_by_name
from stampede_rt_supernode.core.peers.checks import check_clock, check_proof
from stampede_rt_supernode.core.peers.commands import DeregisterPeer, PeerDeregistered, PeerRegistered, RegisterPeer
from stampede_rt_supernode.core.peers.queries import peer_page
from stampede_rt_supernode.core.peers.table import PeerKey, key_of
from stampede_rt_supernode.core.records import ID_BYTES, PeerRecord
from stampede_rt_supernode.servicers.calls import DirectoryCalls, seconds_left
from stampede_rt_supernode.servicers.lease_keeper import LeaseKeeper
from stampede_rt_supernode.servicers.listing import SearchStep, list_shown
from stampede_rt_supernode.servicers.visible_changes import visible_to_caller
from stampede_rt_supernode.servicers.watch import Watches


class PeerServicer(peer_service_pb2_grpc.PeerServiceServicer):
    """One supernode's answers about peers."""

    def __init__(self, calls: DirectoryCalls, leases: LeaseKeeper, watches: Watches) -> None:
        self._calls = calls
        self._leases = leases
        self._watches = watches

    @errors_as_status
    async def RegisterPeer(self, request: pb.RegisterPeerRequest, context: Context) -> pb.RegisterPeerResponse:
        """The lease begins when the leader sees the registration, which is after the peer has sent the request.

        In a cluster with certificates only a host itself may register as the peer of that host.
        """
        if request.HasField("host_id"):
            self._calls.check_host(context, request.host_id)
        if request.name:
            check_access(AccessVerb.REGISTER, AccessKind.PEER, request.name)
        if request.mailbox.HasField("dead_letter_queue_id"):
            await self._calls.check_thing(
                context, AccessVerb.SEND, AccessKind.QUEUE, request.mailbox.dead_letter_queue_id
            )
        if request.mailbox.replicas:
            await self._calls.check_level(context, "a mailbox with replicas", QUEUE_REPLICAS_LEVEL)
        clock, former = _clock_report(request), self._calls.holder_of(request.name)
        registered = await self._calls.submit(context, _registration(request), PeerRegistered, request.request_id)
        if former is not None and former.boot_incarnation != request.boot_incarnation:
            audit_change("take over peer", request.name)
        self._leases.note_clock(registered.peer, clock)
        ttl_nanos = await self._calls.read(context, lambda directory: directory.lease_ttl_nanos, stale_ok=True)
        return pb.RegisterPeerResponse(
            peer=peer_record(registered.peer),
            lease_ttl_nanos=ttl_nanos,
            mailbox=None if registered.mailbox is None else queue_record(registered.mailbox),
            mailbox_host=None if registered.mailbox_host is None else host_record(registered.mailbox_host),
            mailbox_kept=registered.mailbox_kept,
            cluster_id=registered.cluster_id,
        )

    @errors_as_status
    async def RenewPeerLease(self, request: pb.RenewPeerLeaseRequest, context: Context) -> pb.RenewPeerLeaseResponse:
        """Makes no log entry."""
        await self._calls.check_peer(context, request.peer_id)
        renewed = await self._leases.renew_peer(
            request.peer_id, request.boot_incarnation, _clock_report(request), seconds=seconds_left(context)
        )
        return pb.RenewPeerLeaseResponse(
            lease_ttl_nanos=renewed.ttl_nanos,
            tenure=renewed.tenure,
            time_unix_nano=renewed.time_unix_nano,
            supernode_id=renewed.supernode_id,
            held_nanos=renewed.held_nanos,
        )

    @errors_as_status
    async def DeregisterPeer(self, request: pb.DeregisterPeerRequest, context: Context) -> pb.DeregisterPeerResponse:
        await self._calls.check_peer(context, request.peer_id)
        operation = DeregisterPeer(peer_id=request.peer_id, boot_incarnation=request.boot_incarnation)
        await self._calls.submit(context, operation, PeerDeregistered, request.request_id)
        return pb.DeregisterPeerResponse()

    @errors_as_status
    async def ResolvePeer(self, request: pb.ResolvePeerRequest, context: Context) -> pb.ResolvePeerResponse:

        def find(directory: Directory) -> tuple[PeerRecord, int]:
            by_name = request.WhichOneof("key") == "name"
            tables = directory.tables
            peer = peer_by_name(tables, request.name) if by_name else peer_by_id(tables, request.peer_id)
            return peer, directory.applied_index

        if request.with_clocks:
            self._leases.check_leads()
        if request.WhichOneof("key") == "name":
            check_known(AccessKind.PEER, request.name)
        peer, index = await self._calls.read(context, find, stale_ok=request.stale_ok)
        if peer.owner is None or peer.owner != owner_name():
            check_known(AccessKind.PEER, peer.name, by_id=True)
        return pb.ResolvePeerResponse(peer=self._record(peer, request.with_clocks), applied_index=index)

    def _record(self, peer: PeerRecord, with_clock: bool) -> peer_pb2.PeerRecord:
        return peer_record(peer, self._leases.clock_of(peer) if with_clock and peer.alive else None)

    @errors_as_status
    async def ListPeers(self, request: pb.ListPeersRequest, context: Context) -> pb.ListPeersResponse:
        listing = f"peers\0{request.name_glob}\0{request.include_dead}"
        after = page_tokens.read_peer(request.page_token, listing)

        def search(directory: Directory, after: PeerKey, most: int) -> SearchStep[PeerRecord, PeerKey]:
            page = peer_page(directory.tables, request.name_glob, after, most, include_dead=request.include_dead)
            return SearchStep([(key_of(peer), peer) for peer in page.peers], page.last)

        if request.with_clocks:
            self._leases.check_leads()
        may_list = allowed_to(AccessVerb.LIST, AccessKind.PEER)
        page = await list_shown(
            self._calls,
            context,
            search,
            lambda peer: may_list(peer.name),
            after,
            request.page_size,
            stale_ok=request.stale_ok,
        )
        return pb.ListPeersResponse(
            peers=[self._record(peer, request.with_clocks) for peer in page.things],
            next_page_token=page_tokens.write_peer(listing, page.last),
            applied_index=page.applied_index,
        )

    @errors_as_status
    async def WatchPeers(self, request: pb.WatchPeersRequest, context: Context) -> AsyncIterator[pb.WatchPeersResponse]:
        await self._calls.confirm(context)
        batches = self._watches.follow_peers(request.name_glob, request.after_index, is_shown=visible_to_caller())
        async for batch in batches:
            yield pb.WatchPeersResponse(
                changes=[peer_change_message(change) for change in batch.changes], applied_index=batch.applied_index
            )


def _clock_report(request: pb.RegisterPeerRequest | pb.RenewPeerLeaseRequest) -> ClockOffset | None:
    clock = clock_offset(request.clock) if request.HasField("clock") else None
    check_clock(clock)
    return clock


def _registration(request: pb.RegisterPeerRequest) -> RegisterPeer:
    """The operation of a request. It has a hash of the proof, and not the proof itself."""
    check_proof(request.proof)
    return RegisterPeer(
        peer_id=request.peer_id,
        name=request.name,
        boot_incarnation=request.boot_incarnation,
        proof_sha256=hashlib.sha256(request.proof).digest() if request.proof else b"",
        mailbox=queue_spec_from(request.mailbox) if request.HasField("mailbox") else None,
        mailbox_host_name=request.mailbox_host_name,
        host_id=request.host_id if request.HasField("host_id") else None,
        zone=request.zone,
        version=request.version,
        attributes=attributes_from(request.attributes),
        new_mailbox_id=secrets.token_bytes(ID_BYTES),
        new_incarnation=secrets.randbits(64) or 1,
        owner=owner_name(),
        created_by=caller_name(),
        created_max=creation_limit(Quota.PEERS),
        registration_epoch=request.registration_epoch,
    )
