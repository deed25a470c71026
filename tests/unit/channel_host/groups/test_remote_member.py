"""A match follows a member at another host: the moment at which an idle member counts as having passed an instant."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import grpc
import pytest

from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import channel_service_pb2_grpc, item_pb2
from stampede_rt_channel_host.groups import remote_member
from stampede_rt_channel_host.groups.remote_member import AHEAD_ITEMS, RemoteMember
from tests.support.waiting import until

OPENED = pb.SubscribeResponse(opened=pb.SubscriptionOpened(incarnation=1))
PROGRESS = pb.SubscribeResponse(progress=pb.SubscriptionProgress(host_time_unix_nano=1))


def items(first: int, count: int) -> pb.SubscribeResponse:
    run = item_pb2.ItemRun(
        time_unix_nano=range(first, first + count), payload_length_bytes=[1] * count, first_seq=first
    )
    return pb.SubscribeResponse(runs=[item_pb2.DeliveredRun(run=run)])


def passed(member: RemoteMember, instant: int) -> bool:
    return member.has_passed(instant, 0, is_idle=True)


async def test_a_match_waits_for_the_archived_items_of_an_idle_member() -> None:
    member = RemoteMember(b"m" * 16, 0)
    assert not passed(member, 5), "the member's host has not answered"
    member._take(OPENED)
    assert not passed(member, 5)
    member._take(items(1, 4))
    assert passed(member, 4)
    assert not passed(member, 5), "more items may come from the archive"
    member._take(PROGRESS)
    assert passed(member, 10**9), "the archive has no more items"
    assert not member.has_passed(10**9, 0, is_idle=False)


async def test_an_idle_member_without_items_has_passed_each_instant() -> None:
    member = RemoteMember(b"m" * 16, 0)
    member._take(OPENED)
    member._take(PROGRESS)
    assert passed(member, 10**9)


async def test_the_host_of_an_idle_member_gets_credit_for_all_of_its_archive() -> None:
    member = RemoteMember(b"m" * 16, 0)
    requests = member._requests()
    await anext(requests)
    member._take(OPENED)
    for first in range(1, 5 * AHEAD_ITEMS, AHEAD_ITEMS):
        assert member._credit > 0
        member._take(items(first, AHEAD_ITEMS))
        member.track.forget_before(first)
        assert passed(member, first + AHEAD_ITEMS - 1)
        assert not passed(member, first + AHEAD_ITEMS)
        async with asyncio.timeout(20):
            await anext(requests)


async def test_a_match_does_not_wait_long_for_an_idle_member_whose_host_does_not_answer(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(remote_member, "UNANSWERED_SECONDS_MAX", 0.0)
    assert passed(RemoteMember(b"m" * 16, 0), 5)


class EndingOnce(channel_service_pb2_grpc.ChannelServiceServicer):
    """A host that ends the first subscription immediately. It keeps the requests of each subscription."""

    def __init__(self) -> None:
        self.calls: list[list[pb.SubscribeRequest]] = []

    async def Subscribe(  # noqa: N802
        self, request_iterator: AsyncIterator[pb.SubscribeRequest], context: object
    ) -> AsyncIterator[pb.SubscribeResponse]:
        requests: list[pb.SubscribeRequest] = []
        self.calls.append(requests)
        requests.append(await anext(request_iterator))
        yield OPENED
        if len(self.calls) > 1:
            async for request in request_iterator:
                requests.append(request)


async def test_a_member_whose_stream_ended_gets_its_credit_on_the_next_stream(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, the requests of the ended stream went on waiting, and took the credit of the next
    stream.
    """
    monkeypatch.setattr(remote_member, "PAUSE_SECONDS", 0.0)
    server, host = grpc.aio.server(), EndingOnce()
    channel_service_pb2_grpc.add_ChannelServiceServicer_to_server(host, server)
    port = server.add_insecure_port("127.0.0.1:0")
    await server.start()
    member = RemoteMember(b"m" * 16, 0)
    member.target = f"127.0.0.1:{port}"
    following = asyncio.create_task(member.keep(grpc.aio.insecure_channel, lambda: None))
    try:
        await until(lambda: len(host.calls) > 1 and host.calls[1])
        member._credit = 0
        member._wants_more.set()
        await until(lambda: len(host.calls[1]) > 1)
    finally:
        following.cancel()
        await server.stop(None)
