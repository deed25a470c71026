"""Commands for tests, with ids that are short to write. The same arguments give the same command."""

from __future__ import annotations

from dataclasses import replace
from itertools import count
from typing import Any

from stampede_rt.values.model import Policy
from stampede_rt_supernode.core.channels.commands import DeleteChannel, OpenChannel, UpdateChannel
from stampede_rt_supernode.core.cluster.commands import BeginTenure, MarkTime
from stampede_rt_supernode.core.cluster.feature_levels import FIRST_LEVEL
from stampede_rt_supernode.core.commands import Command, Operation, Result
from stampede_rt_supernode.core.directory import Directory
from stampede_rt_supernode.core.groups.commands import DeleteGroup, OpenGroup, UpdateGroup
from stampede_rt_supernode.core.hosts.commands import DeregisterHost, ExpireHost, RegisterHost
from stampede_rt_supernode.core.peers.commands import DeregisterPeer, ExpirePeers, PeerLease, RegisterPeer
from stampede_rt_supernode.core.queues.commands import DeleteQueue, OpenQueue, UpdateQueue
from stampede_rt_supernode.core.records import Endpoint, GroupSpec, QueueSpec, ReplicaKind
from stampede_rt_supernode.core.replicas.commands import AddReplica, RemoveReplica, SetReplicaInSync

TTL_NANOS = 5 * 10**9


def id_of(number: int) -> bytes:
    return number.to_bytes(16, "big")


class Log:
    """Applies commands to a directory at growing positions, with a new operation id each unless one is given."""

    def __init__(self, *, founded: bool = True, level: int = FIRST_LEVEL) -> None:
        """`level`: the feature level from the start."""
        self.directory = Directory()
        self._index = 0
        self._op_ids = count(1)
        self.time_unix_nano = 0
        if founded:
            self.apply(replace(begin_tenure(1), new_feature_level=level))

    def apply(self, operation: Operation, op_id: bytes | None = None, as_of_index: int = 0, caller: str = "") -> Result:
        self._index += 1
        op_id = op_id or id_of(10_000 + next(self._op_ids))
        command = Command(
            op_id=op_id,
            time_unix_nano=self.time_unix_nano,
            operation=operation,
            as_of_index=as_of_index,
            caller=caller,
        )
        return self.directory.apply(self._index, command)

    def mark_time(self, tenure: int = 1) -> Result:
        """Apply a leader's mark of time."""
        return self.apply(MarkTime(tenure=tenure, after_index=self.directory.kept_answers.last_mark))


def begin_tenure(tenure: int = 1) -> BeginTenure:
    return BeginTenure(tenure=tenure, supernode_id="s1", new_cluster_id=f"c{tenure}", new_lease_ttl_nanos=TTL_NANOS)


def register(
    number: int,
    *,
    name: str = "",
    boot: int = 1,
    epoch: int | None = None,
    incarnation: int = 900,
    move_key: bytes = b"",
) -> RegisterHost:
    """`epoch` None: the epoch of a process that knows all processes with lower boots."""
    return RegisterHost(
        host_id=id_of(number),
        name=name or f"host-{number}",
        gatekeepers=(Endpoint(target=f"localhost:{7000 + number}", zone="lab"),),
        boot_incarnation=boot,
        version="0.1.0",
        new_incarnation=incarnation,
        registration_epoch=boot - 1 if epoch is None else epoch,
        move_key=move_key,
    )


def deregister(number: int, *, boot: int = 1) -> DeregisterHost:
    return DeregisterHost(host_id=id_of(number), boot_incarnation=boot)


def expire(number: int, *, boot: int = 1, registered_index: int, tenure: int = 1) -> ExpireHost:
    return ExpireHost(host_id=id_of(number), boot_incarnation=boot, registered_index=registered_index, tenure=tenure)


_made = count(2**64)  # above every number that a test uses, so that ids are unique and ordered


def open_channel(
    name: str, *, host: str = "", create: bool = True, incarnation: int = 77, **policy: int | str
) -> OpenChannel:
    return OpenChannel(
        name=name,
        policy=Policy(**policy),  # type: ignore[arg-type]
        create=create,
        host_name=host,
        new_channel_id=id_of(next(_made)),
        new_incarnation=incarnation,
    )


