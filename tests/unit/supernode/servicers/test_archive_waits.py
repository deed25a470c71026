"""The time that a recorded channel waits for its unreachable host before another host takes the channel over."""

from __future__ import annotations

from stampede_rt.errors import Unavailable
from stampede_rt.v1 import channel_pb2, directory_pb2
from stampede_rt.v1 import directory_service_pb2 as pb
from tests.support.supernode.node import Node, running_node
from tests.support.supernode.operations import id_of

RECORDED = channel_pb2.ChannelSpec(archive_nanos=3600 * 10**9)
WAIT_SECONDS = 60


async def register(node: Node, number: int, *, boot: int = 1) -> None:
    request = pb.RegisterHostRequest(
        request_id=id_of(100 * number + boot),
        host_id=id_of(number),
        name=f"host-{number}",
        gatekeepers=[directory_pb2.Endpoint(target=f"localhost:{7000 + number}")],
        boot_incarnation=boot,
        registration_epoch=boot - 1,
        has_archive=True,
        archive_wait_nanos=WAIT_SECONDS * 10**9,
    )
    await node.call(node.stub.RegisterHost(request, timeout=10))


async def leave(node: Node, number: int, *, boot: int = 1) -> None:
    request = pb.DeregisterHostRequest(
        request_id=id_of(200 * number + boot), host_id=id_of(number), boot_incarnation=boot
    )
    await node.call(node.stub.DeregisterHost(request, timeout=10))


async def opened_at(node: Node) -> str:
    """The name of the host at which the channel is opened. Empty while the channel waits for its host.

    If the call fails with Unavailable for another reason, returns this reason.
    """
    try:
        return (await node.open("recorded")).host.name
    except Unavailable as error:
        return "" if error.reason == "NO_HOST" else error.reason


async def test_a_wait_begins_with_the_first_call_and_ends_with_its_time_or_the_return_of_the_host() -> None:
    async with running_node() as node:
        await register(node, 1)
        await node.open("recorded", spec=RECORDED)
        await leave(node, 1)
        await node.pass_seconds(10 * WAIT_SECONDS)  # no caller opens the channel, so the wait has not begun
        await register(node, 2)
        before = node.log.index
        for _ in range(2):
            assert await opened_at(node) == ""
            node.clock.advance((WAIT_SECONDS // 2) * 10**9 - 1)
        assert node.log.index == before, "a caller that waits adds no entry to the log"
        await register(node, 1, boot=2)
        assert await opened_at(node) == "host-1"
        await leave(node, 1, boot=2)
        node.clock.advance(WAIT_SECONDS * 10**9)
        assert await opened_at(node) == ""
        node.clock.advance(WAIT_SECONDS * 10**9)
        assert await opened_at(node) == "host-2"
