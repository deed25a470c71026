"""The directory: a state machine driven by the replicated log (paper, section 4.3). Pure.

Same commands at the same positions, same state and same results, on every replica. It knows no clock and no chance:
their values come stamped in the commands. A command that makes no sense is refused by a result, never by an exception.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from hashlib import blake2b
from typing import Any

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt_supernode.core import late_registrations
from stampede_rt_supernode.core.answered import Answer, Answered
from stampede_rt_supernode.core.channels.commands import DeleteChannel, OpenChannel, UpdateChannel
from stampede_rt_supernode.core.channels.transitions import (
    check_open,
    check_update,
    delete_channel,
    open_channel,
    update_channel,
)
from stampede_rt_supernode.core.cluster.commands import BeginTenure, MarkTime, TenureBegun, TimeMarked
from stampede_rt_supernode.core.commands import Command, Operation, Refused, Result, Success, subject_of
from stampede_rt_supernode.core.groups.commands import DeleteGroup, OpenGroup, UpdateGroup
from stampede_rt_supernode.core.groups.transitions import (
    check_open_group,
    check_update_group,
    delete_group,
    open_group,
    update_group,
)
from stampede_rt_supernode.core.hosts.commands import (
    DeregisterHost,
    ExpireHost,
    HostDeregistered,
    HostExpired,
    HostRegistered,
    RegisterHost,
)
from stampede_rt_supernode.core.hosts.transitions import check_register, deregister_host, expire_host, register_host
from stampede_rt_supernode.core.late_opens import check_in_time
from stampede_rt_supernode.core.peers.checks import check_register_peer
from stampede_rt_supernode.core.peers.commands import (
    DeregisterPeer,
    ExpirePeers,
    PeerDeregistered,
    PeersExpired,
    RegisterPeer,
)
from stampede_rt_supernode.core.peers.transitions import deregister_peer, expire_peers, register_peer
from stampede_rt_supernode.core.queues.commands import DeleteQueue, OpenQueue, UpdateQueue
from stampede_rt_supernode.core.queues.transitions import (
    check_open_queue,
    check_update_queue,
    delete_queue,
    open_queue,
    update_queue,
)
from stampede_rt_supernode.core.records import Channel, Group, Host, Peer, Queue, Replica
from stampede_rt_supernode.core.replicas.commands import AddReplica, RemoveReplica, SetReplicaInSync
from stampede_rt_supernode.core.replicas.transitions import (
    add_replica,
    check_add_replica,
    check_remove_replica,
    check_set_in_sync,
    remove_replica,
    set_in_sync,
)
from stampede_rt_supernode.core.tables import Tables
from stampede_rt_supernode.core.validation import check_id

FORMER_MAX = 16
DIGEST_BYTES = 16

_CHECKS: Mapping[type[Operation], Callable[[Any], None]] = {
    OpenChannel: check_open,
    UpdateChannel: check_update,
    DeleteChannel: lambda operation: check_id(operation.channel_id, "channel_id"),
    RegisterHost: check_register,
    DeregisterHost: lambda operation: check_id(operation.host_id, "host_id"),
    OpenGroup: check_open_group,
    UpdateGroup: check_update_group,
    DeleteGroup: lambda operation: check_id(operation.group_id, "group_id"),
    AddReplica: check_add_replica,
    RemoveReplica: check_remove_replica,
    SetReplicaInSync: check_set_in_sync,
    OpenQueue: check_open_queue,
    UpdateQueue: check_update_queue,
    DeleteQueue: lambda operation: check_id(operation.queue_id, "queue_id"),
    RegisterPeer: check_register_peer,
    DeregisterPeer: lambda operation: check_id(operation.peer_id, "peer_id"),
}  # what supernodes make themselves needs no check

# What an operation does that concerns the tables alone.
_TRANSITIONS: Mapping[type[Operation], Callable[[Tables, Any], Success]] = {
    OpenChannel: open_channel,
    UpdateChannel: update_channel,
    DeleteChannel: delete_channel,
    OpenGroup: open_group,
    UpdateGroup: update_group,
    DeleteGroup: delete_group,
    AddReplica: add_replica,
    RemoveReplica: remove_replica,
    SetReplicaInSync: set_in_sync,
    OpenQueue: open_queue,
    UpdateQueue: update_queue,
    DeleteQueue: delete_queue,
}


def check_operation(operation: Operation) -> None:
    """What can be said of `operation` without any state, so that what cannot be meant never comes into the log.

    An operation that passes fits into a log entry. Raises InvalidName or InvalidArgument.
    """
    check = _CHECKS.get(type(operation))
    if check is not None:
        check(operation)


class Directory:
    """Everything the supernodes agree on. `tenure` never falls. The first tenure sets the cluster's id and the
    TTL of its leases (0 until then) for good: a host and every later leader must mean the same by a lease."""

    def __init__(
        self,
        *,
        index: int = 0,
        tenure: int = 0,
        cluster_id: str = "",
        lease_ttl_nanos: int = 0,
        hosts: Iterable[Host] = (),
        channels: Iterable[Channel] = (),
        groups: Iterable[tuple[Group, tuple[bytes, ...]]] = (),
        replicas: Iterable[Replica] = (),
        queues: Iterable[Queue] = (),
        peers: Iterable[Peer] = (),
        answers: Iterable[Answer] = (),
        time_marks: Iterable[int] = (),
        former_cluster_ids: Iterable[str] = (),
        digest: bytes = b"",
    ) -> None:
        self.tenure = tenure
        self.cluster_id = cluster_id
        self.lease_ttl_nanos = lease_ttl_nanos
        # Of everything that was done: replicas that differ in it differ in their states. Empty: not known, as after a
        # snapshot without one.
        self.digest = digest or (b"" if index else bytes(DIGEST_BYTES))
        # The clusters whose place this one has taken.
        self.former_cluster_ids = tuple(former_cluster_ids)
        self.tables = Tables(hosts, channels, groups=groups, replicas=replicas, queues=queues, peers=peers, index=index)
        self.answered = Answered(answers, time_marks)

    @property
    def applied_index(self) -> int:
        """The last log position applied."""
        return self.tables.index

    def apply(self, index: int, command: Command) -> Result:
        """Apply the command at log position `index`, which grows and may skip. A refusal has changed nothing."""
        self.tables.begin(index)
        self.answered.forget_some()
        try:
            return self._answer(index, command)
        except StampedeError as error:
            return Refused.because(error)
        finally:
            self.tables.note_index(index)

    def note_done(self, index: int, result: bytes) -> None:
        """What was done at a position gave `result`; not called for refusals, which releases may word differently."""
        if self.digest:
            done = self.digest + index.to_bytes(8, "big") + result
            self.digest = blake2b(done, digest_size=DIGEST_BYTES).digest()

    def skip(self, index: int) -> None:
        """Log position `index` held nothing that this replica could read."""
        self.tables.note_index(index)

    def _answer(self, index: int, command: Command) -> Success:
        check_id(command.op_id, "request_id")
        subject = subject_of(command.operation)
        found = self.answered.find(command.op_id, subject)
        if found is not None:
            return found
        if isinstance(command.operation, MarkTime):
            return self._mark_time(index, command.operation)
        self.answered.check_in_time(command.as_of_index)
        if not isinstance(command.operation, (BeginTenure, ExpireHost, ExpirePeers)):  # no caller's, and never too many
            self.answered.check_room()
        result = self._do(command)
        self.answered.remember(Answer(command.op_id, index, subject, result))
        return result

    def _do(self, command: Command) -> Success:
        operation = command.operation
        if isinstance(operation, (OpenChannel, OpenGroup, OpenQueue)):
            check_in_time(self.tables, self.answered, operation, command.as_of_index)
        if isinstance(operation, (RegisterHost, RegisterPeer)):
            late_registrations.check_in_time(self.tables, operation, command.as_of_index)
        transition = _TRANSITIONS.get(type(operation))
        if transition is not None:
            return transition(self.tables, operation)
        match operation:
            case RegisterHost():
                self._check_founded()
                return HostRegistered(host=register_host(self.tables, operation), cluster_id=self.cluster_id)
            case DeregisterHost():
                deregister_host(self.tables, operation)
                return HostDeregistered()
            case ExpireHost():
                return HostExpired(expired=expire_host(self.tables, operation, self.tenure, command.time_unix_nano))
            case BeginTenure():
                return self._begin_tenure(operation)
            case RegisterPeer():
                self._check_founded()
                return register_peer(self.tables, operation, command.time_unix_nano, self.cluster_id)
            case DeregisterPeer():
                deregister_peer(self.tables, operation)
                return PeerDeregistered()
            case ExpirePeers():
                return PeersExpired(expired=expire_peers(self.tables, operation, self.tenure))
        raise NotImplementedError(f"nothing is known to do for a {type(operation).__name__}")

    def _mark_time(self, index: int, operation: MarkTime) -> TimeMarked:
        """It is not remembered: a repeated one does not follow the last mark any more."""
        marked = operation.tenure == self.tenure and operation.after_index == self.answered.last_mark
        if marked:
            self.answered.mark(index)
        return TimeMarked(marked=marked)

    def _check_founded(self) -> None:
        if not self.tenure:
            text = "the cluster is just being founded, and no leader grants leases yet; try again in a moment"
            raise Unavailable(text, reason="NO_QUORUM")

    def _begin_tenure(self, operation: BeginTenure) -> TenureBegun:
        """A leader's first entry; one of a leader that was already replaced is without effect."""
        self.tenure = max(self.tenure, operation.tenure)
        if operation.founded_anew or not self.cluster_id:
            if self.cluster_id and operation.takes_over and self.cluster_id != operation.new_cluster_id:
                self.former_cluster_ids = (*self.former_cluster_ids, self.cluster_id)[-FORMER_MAX:]
            self.cluster_id = operation.new_cluster_id
        self.lease_ttl_nanos = self.lease_ttl_nanos or operation.new_lease_ttl_nanos
        return TenureBegun(tenure=self.tenure, cluster_id=self.cluster_id)