def update(channel_id: bytes, epoch: int, **policy: int | str) -> UpdateChannel:
    return UpdateChannel(channel_id=channel_id, epoch=epoch, policy=Policy(**policy))  # type: ignore[arg-type]


def delete(channel_id: bytes) -> DeleteChannel:
    return DeleteChannel(channel_id=channel_id)


def open_group(
    name: str, members: tuple[bytes, ...] | None, *, create: bool = True, incarnation: int = 88, **spec: Any
) -> OpenGroup:
    """`members` None: the command has no GroupSpec."""
    return OpenGroup(
        name=name,
        spec=None if members is None else GroupSpec(channel_ids=members, **spec),
        create=create,
        new_group_id=id_of(next(_made)),
        new_incarnation=incarnation,
    )


def update_group(
    group_id: bytes, *, add: tuple[bytes, ...] = (), remove: tuple[bytes, ...] = (), version: int | None = None
) -> UpdateGroup:
    return UpdateGroup(group_id=group_id, add_channel_ids=add, remove_channel_ids=remove, spec_version=version)


def delete_group(group_id: bytes) -> DeleteGroup:
    return DeleteGroup(group_id=group_id)


def add_replica(
    channel_id: bytes, host: int = 0, *, epoch: int = 1, warm: bool = False, source: int = 0, acknowledged: bool = False
) -> AddReplica:
    """`host` or `source` 0: the command does not name it."""
    return AddReplica(
        channel_id=channel_id,
        epoch=epoch,
        host_id=id_of(host) if host else b"",
        kind=ReplicaKind.WARM if warm else ReplicaKind.PROXY,
        source_host_id=id_of(source) if source else b"",
        acknowledged=acknowledged,
    )


def remove_replica(channel_id: bytes, host: int) -> RemoveReplica:
    return RemoveReplica(channel_id=channel_id, host_id=id_of(host))


def set_in_sync(
    channel_id: bytes, host: int, in_sync: bool = True, *, epoch: int = 1, boot: int = 1
) -> SetReplicaInSync:
    return SetReplicaInSync(
        channel_id=channel_id, epoch=epoch, host_id=id_of(host), boot_incarnation=boot, in_sync=in_sync
    )


def open_queue(name: str, *, host: str = "", create: bool = True, incarnation: int = 66, **spec: Any) -> OpenQueue:
    return OpenQueue(
        name=name,
        spec=QueueSpec(**spec),
        create=create,
        host_name=host,
        new_queue_id=id_of(next(_made)),
        new_incarnation=incarnation,
    )


def update_queue(queue_id: bytes, epoch: int = 1, **spec: Any) -> UpdateQueue:
    return UpdateQueue(queue_id=queue_id, epoch=epoch, spec=QueueSpec(**spec))


def delete_queue(queue_id: bytes) -> DeleteQueue:
    return DeleteQueue(queue_id=queue_id)


def register_peer(
    number: int,
    name: str = "",
    *,
    boot: int = 1,
    epoch: int | None = None,
    proof: int = 0,
    incarnation: int = 55,
    **fields: Any,
) -> RegisterPeer:
    """`proof` 0: none. `epoch` None: the epoch of a process that knows all processes with lower boots."""
    return RegisterPeer(
        peer_id=id_of(number),
        name=name,
        boot_incarnation=boot,
        proof_sha256=bytes([proof]) * 32 if proof else b"",
        new_mailbox_id=id_of(next(_made)),
        new_incarnation=incarnation,
        registration_epoch=boot - 1 if epoch is None else epoch,
        **fields,
    )


def deregister_peer(number: int, *, boot: int = 1) -> DeregisterPeer:
    return DeregisterPeer(peer_id=id_of(number), boot_incarnation=boot)


def expire_peers(*leases: tuple[int, int], boot: int = 1, tenure: int = 1) -> ExpirePeers:
    """`leases`: (number, registered index) of each."""
    ended = (PeerLease(peer_id=id_of(one), boot_incarnation=boot, registered_index=at) for one, at in leases)
    return ExpirePeers(leases=tuple(ended), tenure=tenure)
