"""The host's calls to the directory about moves of channels (paper, sections 4.1 and 4.3)."""

from __future__ import annotations

import secrets
from collections.abc import AsyncIterator, Sequence
from contextlib import suppress
from enum import Enum
from typing import Any

from stampede_rt.errors import ChannelNotFound, StampedeError
from stampede_rt.v1 import (
    channel_pb2,
    directory_pb2,
    directory_service_pb2,
    migration_directory_service_pb2_grpc,
    move_pb2,
    replica_directory_service_pb2_grpc,
    replica_pb2,
    subject_pb2,
)
from stampede_rt.v1 import migration_directory_service_pb2 as pb
from stampede_rt.v1 import replica_directory_service_pb2 as replicas_pb
from stampede_rt_channel_host.cluster.directory import DirectoryQueries
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.cluster.queue_directory import QueueDirectory
from stampede_rt_channel_host.cluster.records import recorded_channel, recorded_queue
from stampede_rt_channel_host.cluster.supernodes import Supernodes, is_unknown_call
from stampede_rt_channel_host.copies.moves.gathered_moves import (
    FallbackRelease,
    GatheredMoves,
    MoveCommit,
    OwnedChannel,
)
from stampede_rt_channel_host.copies.replica_directory import FeedSource
from stampede_rt_channel_host.core.placing import OtherHost
from stampede_rt_channel_host.core.records import RecordedChannel, RecordedQueue

CALL_SECONDS_MAX = 4.0


class FormerOwnerRole(Enum):
    """The role that the directory still gives the former owner of a channel.

    FALLBACK: the former owner is the owner again, or will be if the present owner is lost soon. REPLICA: the former
    owner is a replica, because the new owner's replica became the owner.
    """

    NO = "nothing"
    FALLBACK = "fallback"
    REPLICA = "replica"


