"""Records of the directory as values: a host decodes the parts that it uses, and passes on all of them."""

from __future__ import annotations

import dataclasses

import pytest

from stampede_rt.v1 import channel_pb2, directory_pb2, group_directory_service_pb2, group_pb2, queue_pb2
from stampede_rt.v1 import queue_directory_service_pb2 as queue_directory_pb
from stampede_rt_channel_host.cluster.records import (
    channel_message,
    group_message,
    policy_change,
    policy_change_message,
    queue_message,
    recorded_change,
    recorded_channel,
    recorded_group,
    recorded_queue,
    resolved_group,
    resolved_queue,
)
from stampede_rt_channel_host.core.queue import QueueLimits

NEWER_FIELD = b"\xfa\xff\x03\x03new"  # field 8191, which no release has
UNKNOWN = 77
CHANNEL = channel_pb2.ChannelRecord(
    channel_id=b"c" * 16, name="cam", host_id=b"h" * 16, epoch=3, incarnation=9, spec_version=2,
    spec=channel_pb2.ChannelSpec(retention=channel_pb2.RetentionPolicy(max_items=5)),
)  # fmt: skip
QUEUE = queue_pb2.QueueRecord(
    queue_id=b"q" * 16, name="jobs", host_id=b"h" * 16, epoch=3, incarnation=9, spec_version=2,
    spec=queue_pb2.QueueSpec(max_items=5),
)  # fmt: skip
GROUP = group_pb2.GroupRecord(
    group_id=b"g" * 16, name="both", incarnation=9, spec_version=2, spec=group_pb2.GroupSpec(channel_ids=[b"c" * 16])
)


def newer(message: bytes) -> bytes:
    return message + NEWER_FIELD


def test_records_keep_the_fields_of_newer_releases() -> None:
    channel = channel_pb2.ChannelRecord.FromString(newer(CHANNEL.SerializeToString()))
    assert channel_message(recorded_channel(channel)).SerializeToString() == newer(CHANNEL.SerializeToString())
    queue = queue_pb2.QueueRecord.FromString(newer(QUEUE.SerializeToString()))
    assert queue_message(recorded_queue(queue)).SerializeToString() == newer(QUEUE.SerializeToString())
    group = group_pb2.GroupRecord.FromString(newer(GROUP.SerializeToString()))
    assert group_message(recorded_group(group)).SerializeToString() == newer(GROUP.SerializeToString())


def test_a_changed_record_keeps_values_that_this_release_does_not_know() -> None:
    spec = channel_pb2.ChannelSpec.FromString(newer(channel_pb2.ChannelSpec(on_full=UNKNOWN).SerializeToString()))
    change = policy_change(spec)
    assert change.stated.on_full is None
    assert policy_change_message(change) == spec


def test_records_cannot_be_changed() -> None:
    for record in (recorded_channel(CHANNEL), recorded_queue(QUEUE), recorded_group(GROUP)):
        with pytest.raises(dataclasses.FrozenInstanceError):
            record.name = "other"  # type: ignore[misc]


def test_a_record_holds_the_owner_and_the_settings_of_a_channel() -> None:
    channel, queue, group = recorded_channel(CHANNEL), recorded_queue(QUEUE), recorded_group(GROUP)
    assert (channel.name, channel.host_id, channel.epoch, channel.policy.max_items) == ("cam", b"h" * 16, 3, 5)
    assert (queue.queue_id, queue.incarnation, queue.policy.max_items) == (b"q" * 16, 9, 5)
    assert (group.definition.members, group.incarnation, group.spec_version) == (frozenset([b"c" * 16]), 9, 2)


def test_a_full_queue_blocks_if_its_policy_has_an_unknown_value() -> None:
    unknown = queue_pb2.QueueRecord(spec=queue_pb2.QueueSpec(on_full=UNKNOWN))
    assert QueueLimits.of(recorded_queue(unknown).policy).on_full == "block"


@pytest.mark.parametrize(
    ("alive", "targets", "target"), [(True, ["a:1", "b:1"], "a:1"), (True, [], None), (False, ["a:1"], None)]
)
def test_only_a_live_host_has_a_target(alive: bool, targets: list[str], target: str | None) -> None:
    host = directory_pb2.HostRecord(
        host_id=b"h" * 16, name="h", alive=alive, gatekeepers=[directory_pb2.Endpoint(target=one) for one in targets]
    )
    assert resolved_queue(queue_directory_pb.ResolveQueueResponse(queue=QUEUE, host=host)).target == target
    response = group_directory_service_pb2.ResolveGroupResponse(group=GROUP, channels=[CHANNEL], hosts=[host])
    group = resolved_group(response)
    assert group.targets == ({} if target is None else {b"h" * 16: target})
    assert (group.host_names, [one.name for one in group.channels.values()]) == ({b"h" * 16: "h"}, ["cam"])


def test_a_change_of_the_directory_names_its_subject() -> None:
    removed = directory_pb2.CHANGE_KIND_REMOVED
    queue_change = recorded_change(directory_pb2.DirectoryChange(kind=removed, queue=QUEUE))
    assert (queue_change.removed, queue_change.queue, queue_change.channel) == (True, recorded_queue(QUEUE), None)
    channel_change = recorded_change(directory_pb2.DirectoryChange(channel=CHANNEL))
    assert (channel_change.removed, channel_change.channel) == (False, recorded_channel(CHANNEL))
    assert recorded_change(directory_pb2.DirectoryChange(group=GROUP)).group_id == b"g" * 16
    host_change = recorded_change(directory_pb2.DirectoryChange(host=directory_pb2.HostRecord(name="h")))
    assert (host_change.channel, host_change.queue, host_change.group_id) == (None, None, None)
