"""Commands and results, to and from the bytes that the replicated log carries. Thin: no decision is made here."""

from __future__ import annotations

from google.protobuf.message import DecodeError

from stampede_rt.errors import InvalidArgument, StampedeError, VersionMismatch
from stampede_rt.v1 import directory_command_pb2 as pb
from stampede_rt_supernode.codecs.group_codec import (
    GROUP_OPERATIONS,
    GROUP_OUTCOMES,
    group_result_message,
    read_group_operation,
    read_group_result,
    write_group_operation,
)
from stampede_rt_supernode.codecs.host_codec import endpoint_message, endpoints_from, host_entry, host_from
from stampede_rt_supernode.codecs.peer_codec import (
    PEER_OPERATIONS,
    PEER_OUTCOMES,
    peer_result_message,
    read_peer_operation,
    read_peer_result,
    write_peer_operation,
)
from stampede_rt_supernode.codecs.queue_codec import (
    QUEUE_OPERATIONS,
    QUEUE_OUTCOMES,
    queue_result_message,
    read_queue_operation,
    read_queue_result,
    write_queue_operation,
)
from stampede_rt_supernode.codecs.record_codec import (
    channel_from,
    channel_record,
    policy_from,
    spec_of,
)
from stampede_rt_supernode.codecs.replica_codec import (
    REPLICA_OPERATIONS,
    REPLICA_OUTCOMES,
    read_replica_operation,
    read_replica_result,
    replica_result_message,
    write_replica_operation,
)
from stampede_rt_supernode.core.channels.commands import (
    ChannelDeleted,
    ChannelOpened,
    ChannelUpdated,
    DeleteChannel,
    OpenChannel,
    UpdateChannel,
)
from stampede_rt_supernode.core.cluster.commands import BeginTenure, MarkTime, TenureBegun, TimeMarked
from stampede_rt_supernode.core.commands import Command, Operation, Refused, Result
from stampede_rt_supernode.core.groups.commands import (
    DeleteGroup,
    GroupDeleted,
    GroupOpened,
    GroupUpdated,
    OpenGroup,
    UpdateGroup,
)
from stampede_rt_supernode.core.hosts.commands import (
    DeregisterHost,
    ExpireHost,
    HostDeregistered,
    HostExpired,
    HostRegistered,
    RegisterHost,
)
from stampede_rt_supernode.core.peers.commands import (
    DeregisterPeer,
    ExpirePeers,
    PeerDeregistered,
    PeerRegistered,
    PeersExpired,
    RegisterPeer,
)
from stampede_rt_supernode.core.queues.commands import (
    DeleteQueue,
    OpenQueue,
    QueueDeleted,
    QueueOpened,
    QueueUpdated,
    UpdateQueue,
)
from stampede_rt_supernode.core.replicas.commands import (
    AddReplica,
    RemoveReplica,
    ReplicaAdded,
    ReplicaInSyncSet,
    ReplicaRemoved,
    SetReplicaInSync,
)


def encode_command(command: Command) -> bytes:
    """The bytes to propose."""
    message = pb.DirectoryCommand(
        op_id=command.op_id, time_unix_nano=command.time_unix_nano, as_of_index=command.as_of_index
    )
    _write_operation(message, command.operation)
    return message.SerializeToString()


def _write_operation(message: pb.DirectoryCommand, operation: Operation) -> None:
    match operation:
        case OpenChannel():
            message.open_channel.CopyFrom(_open_message(operation))
        case UpdateChannel(channel_id=channel_id, epoch=epoch, policy=policy):
            update = pb.UpdateChannelCommand(channel_id=channel_id, epoch=epoch, spec=spec_of(policy))
            message.update_channel.CopyFrom(update)
        case DeleteChannel(channel_id=channel_id):
            message.delete_channel.CopyFrom(pb.DeleteChannelCommand(channel_id=channel_id))
        case RegisterHost():
            message.register_host.CopyFrom(_register_message(operation))
        case DeregisterHost(host_id=host_id, boot_incarnation=boot):
            leave = pb.DeregisterHostCommand(host_id=host_id, boot_incarnation=boot)
            message.deregister_host.CopyFrom(leave)
        case ExpireHost():
            message.expire_host.CopyFrom(_expire_message(operation))
        case BeginTenure():
            message.begin_tenure.CopyFrom(_tenure_message(operation))
        case MarkTime(tenure=tenure, after_index=after_index):
            message.mark_time.CopyFrom(pb.MarkTimeCommand(tenure=tenure, after_index=after_index))
        case OpenGroup() | UpdateGroup() | DeleteGroup():
            write_group_operation(message, operation)
        case AddReplica() | RemoveReplica() | SetReplicaInSync():
            write_replica_operation(message, operation)
        case OpenQueue() | UpdateQueue() | DeleteQueue():
            write_queue_operation(message, operation)
        case RegisterPeer() | DeregisterPeer() | ExpirePeers():
            write_peer_operation(message, operation)


