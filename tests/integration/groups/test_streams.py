"""Streams of groups: signs of life, members that join and leave, cursors, and the counts of the status."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager
from typing import Any

import grpc
import pytest

from stampede_rt.v1 import channel_service_pb2, group_pb2
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt_channel_host.channels.subscriptions import subscription
from stampede_rt_channel_host.groups import writing
from tests.support.channel_host.group_rig import WAIT_SECONDS, CutReader, GroupedChannel, Host, running_cluster
from tests.support.channel_host.rig import MAX_INSTANT, MIN_INSTANT, S, between
from tests.support.clock import ManualClock


@pytest.fixture
async def host() -> AsyncIterator[Host]:
    async with running_cluster(ManualClock()) as cluster:
        yield await cluster.start("h1", b"host-number-one!")


@asynccontextmanager
async def busy(channel: GroupedChannel, start: int) -> AsyncIterator[None]:
    """Put one item after the other into the channel until the block ends, as fast as the host accepts them."""

    async def put() -> None:
        time = start
        while True:
            time += 1
            await channel.put(time)

    producer = asyncio.create_task(put())
    try:
        yield
    finally:
        producer.cancel()


def matching(left: GroupedChannel, group: group_pb2.GroupRecord, **fields: Any) -> Any:
    opening = pb.SubscribeMatchesOpen(
        group_id=group.group_id, per_channel_id=left.channel_id, epoch=1, tolerance_nanos=3, **fields
    )
    request = pb.SubscribeMatchesRequest(open=opening, credit_bytes=2**40)
    return left.host.groups.SubscribeMatches(iter((request,)))


@pytest.mark.parametrize("kind", ["items", "cuts", "matches"])
async def test_a_busy_stream_has_signs_of_life(host: Host, kind: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(writing, "SIGN_OF_LIFE_SECONDS", 0.05)
    monkeypatch.setattr(subscription, "PROGRESS_SECONDS", 0.05)
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    if kind == "items":
        call = (await left.subscribe(group).opened()).call
    elif kind == "cuts":
        reader = CutReader(host, group, decides=True)
        await reader.opened()
        call = reader.call
    else:
        call = matching(left, group)
        await call.read()
    async with busy(left, t), asyncio.timeout(WAIT_SECONDS):  # the right channel is silent, so the group shows no item
        for _ in range(3):
            assert await call.read() is not grpc.aio.EOF


async def test_a_subscription_gets_a_cursor_at_its_start(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    await left.put(t, t + 2, t + 4)
    await right.put(t + 3)
    former = left.subscribe(group)
    cursor = (await former.call.read()).cursor
    former.call.cancel()  # the subscription began after these items became visible, so it does not get them
    resumed = left.subscribe(group, cursor=cursor)
    assert not (await resumed.call.read()).HasField("gap")
    await left.put(t + 1, t + 6)
    await right.put(t + 5)
    assert await resumed.take(2) == [t + 1, t + 4]


async def test_a_cursor_is_sent_after_all_runs_that_became_visible_together(
    host: Host, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(subscription, "MESSAGE_BYTES_MAX", 1)  # one run in each message
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    for at in (10, 20, 30):
        await left.put(t + at)
    await right.put(t)
    call = (await left.subscribe(group).opened()).call
    await right.put(t + 5)  # the cut moves, but no item of the left channel becomes visible
    await right.put(t + 25)
    async with asyncio.timeout(WAIT_SECONDS):
        responses = [await call.read() for _ in range(3)]
    assert [len(response.runs) for response in responses] == [1, 1, 0]
    assert [response.HasField("cursor") for response in responses] == [False, False, True]


async def test_a_subscription_that_began_before_the_first_cut_begins_with_the_first_item(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    await left.put(t)
    former = left.subscribe(group)
    cursor = (await former.call.read()).cursor
    former.call.cancel()
    resumed = await left.subscribe(group, cursor=cursor).opened()
    await right.put(t + 1)
    await left.put(t + 2)
    assert await resumed.take(1) == [t]


async def test_matches_continue_at_their_first_cursor_if_no_match_had_come_yet(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    await left.put(t)
    former = matching(left, group)
    place = (await former.read()).cursor
    former.cancel()
    await left.put(t + 5)
    resumed = matching(left, group, after=place)
    await right.put(t + 9)
    found: list[pb.ItemMatch] = []
    async with asyncio.timeout(WAIT_SECONDS):
        while not found:
            found += (await resumed.read()).matches
    assert [list(one.item.run.time_unix_nano) for one in found] == [[t + 5]]


async def test_reads_of_a_member_through_the_group_end_when_the_member_leaves(host: Host) -> None:
    left, right = await host.open("left"), await host.open("right")
    group = host.directory.add_group("pair", [left, right])
    items = (await left.subscribe(group).opened()).call
    matches = matching(left, group)
    await matches.read()
    waiting = get_through(left, group)
    await until_counted(left, waiting_gets=1)
    await host.directory.called("Watch", times=1)
    host.directory.change_members(group.group_id, [right])
    async with asyncio.timeout(WAIT_SECONDS):
        assert "not a member" in (await items.details())
        assert "not a member" in (await matches.details())
        assert "not a member" in (await waiting.read()).error.message


async def test_cut_events_end_when_the_members_change_and_continue_with_the_new_members(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left])
    reader = CutReader(host, group, decides=True, spec_version=1)
    await reader.opened()
    await left.put(t, t + 2)
    event = await reader.event()
    while event.boundary.cut_unix_nano < t + 2:
        event = await reader.event()
    host.directory.change_members(group.group_id, [left, right], reported=False)
    anew = CutReader(host, group, decides=True, spec_version=2, after=event.cursor(group))
    assert {one.channel_id for one in (await anew.opened()).channels} == {left.channel_id, right.channel_id}
    async with asyncio.timeout(WAIT_SECONDS):
        assert await reader.call.code() is grpc.StatusCode.UNAVAILABLE
    await right.put(t + 3)
    await left.put(t + 5)
    event = await anew.event()
    assert (event.times(left), event.times(right)) == ([t + 2], [])


async def test_readers_through_a_group_are_counted_in_the_status_of_the_channel(host: Host) -> None:
    left, right = await host.open("left"), await host.open("right")
    group = host.directory.add_group("pair", [left, right])
    cuts = CutReader(host, group, decides=True)
    await cuts.opened()
    items = await left.subscribe(group).opened()
    matches = matching(left, group)
    await matches.read()
    waiting = get_through(left, group)
    await until_counted(left, subscriptions=3, waiting_gets=1)
    await until_counted(right, subscriptions=2, waiting_gets=0)
    for stream in (cuts.call, items.call, matches, waiting):
        stream.cancel()
    await until_counted(left, subscriptions=0, waiting_gets=0)
    await until_counted(right, subscriptions=0)


async def test_the_bytes_of_each_item_of_a_match_count_for_the_channel_of_the_item(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    matches = matching(left, group)
    await matches.read()
    await right.put(t)
    await left.put(t)
    await right.put(t + 10)
    async with asyncio.timeout(WAIT_SECONDS):
        while not (await matches.read()).matches:
            pass
    size = len(str(t))
    assert (await status_of(left)).counters.delivered_bytes == size
    assert (await status_of(right)).counters.delivered_bytes == size


async def status_of(channel: GroupedChannel) -> Any:
    request = channel_service_pb2.GetChannelStatusRequest(channel_id=channel.channel_id)
    return (await channel.host.channels.GetChannelStatus(request)).status


async def until_counted(channel: GroupedChannel, **expected: int) -> None:
    """Ask for the channel's status again and again, until it is as expected."""
    async with asyncio.timeout(WAIT_SECONDS):
        while True:
            status = await status_of(channel)
            if {name: getattr(status, name) for name in expected} == expected:
                return


def get_through(channel: GroupedChannel, group: group_pb2.GroupRecord) -> Any:
    """A get that waits for an item that the group does not show yet."""
    request = channel_service_pb2.GetRequest(
        call_id=1,
        channel_id=channel.channel_id,
        epoch=1,
        interval=between(MIN_INSTANT, MAX_INSTANT),
        group_id=group.group_id,
        wait_nanos=-1,
    )
    return channel.host.channels.Get(iter((request,)))
