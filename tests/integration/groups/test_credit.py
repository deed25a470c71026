"""The credit that readers of cut events and matches give a host, over raw streams."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from typing import Any

import grpc
import pytest

from stampede_rt.v1 import channel_pb2, group_pb2
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt_channel_host.groups import writing
from tests.support.channel_host.group_rig import WAIT_SECONDS, CutReader, GroupedChannel, Host, running_cluster
from tests.support.channel_host.rig import S


@pytest.fixture
async def host() -> AsyncIterator[Host]:
    async with running_cluster() as cluster:
        yield await cluster.start("h1", b"host-number-one!")


async def a_pair(host: Host) -> tuple[GroupedChannel, GroupedChannel, group_pb2.GroupRecord]:
    policy = channel_pb2.RetentionPolicy(max_age_nanos=3600 * S)  # no item leaves while a busy machine does other work
    left, right = [await host.open(name, channel_pb2.ChannelSpec(retention=policy)) for name in ("left", "right")]
    return left, right, host.directory.add_group("pair", [left, right])


async def shown(channel: GroupedChannel, group: group_pb2.GroupRecord, time: int) -> None:
    """Wait until the group shows the channel up to that time."""
    async with asyncio.timeout(WAIT_SECONDS):
        while time not in (await channel.get(group))[0]:
            pass


async def deciding(host: Host, group: group_pb2.GroupRecord, credit: int) -> CutReader:
    reader = CutReader(host, group, decides=True, credit=credit)
    await reader.opened()
    return reader


async def test_items_that_become_visible_before_the_reader_asks_form_one_event(
    host: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(writing, "SIGN_OF_LIFE_SECONDS", 0.0)  # a sign of life would be due at any time
    left, right, group = await a_pair(host)
    t = host.now() - S
    reader = await deciding(host, group, credit=0)
    for number in range(20):
        await left.put(t + number)
        await right.put(t + number)
    await shown(left, group, t + 18)
    monkeypatch.undo()
    await reader.call.write(pb.SubscribeCutsRequest(credit=1))
    event = await reader.event()
    assert event.times(left) == event.times(right) == [t + number for number in range(19)]
    for number in range(20, 30):
        await left.put(t + number)
        await right.put(t + number)
    await shown(left, group, t + 28)
    await reader.call.write(pb.SubscribeCutsRequest(credit=1))
    assert (await reader.event()).times(left) == [t + number for number in range(19, 29)]


async def test_a_reader_that_half_closes_its_stream_gets_the_events_that_it_asked_for(host: Host) -> None:
    left, right, group = await a_pair(host)
    t = host.now() - S
    reader = await deciding(host, group, credit=1)
    await reader.call.done_writing()
    await left.put(t, t + 1)
    await right.put(t + 1)
    assert (await reader.event()).times(left) == [t]
    async with asyncio.timeout(WAIT_SECONDS):
        assert await reader.call.read() is grpc.aio.EOF


@pytest.mark.parametrize("decides", [True, False])
async def test_credit_goes_to_the_host_that_decides_and_boundaries_to_the_others(host: Host, decides: bool) -> None:
    _, _, group = await a_pair(host)
    reader = CutReader(host, group, decides=decides)
    await reader.opened()
    wrong = pb.CutBoundary(cut_unix_nano=1, incarnation=group.incarnation) if decides else None
    await reader.call.write(pb.SubscribeCutsRequest(boundary=wrong, credit=1))
    with pytest.raises(grpc.aio.AioRpcError, match="boundary"):
        await reader.event()


async def test_a_match_waits_for_credit_for_all_of_its_items(host: Host, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writing, "SIGN_OF_LIFE_SECONDS", 0.0)
    left, right, group = await a_pair(host)
    t = host.now() - S
    opening = pb.SubscribeMatchesOpen(
        group_id=group.group_id, per_channel_id=left.channel_id, epoch=1, tolerance_nanos=3
    )
    call: Any = host.groups.SubscribeMatches()
    await call.write(pb.SubscribeMatchesRequest(open=opening))
    async with asyncio.timeout(WAIT_SECONDS):
        assert (await call.read()).HasField("cursor")
        for number in range(10):
            await left.put(t + 10 * number)
            await right.put(t + 10 * number)
        monkeypatch.undo()
        await call.write(pb.SubscribeMatchesRequest(credit_bytes=1))
        first = (await call.read()).matches
        assert [list(one.item.run.time_unix_nano) for one in first] == [[t]]
        charge = 2 * (64 + len(str(t)))
        await call.write(pb.SubscribeMatchesRequest(credit_bytes=charge - 1))  # the credit is zero now
        await call.write(pb.SubscribeMatchesRequest(credit_bytes=charge + 1))
        matched = (await call.read()).matches
        assert [list(one.item.run.time_unix_nano) for one in matched] == [[t + 10], [t + 20]]
    call.cancel()


@pytest.mark.parametrize("requests", [[], [pb.SubscribeMatchesRequest(credit_bytes=1)]])
async def test_matches_begin_with_open(host: Host, requests: list[Any]) -> None:
    with pytest.raises(grpc.aio.AioRpcError, match="no open"):
        async for _ in host.groups.SubscribeMatches(iter(requests)):
            pass