def _open_message(operation: OpenChannel) -> pb.OpenChannelCommand:
    return pb.OpenChannelCommand(
        name=operation.name,
        spec=spec_of(operation.policy),
        create=operation.create,
        host_name=operation.host_name,
        new_channel_id=operation.new_channel_id,
        new_incarnation=operation.new_incarnation,
    )


def _register_message(operation: RegisterHost) -> pb.RegisterHostCommand:
    return pb.RegisterHostCommand(
        host_id=operation.host_id,
        name=operation.name,
        gatekeepers=[endpoint_message(endpoint) for endpoint in operation.gatekeepers],
        boot_incarnation=operation.boot_incarnation,
        version=operation.version,
        new_incarnation=operation.new_incarnation,
    )


def _expire_message(operation: ExpireHost) -> pb.ExpireHostCommand:
    return pb.ExpireHostCommand(
        host_id=operation.host_id,
        boot_incarnation=operation.boot_incarnation,
        registered_index=operation.registered_index,
        tenure=operation.tenure,
    )


def _tenure_message(operation: BeginTenure) -> pb.BeginTenureCommand:
    return pb.BeginTenureCommand(
        tenure=operation.tenure,
        supernode_id=operation.supernode_id,
        new_cluster_id=operation.new_cluster_id,
        new_lease_ttl_nanos=operation.new_lease_ttl_nanos,
        founded_anew=operation.founded_anew,
        takes_over=operation.takes_over,
    )


def decode_command(encoded: bytes) -> Command:
    """The command. Raises InvalidArgument for bytes that are none, VersionMismatch for a kind that is not known."""
    try:
        message = pb.DirectoryCommand.FromString(encoded)
    except DecodeError:
        raise InvalidArgument(
            "the log entry is no directory command; a supernode of another version wrote it"
        ) from None
    return Command(
        op_id=message.op_id,
        time_unix_nano=message.time_unix_nano,
        operation=_read_operation(message),
        as_of_index=message.as_of_index,
    )


def _read_operation(message: pb.DirectoryCommand) -> Operation:
    match message.WhichOneof("kind"):
        case "open_channel":
            return _read_open(message.open_channel)
        case "update_channel":
            m = message.update_channel
            return UpdateChannel(channel_id=m.channel_id, epoch=m.epoch, policy=policy_from(m.spec))
        case "delete_channel":
            return DeleteChannel(channel_id=message.delete_channel.channel_id)
        case "register_host":
            return _read_register(message.register_host)
        case "deregister_host":
            leave = message.deregister_host
            return DeregisterHost(host_id=leave.host_id, boot_incarnation=leave.boot_incarnation)
        case "expire_host":
            return _read_expire(message.expire_host)
        case "begin_tenure":
            return _read_tenure(message.begin_tenure)
        case "mark_time":
            return MarkTime(tenure=message.mark_time.tenure, after_index=message.mark_time.after_index)
        case kind if kind in GROUP_OPERATIONS:
            return read_group_operation(message)
        case kind if kind in REPLICA_OPERATIONS:
            return read_replica_operation(message)
        case kind if kind in QUEUE_OPERATIONS:
            return read_queue_operation(message)
        case kind if kind in PEER_OPERATIONS:
            return read_peer_operation(message)
        case _:
            raise VersionMismatch(
                "this supernode does not know that kind of directory command; bring all supernodes to one version"
            )


def _read_open(message: pb.OpenChannelCommand) -> OpenChannel:
    return OpenChannel(
        name=message.name,
        policy=policy_from(message.spec),
        create=message.create,
        host_name=message.host_name,
        new_channel_id=message.new_channel_id,
        new_incarnation=message.new_incarnation,
    )


def _read_register(message: pb.RegisterHostCommand) -> RegisterHost:
    return RegisterHost(
        host_id=message.host_id,
        name=message.name,
        gatekeepers=endpoints_from(message.gatekeepers),
        boot_incarnation=message.boot_incarnation,
        version=message.version,
        new_incarnation=message.new_incarnation,
    )


def _read_expire(message: pb.ExpireHostCommand) -> ExpireHost:
    return ExpireHost(
        host_id=message.host_id,
        boot_incarnation=message.boot_incarnation,
        registered_index=message.registered_index,
        tenure=message.tenure,
    )


