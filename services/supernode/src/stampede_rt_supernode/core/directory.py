"""The directory: a state machine driven by the replicated log (paper, section 4.3). Pure.

Same commands at the same positions, same state and same results, on every replica. It knows no clock and no chance:
their values come stamped in the commands. A command that makes no sense is refused by a result, never by an exception.
"""

from __future__ import annotations

from collections.abc import Iterable

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt_supernode.core.answered import Answer, Answered
from stampede_rt_supernode.core.channel_transitions import (
    check_open,
    check_update,
    delete_channel,
    open_channel,
    update_channel,
)
from stampede_rt_supernode.core.commands import (
    BeginTenure,
    Command,
    Deed,
    DeleteChannel,
    DeregisterHost,
    ExpireHost,
    GroupDeed,
    GroupSuccess,
    HostDeregistered,
    HostExpired,
    HostRegistered,
    OpenChannel,
    Refused,
    RegisterHost,
    ReplicaDeed,
    ReplicaSuccess,
    Result,
    Success,
    TenureBegun,
    UpdateChannel,
    subject_of,
)
from stampede_rt_supernode.core.groups.commands import DeleteGroup, OpenGroup, UpdateGroup
from stampede_rt_supernode.core.groups.transitions import (
    check_open_group,
    check_update_group,
    delete_group,
    open_group,
    update_group,
)
from stampede_rt_supernode.core.host_transitions import check_register, deregister_host, expire_host, register_host
from stampede_rt_supernode.core.records import Channel, Group, Host, Replica
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


def check_deed(deed: Deed) -> None:
    """What can be said of `deed` without any state, so that what cannot be meant never comes into the log.

    A deed that passes fits into a log entry. Raises InvalidName or InvalidArgument.
    """
    match deed:
        case OpenChannel():
            check_open(deed)
        case UpdateChannel():
            check_update(deed)
        case DeleteChannel(channel_id=channel_id):
            check_id(channel_id, "channel_id")
        case RegisterHost():
            check_register(deed)
        case DeregisterHost(host_id=host_id):
            check_id(host_id, "host_id")
        case ExpireHost() | BeginTenure():
            pass  # made by supernodes themselves
        case OpenGroup():
            check_open_group(deed)
        case UpdateGroup():
            check_update_group(deed)
        case DeleteGroup(group_id=group_id):
            check_id(group_id, "group_id")
        case AddReplica():
            check_add_replica(deed)
        case RemoveReplica():
            check_remove_replica(deed)
        case SetReplicaInSync():
            check_set_in_sync(deed)


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
        answers: Iterable[Answer] = (),
    ) -> None:
        self.tenure = tenure
        self.cluster_id = cluster_id
        self.lease_ttl_nanos = lease_ttl_nanos
        self.tables = Tables(hosts, channels, groups=groups, replicas=replicas, index=index)
        self.answered = Answered()
        for answer in answers:
            self.answered.remember(answer)

    @property
    def applied_index(self) -> int:
        """The last log position applied."""
        return self.tables.index

    def apply(self, index: int, command: Command) -> Result:
        """Apply the command at log position `index`, which grows and may skip. A refusal has changed nothing."""
        self.tables.index = index
        self.answered.forget_before(index)
        try:
            return self._answer(index, command)
        except StampedeError as error:
            return Refused.because(error)
        finally:
            self.tables.changes.note_index(index)

    def skip(self, index: int) -> None:
        """Log position `index` held nothing that this replica could read."""
        self.tables.index = index
        self.tables.changes.note_index(index)

    def _answer(self, index: int, command: Command) -> Success:
        check_id(command.op_id, "request_id")
        subject = subject_of(command.deed)
        found = self.answered.find(command.op_id, subject)
        if found is not None:
            return found
        result = self._do(command.deed)
        self.answered.remember(Answer(command.op_id, index, subject, result))
        return result

    def _do(self, deed: Deed) -> Success:
        match deed:
            case OpenGroup() | UpdateGroup() | DeleteGroup():
                return _do_to_group(self.tables, deed)
            case AddReplica() | RemoveReplica() | SetReplicaInSync():
                return _do_to_replica(self.tables, deed)
            case OpenChannel():
                return open_channel(self.tables, deed)
            case UpdateChannel():
                return update_channel(self.tables, deed)
            case DeleteChannel():
                return delete_channel(self.tables, deed)
            case RegisterHost():
                self._check_founded()
                return HostRegistered(host=register_host(self.tables, deed), cluster_id=self.cluster_id)
            case DeregisterHost():
                deregister_host(self.tables, deed)
                return HostDeregistered()
            case ExpireHost():
                return HostExpired(expired=expire_host(self.tables, deed, self.tenure))
            case BeginTenure():
                return self._begin_tenure(deed)

    def _check_founded(self) -> None:
        if not self.tenure:
            text = "the cluster is just being founded, and no leader grants leases yet; try again in a moment"
            raise Unavailable(text, reason="NO_QUORUM")

    def _begin_tenure(self, deed: BeginTenure) -> TenureBegun:
        """A leader's first entry; one of a leader that was already replaced is without effect."""
        self.tenure = max(self.tenure, deed.tenure)
        self.cluster_id = self.cluster_id or deed.new_cluster_id
        self.lease_ttl_nanos = self.lease_ttl_nanos or deed.new_lease_ttl_nanos
        return TenureBegun(tenure=self.tenure, cluster_id=self.cluster_id)


def _do_to_group(tables: Tables, deed: GroupDeed) -> GroupSuccess:
    match deed:
        case OpenGroup():
            return open_group(tables, deed)
        case UpdateGroup():
            return update_group(tables, deed)
        case DeleteGroup():
            return delete_group(tables, deed)


def _do_to_replica(tables: Tables, deed: ReplicaDeed) -> ReplicaSuccess:
    match deed:
        case AddReplica():
            return add_replica(tables, deed)
        case RemoveReplica():
            return remove_replica(tables, deed)
        case SetReplicaInSync():
            return set_in_sync(tables, deed)
