"""Converts the directory's records from and to protobuf. The stores of the host keep the converted values."""

from __future__ import annotations

from functools import lru_cache
from sys import intern
from typing import TypeVar

from stampede_rt.v1 import (
    channel_pb2,
    directory_pb2,
    group_directory_service_pb2,
    group_pb2,
    queue_directory_service_pb2,
    queue_pb2,
)
from stampede_rt.values.model import Policy
from stampede_rt.wire.queues import queue_policy_from_spec
from stampede_rt.wire.records import policy_from_spec
from stampede_rt_channel_host.core.group import MAX_LEAD_NANOS_DEFAULT, GroupDefinition
from stampede_rt_channel_host.core.records import (
    PolicyChange,
    RecordedChange,
    RecordedChannel,
    RecordedGroup,
    RecordedQueue,
    ResolvedGroup,
    ResolvedQueue,
)

SHARED_VALUES_MAX = 4096
Value = TypeVar("Value", bytes, Policy)


@lru_cache(maxsize=SHARED_VALUES_MAX)
def _shared(value: Value) -> Value:
    """An equal object that several records share. A host with 100,000 channels has few different policies."""
    return value


def recorded_channel(message: channel_pb2.ChannelRecord) -> RecordedChannel:
    """The channel of a message."""
    return RecordedChannel(
        channel_id=message.channel_id,
        name=message.name,
        host_id=_shared(message.host_id),
        epoch=message.epoch,
        incarnation=message.incarnation,
        spec_version=message.spec_version,
        policy=_shared(policy_from_spec(message.spec)),
        message=message.SerializeToString(),
        created_by=intern(message.created_by),  # one string object for all records of a caller
        copy_host_ids=tuple(message.proxy_host_ids),
        first_incarnation=message.first_incarnation,
    )


def channel_message(record: RecordedChannel) -> channel_pb2.ChannelRecord:
    """The record as the directory sent it, with the fields of newer releases."""
    return channel_pb2.ChannelRecord.FromString(record.message)


def policy_change(spec: channel_pb2.ChannelSpec) -> PolicyChange:
    """The policy change of a message."""
    return PolicyChange(stated=policy_from_spec(spec), message=spec.SerializeToString())


def policy_change_message(change: PolicyChange) -> channel_pb2.ChannelSpec:
    """The change as its caller sent it."""
    return channel_pb2.ChannelSpec.FromString(change.message)


def recorded_queue(message: queue_pb2.QueueRecord) -> RecordedQueue:
    """The queue of a message."""
    return RecordedQueue(
        queue_id=message.queue_id,
        name=message.name,
        host_id=message.host_id,
        epoch=message.epoch,
        incarnation=message.incarnation,
        spec_version=message.spec_version,
        policy=queue_policy_from_spec(message.spec),
        message=message.SerializeToString(),
        is_mailbox=message.HasField("mailbox_peer_id"),
        mailbox_peer_name=message.mailbox_peer_name,
        mailbox_owner=message.mailbox_owner,
        created_by=intern(message.created_by or message.mailbox_owner),
    )


def queue_message(record: RecordedQueue) -> queue_pb2.QueueRecord:
    """The record as the directory sent it, with the fields of newer releases."""
    return queue_pb2.QueueRecord.FromString(record.message)


def resolved_queue(message: queue_directory_service_pb2.ResolveQueueResponse) -> ResolvedQueue:
    """A queue and the address of its owner, from a message."""
    host = message.host
    target = host.gatekeepers[0].target if host.alive and host.gatekeepers else None
    return ResolvedQueue(queue=recorded_queue(message.queue), target=target)


def recorded_group(message: group_pb2.GroupRecord) -> RecordedGroup:
    """The group of a message."""
    spec = message.spec
    fixed = spec.reference == group_pb2.GROUP_REFERENCE_CHANNEL
    definition = GroupDefinition(
        members=frozenset(spec.channel_ids),
        reference=spec.reference_channel_id if fixed else None,
        by_end=spec.bound == group_pb2.GROUP_BOUND_END,
        idle_after_nanos=spec.idle_after_nanos if spec.HasField("idle_after_nanos") else None,
        max_lead_nanos=spec.max_lead_nanos if spec.HasField("max_lead_nanos") else MAX_LEAD_NANOS_DEFAULT,
        incarnation=message.incarnation,
        spec_version=message.spec_version,
    )
    return RecordedGroup(
        group_id=message.group_id,
        name=message.name,
        definition=definition,
        message=message.SerializeToString(),
        created_by=intern(message.created_by),
    )


def group_message(record: RecordedGroup) -> group_pb2.GroupRecord:
    """The record as the directory sent it, with the fields of newer releases."""
    return group_pb2.GroupRecord.FromString(record.message)


def resolved_group(message: group_directory_service_pb2.ResolveGroupResponse) -> ResolvedGroup:
    """A group, its channels and their hosts, from a message."""
    hosts = message.hosts
    return ResolvedGroup(
        group=recorded_group(message.group),
        channels={one.channel_id: recorded_channel(one) for one in message.channels},
        targets={one.host_id: one.gatekeepers[0].target for one in hosts if one.alive and one.gatekeepers},
        host_names={one.host_id: one.name for one in hosts},
    )


def recorded_change(message: directory_pb2.DirectoryChange) -> RecordedChange:
    """The change of a message. Leaves out changes of hosts and peers, because no part of a host needs them."""
    return RecordedChange(
        removed=message.kind == directory_pb2.CHANGE_KIND_REMOVED,
        channel=recorded_channel(message.channel) if message.HasField("channel") else None,
        queue=recorded_queue(message.queue) if message.HasField("queue") else None,
        group_id=message.group.group_id if message.HasField("group") else None,
        is_of_access=message.HasField("access"),
    )