def _read_tenure(message: pb.BeginTenureCommand) -> BeginTenure:
    return BeginTenure(
        tenure=message.tenure,
        supernode_id=message.supernode_id,
        new_cluster_id=message.new_cluster_id,
        new_lease_ttl_nanos=message.new_lease_ttl_nanos,
        founded_anew=message.founded_anew,
        takes_over=message.takes_over,
    )


def result_message(result: Result) -> pb.DirectoryResult:
    """A result as it travels."""
    match result:
        case Refused(reason=reason, message=message, metadata=metadata):
            refused = pb.RefusedResult(reason=reason, message=message, metadata=dict(metadata))
            return pb.DirectoryResult(refused=refused)
        case ChannelOpened(channel=channel, host=host, created=created):
            opened = pb.ChannelOpenedResult(channel=channel_record(channel), host=host_entry(host), created=created)
            return pb.DirectoryResult(channel_opened=opened)
        case ChannelUpdated(channel=channel):
            return pb.DirectoryResult(channel_updated=pb.ChannelUpdatedResult(channel=channel_record(channel)))
        case ChannelDeleted(channel=channel):
            return pb.DirectoryResult(channel_deleted=pb.ChannelDeletedResult(channel=channel_record(channel)))
        case HostRegistered(host=host, cluster_id=cluster_id):
            registered = pb.HostRegisteredResult(host=host_entry(host), cluster_id=cluster_id)
            return pb.DirectoryResult(host_registered=registered)
        case HostDeregistered():
            return pb.DirectoryResult(host_deregistered=pb.HostDeregisteredResult())
        case HostExpired(expired=expired):
            return pb.DirectoryResult(host_expired=pb.HostExpiredResult(expired=expired))
        case TenureBegun(tenure=tenure, cluster_id=cluster_id):
            return pb.DirectoryResult(tenure_begun=pb.TenureBegunResult(tenure=tenure, cluster_id=cluster_id))
        case TimeMarked(marked=marked):
            return pb.DirectoryResult(time_marked=pb.TimeMarkedResult(marked=marked))
        case GroupOpened() | GroupUpdated() | GroupDeleted():
            return group_result_message(result)
        case ReplicaAdded() | ReplicaRemoved() | ReplicaInSyncSet():
            return replica_result_message(result)
        case QueueOpened() | QueueUpdated() | QueueDeleted():
            return queue_result_message(result)
        case PeerRegistered() | PeerDeregistered() | PeersExpired():
            return peer_result_message(result)


def encode_result(result: Result) -> bytes:
    """The bytes that `apply` returns."""
    return result_message(result).SerializeToString(deterministic=True)


def read_result(message: pb.DirectoryResult) -> Result:
    """The result. Raises StampedeError for an outcome that is not known."""
    match message.WhichOneof("outcome"):
        case "refused":
            refused = message.refused
            return Refused(reason=refused.reason, message=refused.message, metadata=dict(refused.metadata))
        case "channel_opened":
            opened = message.channel_opened
            return ChannelOpened(
                channel=channel_from(opened.channel), host=host_from(opened.host), created=opened.created
            )
        case "channel_updated":
            return ChannelUpdated(channel=channel_from(message.channel_updated.channel))
        case "channel_deleted":
            return ChannelDeleted(channel=channel_from(message.channel_deleted.channel))
        case "host_registered":
            registered = message.host_registered
            return HostRegistered(host=host_from(registered.host), cluster_id=registered.cluster_id)
        case "host_deregistered":
            return HostDeregistered()
        case "host_expired":
            return HostExpired(expired=message.host_expired.expired)
        case "tenure_begun":
            return TenureBegun(tenure=message.tenure_begun.tenure, cluster_id=message.tenure_begun.cluster_id)
        case "time_marked":
            return TimeMarked(marked=message.time_marked.marked)
        case outcome if outcome in GROUP_OUTCOMES:
            return read_group_result(message)
        case outcome if outcome in REPLICA_OUTCOMES:
            return read_replica_result(message)
        case outcome if outcome in QUEUE_OUTCOMES:
            return read_queue_result(message)
        case outcome if outcome in PEER_OUTCOMES:
            return read_peer_result(message)
        case _:
            raise StampedeError("the replicated log gave a result that this supernode does not know; report this")


def decode_result(encoded: bytes) -> Result:
    """The result that `encode_result` wrote."""
    return read_result(pb.DirectoryResult.FromString(encoded))
