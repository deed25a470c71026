"""The directory of the simulated hosts: the real state machine of the supernodes, without a network."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.cluster.records import recorded_channel
from stampede_rt_channel_host.copies.moves.gathered_moves import (
    FallbackRelease,
    GatheredMoves,
    MoveCommit,
    OwnedChannel,
)
from stampede_rt_channel_host.copies.moves.move_directory import FormerOwnerRole
from stampede_rt_channel_host.copies.replica_directory import FeedSource, ListedReplica, ListedReplicas
from stampede_rt_channel_host.core.placing import OtherHost
from stampede_rt_channel_host.core.records import RecordedChannel
from stampede_rt_channel_host.core.replication import KnownReplica, ReplicaChange
from stampede_rt_supernode.codecs.record_codec import channel_record
from stampede_rt_supernode.core.moves.commands import (
    CommitMove,
    CommitMoves,
    MoveCommitted,
    MoveToCommit,
    MoveToRelease,
    ReleaseMoves,
)
from stampede_rt_supernode.core.moves.several import released
from stampede_rt_supernode.core.records import ReplicaKind, ReplicaRecord
from stampede_rt_supernode.core.replicas.commands import RemoveReplica, SetReplicaInSync
from tests.support.supernode.operations import add_replica

if TYPE_CHECKING:
    from tests.robustness.moves.two_hosts import Host


class SimulatedDirectory(GatheredMoves):
    """The calls of one host to the directory: the calls of its store, its moves, its copies and its replicas."""

    def __init__(self, host: Host) -> None:
        super().__init__()
        self.host, self.world = host, host.world
        self.permits: list[bytes] = []  # the permits that this host has got

    async def _reach(self) -> None:
        await self.world.on_the_way(self.host)
        if self.world.is_cut_off or not self.host.alive:
            raise Unavailable("no supernode can be reached")

    def _copies(self, channel_id: bytes) -> tuple[ReplicaRecord, ...]:
        return self.world.log.directory.tables.replicas.of(channel_id)

    async def resolve(self, channel_id: bytes) -> RecordedChannel:
        await self._reach()
        record = self.world.record_of(channel_id)
        await self._reach()  # the answer may come late, or be lost
        return record

    async def owner_of_one(self, channel_id: bytes) -> OwnedChannel:
        await self._reach()
        return self.world.placed(channel_id)

    async def owners_of(self, channel_ids: Sequence[bytes]) -> list[OwnedChannel]:
        await self._reach()
        return [*map(self.world.placed, channel_ids)]

    async def source_of(self, channel_id: bytes, host_id: bytes) -> FeedSource | None:
        await self._reach()
        record = self.world.record_of(channel_id)
        if record.host_id == host_id:
            return FeedSource(host_id, "", record.epoch)
        copy = next((one for one in self._copies(channel_id) if one.host_id == host_id), None)
        if copy is None:
            return None
        target = self.world.target_of(copy.source_host_id)
        return FeedSource(copy.source_host_id, target, record.epoch, copy.kind is ReplicaKind.WARM)

    async def replicas_of(self, channel_id: bytes) -> ListedReplicas:
        await self._reach()
        record = self.world.record_of(channel_id)
        warm = [one for one in self._copies(channel_id) if one.kind is ReplicaKind.WARM]
        return ListedReplicas(record.host_id, record.epoch, [
            ListedReplica(KnownReplica(one.host_id, one.boot_incarnation, one.in_sync, one.added_index),
                          self.world.target_of(one.host_id), one.acknowledged)
            for one in warm
        ])  # fmt: skip

    async def add_replica(self, channel_id: bytes, epoch: int, *, acknowledged: bool) -> None:
        await self._reach()
        self.world.apply(add_replica(channel_id, epoch=epoch, warm=True, acknowledged=acknowledged))

    async def remove_replica(self, channel_id: bytes, epoch: int, host_id: bytes) -> None:
        await self._reach()
        self.world.apply(RemoveReplica(channel_id=channel_id, host_id=host_id, epoch=epoch))

    async def change(self, channel_id: bytes, epoch: int, change: ReplicaChange) -> None:
        await self._reach()
        self.world.apply(SetReplicaInSync(
            channel_id=channel_id, epoch=epoch, host_id=change.host_id, boot_incarnation=change.boot_incarnation,
            in_sync=change.in_sync, change_number=change.number, added_index=change.added_index,
        ))  # fmt: skip
        await self._reach()  # the answer may be lost

    async def other_hosts(self) -> list[OtherHost]:
        await self._reach()
        tables = self.world.log.directory.tables
        return [
            OtherHost(one.host_id, one.name, one.name, 0, len([*tables.channels_at(one.host_id)]))
            for one in tables.live_hosts()
            if one.host_id != self.host.identity.host_id
        ]

    async def kept_here(self, channel_id: bytes) -> FormerOwnerRole:
        await self._reach()
        return self._kept_at(channel_id, self.host.identity.host_id)

    def _kept_at(self, channel_id: bytes, host_id: bytes) -> FormerOwnerRole:
        if self.world.record_of(channel_id).host_id == host_id:
            return FormerOwnerRole.FALLBACK
        kinds = [one.kind for one in self._copies(channel_id) if one.host_id == host_id]
        return (
            {ReplicaKind.MOVE: FormerOwnerRole.FALLBACK, ReplicaKind.WARM: FormerOwnerRole.REPLICA}[kinds[0]]
            if kinds
            else FormerOwnerRole.NO
        )

    async def commit_one(self, move: MoveCommit) -> RecordedChannel:
        registered_index = self.host.registered_index if move.permit else 0
        await self._ask_for_commit([move])
        if (before := self.world.commits.get(move.request_id)) is not None:
            return before
        operation = CommitMove(
            channel_id=move.channel_id, epoch=move.epoch, to_host_id=self.host.identity.host_id,
            to_boot_incarnation=self.host.identity.boot_incarnation, to_registered_index=registered_index,
            permit=move.permit,
        )  # fmt: skip
        done = self.world.apply(operation)
        assert isinstance(done, MoveCommitted)
        record = self.world.commits[move.request_id] = recorded_channel(channel_record(done.channel))
        await self._answer_commit()
        return record

    async def commit_all(self, moves: Sequence[MoveCommit]) -> list[RecordedChannel]:
        registered_index = self.host.registered_index
        await self._ask_for_commit(moves)
        operation = CommitMoves(
            to_host_id=self.host.identity.host_id, to_boot_incarnation=self.host.identity.boot_incarnation,
            to_registered_index=registered_index,
            moves=tuple(MoveToCommit(channel_id=one.channel_id, epoch=one.epoch, permit=one.permit) for one in moves),
        )  # fmt: skip
        done = self.world.apply(operation)
        self.world.channels_per_entry_max = max(self.world.channels_per_entry_max, len(done.channels))
        await self._answer_commit()
        return [recorded_channel(channel_record(one)) for one in done.channels]

    async def _ask_for_commit(self, moves: Sequence[MoveCommit]) -> None:
        self.permits += [one.permit for one in moves if one.permit]
        if self.world.is_destination(self.host):
            self.world.at("commit is asked for")
        await self._reach()

    async def _answer_commit(self) -> None:
        if self.world.is_destination(self.host):
            self.world.at("committed")
        await self._reach()  # the answer may be lost

    async def release_all(self, moves: Sequence[FallbackRelease]) -> set[bytes]:
        self.world.at("removal is asked for")
        await self._reach()
        releases = tuple(MoveToRelease(channel_id=one.channel_id, epoch=one.epoch) for one in moves)
        done = self.world.apply(ReleaseMoves(host_id=self.host.identity.host_id, moves=releases))
        self.world.at("removed")
        await self._reach()
        return {*done.channel_ids}

    async def released_of(self, channel_ids: Sequence[bytes]) -> list[bytes]:
        await self._reach()
        return released(self.world.log.directory.tables, self.host.identity.host_id, channel_ids)