class MoveDirectory(GatheredMoves):
    """Asks the directory about owners, and has it change them.

    Each method waits for CALL_SECONDS_MAX at most, and raises the error with which the directory answers, or
    Unavailable. A gathered call also waits for the call under way, and if the directory refuses a gathered commit, the
    host commits the move alone to learn the reason. So `commit` waits for four times as long at most. `remove_fallback`
    and `is_released` wait for twice as long at most.
    """

    def __init__(self, supernodes: Supernodes, identity: HostIdentity) -> None:
        super().__init__()
        self._supernodes = supernodes
        self._queries = DirectoryQueries(supernodes)
        self._queues = QueueDirectory(supernodes)
        self._identity = identity
        self.registered_index = 0
        """The log position of this host's registration, as of the last answer to one. A commit names it, so that no
        earlier commit counts after a failed move.
        """

    async def resolve(self, channel_id: bytes) -> RecordedChannel:
        """The channel's present record. Raises ChannelNotFound."""
        return await self._queries.resolve(channel_id)

    async def owner_of_one(self, channel_id: bytes) -> OwnedChannel:
        """The channel and its owner. Raises ChannelNotFound."""
        request = directory_service_pb2.ResolveChannelRequest(channel_id=channel_id)
        found: directory_service_pb2.ResolveChannelResponse = await self._supernodes.call(
            "ResolveChannel", request, CALL_SECONDS_MAX
        )
        return _placed(found.channel, found.host)

    async def owners_of(self, channel_ids: Sequence[bytes]) -> list[OwnedChannel]:
        """Look up several channels with one call. If the supernode has an earlier release, make one call for each."""
        try:
            found = await self._call("ListOwners", pb.ListOwnersRequest(channel_ids=channel_ids))
        except StampedeError as error:
            if not is_unknown_call(error):
                raise
            return [one async for one in self._one_by_one(channel_ids)]
        hosts = {one.host_id: one for one in found.hosts}
        return [_placed(one, hosts[one.host_id]) for one in found.channels]

    async def _one_by_one(self, channel_ids: Sequence[bytes]) -> AsyncIterator[OwnedChannel]:
        for one in channel_ids:
            with suppress(ChannelNotFound):
                yield await self.owner_of_one(one)

    async def other_hosts(self) -> list[OtherHost]:
        """The live hosts other than this one."""
        request, hosts = directory_service_pb2.ListHostsRequest(), []
        while True:  # ends with the last page
            page: directory_service_pb2.ListHostsResponse = await self._supernodes.call(
                "ListHosts", request, CALL_SECONDS_MAX
            )
            hosts += [one for one in page.hosts if one.alive and one.gatekeepers]
            request.page_token = page.next_page_token
            if not request.page_token:
                break
        return [
            OtherHost(
                one.host_id,
                one.name,
                one.gatekeepers[0].target,
                one.load.busy_permille,
                one.channels,
                one.load.has_archive,
            )
            for one in hosts
            if one.host_id != self._identity.host_id and not one.load.private
        ]

    async def kept_here(self, channel_id: bytes) -> FormerOwnerRole:
        """The role that the directory still gives this host, the former owner of a channel."""
        request = replicas_pb.ListReplicasRequest(subject=subject_pb2.Subject(channel_id=channel_id))
        host_id = self._identity.host_id
        stub = replica_directory_service_pb2_grpc.ReplicaDirectoryServiceStub
        found: replicas_pb.ListReplicasResponse = await self._call("ListReplicas", request, stub)
        kinds = [one.kind for one in found.replicas if one.host_id == host_id]
        if replica_pb2.REPLICA_KIND_WARM in kinds:
            return FormerOwnerRole.REPLICA
        is_fallback = replica_pb2.REPLICA_KIND_MOVE in kinds or found.owner_host_id == host_id
        return FormerOwnerRole.FALLBACK if is_fallback else FormerOwnerRole.NO

    async def commit_one(self, move: MoveCommit) -> RecordedChannel:
        """Commit one move."""
        request = pb.CommitMoveRequest(
            request_id=move.request_id,
            channel_id=move.channel_id,
            epoch=move.epoch,
            to_host_id=self._identity.host_id,
            to_boot_incarnation=self._identity.boot_incarnation,
            to_registered_index=self.registered_index if move.permit else 0,
            permit=move.permit,
        )
        return recorded_channel((await self._call("CommitMove", request)).channel)

    async def commit_all(self, moves: Sequence[MoveCommit]) -> list[RecordedChannel]:
        """Commit moves with one entry of the log."""
        request = pb.CommitMovesRequest(
            request_id=secrets.token_bytes(16),
            to_host_id=self._identity.host_id,
            to_boot_incarnation=self._identity.boot_incarnation,
            to_registered_index=self.registered_index,
            moves=[
                move_pb2.MoveToCommit(channel_id=one.channel_id, epoch=one.epoch, permit=one.permit) for one in moves
            ],
        )
        return [recorded_channel(one) for one in (await self._call("CommitMoves", request)).channels]

    async def release_all(self, moves: Sequence[FallbackRelease]) -> set[bytes]:
        """Remove fallbacks with one entry of the log."""
        request = pb.ReleaseMovesRequest(
            request_id=secrets.token_bytes(16),
            host_id=self._identity.host_id,
            moves=[move_pb2.MoveToRelease(channel_id=one.channel_id, epoch=one.epoch) for one in moves],
        )
        return {*(await self._call("ReleaseMoves", request)).channel_ids}

    async def released_of(self, channel_ids: Sequence[bytes]) -> set[bytes]:
        """Ask which of several channels are released, with one call."""
        request = pb.ListReleasedMovesRequest(host_id=self._identity.host_id, channel_ids=channel_ids)
        return {*(await self._call("ListReleasedMoves", request)).channel_ids}

    async def queue(self, queue_id: bytes) -> tuple[RecordedQueue, str | None]:
        """The queue's present record, and its owner's gatekeeper; None if the owner is not alive. Raises
        QueueNotFound.
        """
        found = await self._queues.resolve(queue_id)
        return found.queue, found.target

    async def commit_queue(self, queue_id: bytes, epoch: int, request_id: bytes, permit: bytes = b"") -> RecordedQueue:
        """Commit the move of one queue. Each queue has a call of its own, because users of the queue wait meanwhile."""
        request = pb.CommitQueueMoveRequest(
            request_id=request_id,
            queue_id=queue_id,
            epoch=epoch,
            to_host_id=self._identity.host_id,
            to_boot_incarnation=self._identity.boot_incarnation,
            to_registered_index=self.registered_index if permit else 0,
            permit=permit,
        )
        return recorded_queue((await self._call("CommitQueueMove", request)).queue)

    async def _call(
        self,
        method: str,
        request: object,
        stub: Any = migration_directory_service_pb2_grpc.MigrationDirectoryServiceStub,
    ) -> Any:
        return await self._supernodes.call(method, request, CALL_SECONDS_MAX, service=stub)


def _placed(channel: channel_pb2.ChannelRecord, owner: directory_pb2.HostRecord) -> OwnedChannel:
    record = recorded_channel(channel)
    target = owner.gatekeepers[0].target if owner.alive and owner.gatekeepers else ""
    return record, FeedSource(record.host_id, target, record.epoch)
