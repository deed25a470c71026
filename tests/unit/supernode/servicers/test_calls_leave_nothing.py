"""A supernode keeps only the counted things of a call. It leaves nothing to Python's collector."""

from __future__ import annotations

import asyncio
import gc
import secrets
from collections import Counter
from collections.abc import Awaitable, Callable

import pytest

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import directory_service_pb2 as pb
from stampede_rt.v1 import group_directory_service_pb2 as groups_pb
from stampede_rt.v1 import group_pb2
from stampede_rt.v1 import peer_service_pb2 as peers_pb
from stampede_rt.v1 import queue_directory_service_pb2 as queues_pb
from tests.support.supernode.node import Node, running_node

CALLS = 10


def new_id() -> bytes:
    return secrets.token_bytes(16)


async def make_channel(node: Node, name: str) -> None:
    made = await node.open(name)
    await node.stub.DeleteChannel(pb.DeleteChannelRequest(request_id=new_id(), channel_id=made.channel.channel_id))


async def make_queue(node: Node, name: str) -> None:
    made = await node.queues.OpenQueue(queues_pb.OpenQueueRequest(request_id=new_id(), name=name, create=True))
    await node.queues.DeleteQueue(queues_pb.DeleteQueueRequest(request_id=new_id(), queue_id=made.queue.queue_id))


async def make_group(node: Node, name: str) -> None:
    member = (await node.open("member")).channel.channel_id
    spec = group_pb2.GroupSpec(channel_ids=[member])
    made = await node.groups.OpenGroup(
        groups_pb.OpenGroupRequest(request_id=new_id(), name=name, spec=spec, create=True)
    )
    await node.groups.DeleteGroup(groups_pb.DeleteGroupRequest(request_id=new_id(), group_id=made.group.group_id))


async def make_peer(node: Node, name: str) -> None:
    peer_id = new_id()
    await node.peers.RegisterPeer(
        peers_pb.RegisterPeerRequest(request_id=new_id(), peer_id=peer_id, name=name, boot_incarnation=1)
    )
    await node.peers.DeregisterPeer(
        peers_pb.DeregisterPeerRequest(request_id=new_id(), peer_id=peer_id, boot_incarnation=1)
    )


async def open_nothing(node: Node, name: str) -> None:
    with pytest.raises(StampedeError):
        await node.open(name, create=False)


async def list_channels(node: Node, name: str) -> None:
    await node.stub.ListChannels(pb.ListChannelsRequest())


def is_of_a_call(found: object) -> bool:
    """Whether this object belongs to the supernode's side of a call."""
    if isinstance(found, asyncio.Task):
        return "HandleExceptions" in found.get_name()
    return type(found).__name__ == "RPCState" or type(found).__module__.startswith("stampede_rt_")


@pytest.mark.parametrize("work", [make_channel, make_queue, make_group, make_peer, open_nothing, list_channels])
async def test_no_call_makes_garbage_in_cycles(work: Callable[[Node, str], Awaitable[None]]) -> None:
    async with running_node() as node:
        await node.register(1, name="one")
        await work(node, "warm")
        gc.collect()
        gc.set_debug(gc.DEBUG_SAVEALL)
        try:
            for number in range(CALLS):
                await work(node, f"x/{number}")
            async with asyncio.timeout(20):
                while any("HandleExceptions" in one.get_name() for one in asyncio.all_tasks()):  # noqa: ASYNC110
                    await asyncio.sleep(0)
            gc.collect()
            left = Counter(type(one).__qualname__ for one in gc.garbage if is_of_a_call(one))
        finally:
            gc.set_debug(0)
            gc.garbage.clear()
        assert left == {}
