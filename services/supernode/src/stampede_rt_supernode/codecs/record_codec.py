"""Converts channels from and to their messages, and changes of the directory to their messages. Makes no decisions."""

from __future__ import annotations

from functools import lru_cache
from sys import intern
from typing import Any

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import channel_pb2, directory_pb2, peer_pb2
from stampede_rt.values.model import Ack, OnFull, Policy
from stampede_rt_supernode.codecs.group_codec import group_record
from stampede_rt_supernode.codecs.host_codec import host_record
from stampede_rt_supernode.codecs.peer_codec import peer_record
from stampede_rt_supernode.codecs.queue_codec import queue_record
from stampede_rt_supernode.core.records import (
    AccessChange,
    ChangeKind,
    ChannelRecord,
    DirectoryChange,
    GroupRecord,
    HostRecord,
    PeerRecord,
    QueueRecord,
)

_ON_FULL_TO_WIRE: dict[OnFull | None, channel_pb2.OnFull] = {
    None: channel_pb2.ON_FULL_UNSPECIFIED,
    "drop_oldest": channel_pb2.ON_FULL_DROP_OLDEST,
    "block": channel_pb2.ON_FULL_BLOCK,
    "reject": channel_pb2.ON_FULL_REJECT,
}
_ON_FULL_FROM_WIRE = {wire: name for name, wire in _ON_FULL_TO_WIRE.items()}
_ACK_TO_WIRE: dict[Ack | None, channel_pb2.Ack] = {
    None: channel_pb2.ACK_UNSPECIFIED,
    "host": channel_pb2.ACK_HOST,
    "disk": channel_pb2.ACK_DISK,
    "replica": channel_pb2.ACK_REPLICA,
}
_ACK_FROM_WIRE = {wire: name for name, wire in _ACK_TO_WIRE.items()}
_CHANGE_KINDS = {
    ChangeKind.ADDED: directory_pb2.CHANGE_KIND_ADDED,
    ChangeKind.UPDATED: directory_pb2.CHANGE_KIND_UPDATED,
    ChangeKind.REMOVED: directory_pb2.CHANGE_KIND_REMOVED,
}
_LIMIT_FIELDS = ("max_age_nanos", "max_items", "max_bytes", "consumers", "max_age_unconsumed_nanos")
_SPEC_FIELDS = (
    "max_future_nanos", "content_type", "max_item_bytes", "overlap_nanos", "archive_nanos", "archive_bytes", "replicas",
    "min_replicas",
)  # fmt: skip
_POLICIES_MAX = 1024


def policy_from(spec: channel_pb2.ChannelSpec) -> Policy:
    """The policy in a message. Raises InvalidArgument for an unknown value of on_full or ack."""
    if spec.on_full not in _ON_FULL_FROM_WIRE:
        raise InvalidArgument(f"on_full is {spec.on_full}, which this version does not know; see OnFull for the values")
    if spec.ack not in _ACK_FROM_WIRE:
        raise InvalidArgument(f"ack is {spec.ack}, which this version does not know; see Ack for the values")
    limits = {name: _optional(spec.retention, name) for name in _LIMIT_FIELDS}
    others = {name: _optional(spec, name) for name in _SPEC_FIELDS}
    return Policy(on_full=_ON_FULL_FROM_WIRE[spec.on_full], ack=_ACK_FROM_WIRE[spec.ack], **limits, **others)


def _optional(message: channel_pb2.ChannelSpec | channel_pb2.RetentionPolicy, name: str) -> Any:
    return getattr(message, name) if message.HasField(name) else None


def spec_of(policy: Policy) -> channel_pb2.ChannelSpec:
    """The message of a policy. Leaves out fields that are None."""
    return channel_pb2.ChannelSpec(
        retention=channel_pb2.RetentionPolicy(**{name: getattr(policy, name) for name in _LIMIT_FIELDS}),
        on_full=_ON_FULL_TO_WIRE[policy.on_full],
        ack=_ACK_TO_WIRE[policy.ack],
        **{name: getattr(policy, name) for name in _SPEC_FIELDS},
    )


def channel_from(record: channel_pb2.ChannelRecord) -> ChannelRecord:
    """The channel of a record that this codec wrote."""
    return ChannelRecord(
        channel_id=record.channel_id,
        name=record.name,
        host_id=record.host_id,
        epoch=record.epoch,
        incarnation=record.incarnation,
        policy=_held_policy(record.spec.SerializeToString()),
        policy_version=record.spec_version,
        proxy_host_ids=tuple(record.proxy_host_ids),
        created_by=intern(record.created_by),  # one string object for all records of a caller
        first_incarnation=record.first_incarnation,
    )


@lru_cache(_POLICIES_MAX)
def _held_policy(spec: bytes) -> Policy:
    """The policy in an encoded spec, one object for all channels with the same spec.

    It takes more time to decode a policy than the rest of a record. The supernodes limited the length of each spec
    before they stored it, so the keys of the cache are short.
    """
    return policy_from(channel_pb2.ChannelSpec.FromString(spec))


def channel_record(channel: ChannelRecord) -> channel_pb2.ChannelRecord:
    """The message of a channel."""
    return channel_pb2.ChannelRecord(
        channel_id=channel.channel_id,
        name=channel.name,
        host_id=channel.host_id,
        epoch=channel.epoch,
        incarnation=channel.incarnation,
        spec=_held_spec(channel.policy),
        spec_version=channel.policy_version,
        proxy_host_ids=channel.proxy_host_ids,
        created_by=channel.created_by,
        first_incarnation=channel.first_incarnation,
    )


@lru_cache(_POLICIES_MAX)
def _held_spec(policy: Policy) -> channel_pb2.ChannelSpec:
    """The spec of a policy, cached as in `_held_policy`.

    Callers must not change the message, but copy it into a record.
    """
    return spec_of(policy)


def change_message(change: DirectoryChange) -> directory_pb2.DirectoryChange:
    """The message of a change of a channel, host, group, queue or rule of access, for the watchers of these changes."""
    message = directory_pb2.DirectoryChange(index=change.index, kind=_CHANGE_KINDS[change.kind])
    match change.subject:
        case ChannelRecord() as channel:
            message.channel.CopyFrom(channel_record(channel))
        case HostRecord() as host:
            message.host.CopyFrom(host_record(host))
        case GroupRecord() as group:
            message.group.CopyFrom(group_record(group))
        case QueueRecord() as queue:
            message.queue.CopyFrom(queue_record(queue))
        case AccessChange(version=version):
            message.access.version = version
        case PeerRecord(peer_id=peer_id):
            raise AssertionError(
                f"peer {peer_id.hex()} came to the watchers of channels; only watchers of peers get it"
            )
    return message


def peer_change_message(change: DirectoryChange) -> peer_pb2.PeerChange:
    """The change as watchers of peers get it."""
    assert isinstance(change.subject, PeerRecord)  # the buffer of peers' changes holds nothing else
    return peer_pb2.PeerChange(index=change.index, kind=_CHANGE_KINDS[change.kind], peer=peer_record(change.subject))
