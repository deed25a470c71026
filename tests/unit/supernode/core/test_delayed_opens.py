"""A request to open that arrives late, after its caller already got an answer, creates nothing.

The scenario: a caller opens `cam`, gets no answer, and tries again at another supernode. `cam` exists by then, so the
supernode answers the second attempt immediately, without an entry in the log. Another caller deletes `cam`. Then the
directory applies the first attempt, which was under way all the time. In an earlier version, the directory kept no
record of the request, so the first attempt created the channel again.
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Callable
from typing import Any

import pytest
import pytest_asyncio

from stampede_rt.cluster.request_age import age_metadata
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1 import group_directory_service_pb2 as groups_pb
from stampede_rt.v1 import group_pb2
from stampede_rt.v1 import queue_directory_service_pb2 as queues_pb
from stampede_rt_supernode.codecs.command_codec import decode_result
from stampede_rt_supernode.core.channels.commands import ChannelDeleted, ChannelOpened
from stampede_rt_supernode.core.cluster.feature_levels import FREED_GROUPS_LEVEL
from stampede_rt_supernode.core.commands import Operation, RefusedOperation, Result
from stampede_rt_supernode.core.groups.commands import GroupOpened
from stampede_rt_supernode.core.kept_answers import MARKS_KEPT
from stampede_rt_supernode.core.queues.commands import QueueOpened
from tests.support.supernode.node import Node, reason_of, running_node
from tests.support.supernode.operations import (
    Log,
    delete,
    delete_group,
    delete_queue,
    id_of,
    open_channel,
    open_group,
    open_queue,
    register,
)


@pytest_asyncio.fixture
async def node() -> AsyncIterator[Node]:
    async with running_node() as node:
        await node.register(1, name="one")
        yield node


async def open_and_delete(node: Node, request: pb.OpenChannelRequest) -> None:
    """Another caller creates the channel, the second attempt of `request` opens it, and the other caller deletes it."""
    made = await node.open("cam")
    index = node.log.index
    assert (await node.stub.OpenChannel(request)).channel == made.channel
    assert node.log.index == index, "the directory answered without an entry in the log"
    gone = pb.DeleteChannelRequest(request_id=id_of(6), channel_id=made.channel.channel_id)
    await node.stub.DeleteChannel(gone)


async def is_there(node: Node) -> bool:
    return bool((await node.stub.ListChannels(pb.ListChannelsRequest())).channels)


async def test_an_entry_proposed_before_the_deletion_does_not_create_the_channel_again(node: Node) -> None:
    request = pb.OpenChannelRequest(request_id=id_of(5), name="cam", create=True)
    node.log.holds = True
    first = node.stub.OpenChannel(request, timeout=10)
    await node.log.held_one.wait()
    first.cancel()
    await open_and_delete(node, request)
    (late,) = (decode_result(result) for result in node.log.apply_held())
    assert isinstance(late, RefusedOperation)
    assert (late.reason, late.metadata["channel"]) == ("AMBIGUOUS", "cam")
    assert not await is_there(node)


async def test_a_request_that_a_supernode_delayed_does_not_create_a_deleted_channel_again(node: Node) -> None:
    request = pb.OpenChannelRequest(request_id=id_of(5), name="cam", create=True)
    held_up = node.log.reads_may_end
    held_up.clear()
    node.log.read_waits.clear()
    first = asyncio.ensure_future(reason_of(node.stub.OpenChannel(request, timeout=10)))
    await node.log.read_waits.wait()
    node.log.reads_may_end = asyncio.Event()
    node.log.reads_may_end.set()
    await open_and_delete(node, request)
    held_up.set()
    assert (await first).reason == "AMBIGUOUS"
    assert not await is_there(node)
    assert (await node.stub.OpenChannel(request)).created, "a caller that still waits asks again"


@pytest.mark.parametrize("kind", ["channel", "group", "queue"])
async def test_a_request_that_the_network_delayed_has_no_effect_after_its_repetition_was_answered(
    node: Node, kind: str
) -> None:
    """In an earlier version, the log had no entry for the repetition.

    The held request then opened the deleted thing again.
    """
    member = (await node.open("member")).channel.channel_id
    spec = group_pb2.GroupSpec(channel_ids=[member])
    held: dict[str, tuple[Any, Any]] = {
        "channel": (node.stub.OpenChannel, pb.OpenChannelRequest(request_id=id_of(5), name="x", create=True)),
        "group": (
            node.groups.OpenGroup,
            groups_pb.OpenGroupRequest(request_id=id_of(5), name="x", spec=spec, create=True),
        ),
        "queue": (node.queues.OpenQueue, queues_pb.OpenQueueRequest(request_id=id_of(5), name="x", create=True)),
    }
    opening, request = held[kind]
    other = type(request)()
    other.CopyFrom(request)
    other.request_id = id_of(6)
    made = await opening(other)
    assert made.created
    answer = await opening(request, metadata=age_metadata(0.5))
    await delete_made(node, made)
    assert await opening(request) == answer
    assert not answer.created
    tables = node.replica.read(lambda directory: directory.tables)
    assert "x" not in {"channel": tables.channel_ids, "group": tables.groups.ids, "queue": tables.queues.ids}[kind]


async def delete_made(node: Node, made: Any) -> None:
    match made:
        case pb.OpenChannelResponse():
            await node.stub.DeleteChannel(
                pb.DeleteChannelRequest(request_id=id_of(7), channel_id=made.channel.channel_id)
            )
        case groups_pb.OpenGroupResponse():
            await node.groups.DeleteGroup(
                groups_pb.DeleteGroupRequest(request_id=id_of(7), group_id=made.group.group_id)
            )
        case queues_pb.OpenQueueResponse():
            await node.queues.DeleteQueue(
                queues_pb.DeleteQueueRequest(request_id=id_of(7), queue_id=made.queue.queue_id)
            )


@pytest.fixture
def log() -> Log:
    log = Log()
    log.apply(register(1, name="one"))
    return log


def deletion_of(log: Log, opened: Result) -> Operation:
    match opened:
        case ChannelOpened(channel=channel):
            return delete(channel.channel_id)
        case GroupOpened(group=group):
            return delete_group(group.group_id)
        case QueueOpened(queue=queue):
            return delete_queue(queue.queue_id)
    raise AssertionError(opened)


@pytest.mark.parametrize("kind", ["channel", "group", "queue"])
def test_an_open_is_late_if_its_channel_was_deleted_after_the_request(log: Log, kind: str) -> None:
    member = log.apply(open_channel("member"))
    assert isinstance(member, ChannelOpened)
    openings: dict[str, Operation] = {
        "channel": open_channel("x"),
        "group": open_group("x", (member.channel.channel_id,)),
        "queue": open_queue("x"),
    }
    opening = openings[kind]
    asked_index = log.directory.applied_index
    log.apply(deletion_of(log, log.apply(opening)))
    late = log.apply(opening, as_of_index=asked_index)
    assert isinstance(late, RefusedOperation)
    assert (late.reason, late.metadata) == ("AMBIGUOUS", {kind: "x"})
    assert not isinstance(log.apply(opening, as_of_index=log.directory.applied_index), RefusedOperation)


@pytest.mark.parametrize("kind", ["channel", "group", "queue"])
def test_the_deletion_of_another_name_does_not_make_an_open_late(log: Log, kind: str) -> None:
    """In an earlier version, a client that made and deleted groups without a pause prevented all other clients from
    making groups.
    """
    log.directory.feature_level = FREED_GROUPS_LEVEL
    members = {name: log.apply(open_channel(name)) for name in ("kept", "gone")}
    kept, gone = (one.channel.channel_id for one in members.values() if isinstance(one, ChannelOpened))
    make: dict[str, Callable[[str], Operation]] = {
        "channel": open_channel,
        "group": lambda name: open_group(name, (kept,)),
        "queue": open_queue,
    }
    log.apply(open_group("with it", (gone,)))
    asked_index = log.directory.applied_index
    log.apply(deletion_of(log, log.apply(make[kind]("y"))))
    log.apply(delete(gone))
    assert not isinstance(log.apply(make[kind]("x"), as_of_index=asked_index), RefusedOperation)


def test_a_group_that_was_deleted_with_its_last_channel_is_not_made_again(log: Log) -> None:
    log.directory.feature_level = FREED_GROUPS_LEVEL
    kept, gone = (log.apply(open_channel(name)) for name in ("kept", "gone"))
    assert isinstance(kept, ChannelOpened)
    assert isinstance(gone, ChannelOpened)
    asked_index = log.directory.applied_index
    log.apply(open_group("x", (gone.channel.channel_id,)))
    log.apply(delete(gone.channel.channel_id))
    late = log.apply(open_group("x", (kept.channel.channel_id,)), as_of_index=asked_index)
    assert isinstance(late, RefusedOperation)
    assert late.reason == "AMBIGUOUS"


def test_below_the_level_of_freed_groups_every_deletion_may_have_freed_the_name(log: Log) -> None:
    log.directory.feature_level = FREED_GROUPS_LEVEL - 1
    kept, gone = (log.apply(open_channel(name)) for name in ("kept", "gone"))
    assert isinstance(kept, ChannelOpened)
    assert isinstance(gone, ChannelOpened)
    asked_index = log.directory.applied_index
    assert log.apply(delete(gone.channel.channel_id)) == ChannelDeleted(channel=gone.channel)
    assert isinstance(log.apply(open_group("x", (kept.channel.channel_id,)), as_of_index=asked_index), RefusedOperation)


def test_an_open_is_late_if_its_kept_answer_may_have_been_dropped(log: Log) -> None:
    asked_index = log.directory.applied_index
    for _ in range(MARKS_KEPT):
        log.mark_time()
    late = log.apply(open_channel("x"), as_of_index=asked_index)
    assert isinstance(late, RefusedOperation)
    assert late.reason == "AMBIGUOUS"
    assert isinstance(log.apply(open_channel("x"), as_of_index=log.directory.applied_index), ChannelOpened)


def test_an_open_of_an_existing_channel_is_never_late(log: Log) -> None:
    opened = log.apply(open_channel("x"))
    assert isinstance(opened, ChannelOpened)
    log.apply(delete(opened.channel.channel_id))
    there = log.apply(open_channel("x"))
    assert isinstance(there, ChannelOpened)
    repeated = log.apply(open_channel("x"), as_of_index=1)
    assert isinstance(repeated, ChannelOpened)
    assert (repeated.channel, repeated.created) == (there.channel, False)
