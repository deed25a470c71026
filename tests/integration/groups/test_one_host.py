"""Groups at one host, over gRPC with the generated stubs."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import grpc
import pytest

from stampede_rt.v1 import channel_service_pb2, error_pb2, group_pb2, item_pb2, time_pb2
from stampede_rt.v1 import group_service_pb2 as pb
from tests.support.channel_host.group_rig import CutReader, Host, running_cluster
from tests.support.channel_host.rig import MS, S, between
from tests.support.clock import ManualClock


@pytest.fixture
def clock() -> ManualClock:
    """Stands until a test moves it, so that nothing ages while the machine is busy."""
    return ManualClock()


@pytest.fixture
async def host(clock: ManualClock) -> AsyncIterator[Host]:
    async with running_cluster(clock) as cluster:
        yield await cluster.start("h1", b"host-number-one!")


async def test_a_group_shows_items_before_the_newest_item_of_its_reference(host: Host) -> None:
    text, audio, t = await host.open("text"), await host.open("audio"), host.now() - S
    group = host.directory.add_group(
        "tv", [text, audio], reference=group_pb2.GROUP_REFERENCE_CHANNEL, reference_channel_id=text.channel_id
    )
    await audio.put(*(t + at * MS for at in (0, 10, 20, 30)))
    await text.put(t + 15 * MS)
    times, summary = await audio.get(group)
    assert times == [t, t + 10 * MS]
    assert (summary.cut_unix_nano, summary.reason) == (t + 15 * MS, error_pb2.ABSENCE_REASON_HIDDEN)
    assert "text" in summary.detail
    assert (await text.get(group))[0] == []
    assert len((await audio.get())[0]) == 4  # a read outside the group shows all items
    assert not (await audio.get())[1].HasField("cut_unix_nano")


async def test_a_member_that_is_silent_for_long_is_left_out_until_its_next_item(host: Host, clock: ManualClock) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now()
    group = host.directory.add_group("pair", [left, right], idle_after_nanos=2 * S)
    await host.status(group)
    await left.put(t)
    await right.put(t + 1)
    clock.advance(3 * S)
    await left.put(t + 2 * S)
    status = await host.status(group)
    assert status.cut_unix_nano == t + 2 * S
    assert {one.times.channel_id for one in status.members if one.idle} == {right.channel_id}
    await right.put(t + 1)  # this item is late, and visible immediately
    assert (await right.get(group))[0] == [t + 1, t + 1]


async def test_a_waiting_get_is_answered_when_the_cut_reaches_its_interval(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    await left.put(t)
    waiting = asyncio.create_task(left.get(group, wait_nanos=-1))
    await right.put(t + 1)
    await left.put(t + 2)
    times, summary = await waiting
    assert times == [t]
    assert summary.cut_unix_nano > t


async def test_a_put_does_not_look_at_blocked_gets_that_it_cannot_release(host: Host) -> None:
    """In an earlier version, each put looked at all blocked gets.

    With 1000 gets a put took 129 ms, although the group did not show the item.
    """
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    await left.put(t, t + 5)
    await right.put(t + 1)
    assert (await left.get(group))[0] == [t]
    later = {"newer_than": item_pb2.ItemPosition(time_unix_nano=t), "match": time_pb2.MATCH_START, "wait_nanos": -1}
    waiting = [asyncio.create_task(left.get(group, **later)) for _ in range(200)]
    opened = host.host.store.find_any_epoch(left.channel_id)
    async with asyncio.timeout(45):
        while len(opened.group_gets) < 200:
            await host.status(group)
    known = host.host.groups.known(group.group_id)
    assert known is not None
    gets = known.gets[opened].gets
    looked_at = gets.looked_at
    for later_still in range(10, 20):
        await left.put(t + later_still)
    assert gets.looked_at == looked_at, "right holds the cut back"
    await right.put(t + 15)
    assert [(await one)[0] for one in waiting] == [[t + 5, t + 10, t + 11, t + 12, t + 13, t + 14]] * 200
    assert gets.looked_at == looked_at + 200
    assert not known.gets
    assert not opened.group_gets


async def test_a_blocked_get_ends_when_its_channel_leaves_the_group(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    await left.put(t)
    waiting = asyncio.create_task(left.get(group, wait_nanos=-1))
    opened = host.host.store.find_any_epoch(left.channel_id)
    async with asyncio.timeout(45):
        while not opened.group_gets:
            await host.status(group)
    host.directory.change_members(group.group_id, [right])
    with pytest.raises(AssertionError, match="is not a member of group pair"):
        await waiting


async def test_a_blocked_get_ends_at_its_timeout_and_names_the_member_that_holds_the_cut_back(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    await left.put(t)
    times, summary = await left.get(group, wait_nanos=20 * MS)
    assert (times, summary.reason) == ([], error_pb2.ABSENCE_REASON_HIDDEN)
    assert "right" in summary.detail


async def test_a_get_may_read_at_an_earlier_cut(host: Host) -> None:
    one, t = await host.open("one"), host.now() - S
    group = host.directory.add_group("alone", [one])
    await one.put(t, t + 1, t + 2)
    assert (await one.get(group))[0] == [t, t + 1]
    times, summary = await one.get(group, cut_unix_nano=t + 1)
    assert (times, summary.cut_unix_nano) == ([t], t + 1)


async def test_a_read_is_hidden_until_the_cut_reaches_the_cut_that_the_reader_has_seen(host: Host) -> None:
    one, t = await host.open("one"), host.now() - S
    group = host.directory.add_group("alone", [one])
    await one.put(t, t + 1)
    times, summary = await one.get(group, cut_floor_unix_nano=t + 5)
    assert (times, summary.reason) == ([], error_pb2.ABSENCE_REASON_HIDDEN)
    assert summary.cut_unix_nano == t + 1  # the floor that the reader sent has not raised the cut
    waiting = asyncio.create_task(one.get(group, cut_floor_unix_nano=t + 5, wait_nanos=10 * S))
    await one.put(t + 5)
    assert (await waiting)[0] == [t, t + 1]


async def test_a_read_through_an_unknown_group_or_of_a_channel_that_is_not_a_member_is_refused(host: Host) -> None:
    one, other = await host.open("one"), await host.open("other")
    group = host.directory.add_group("alone", [other])
    for group_id, reason in (
        (b"no group of this", error_pb2.ERROR_REASON_GROUP_NOT_FOUND),
        (b"short", error_pb2.ERROR_REASON_GROUP_NOT_FOUND),
        (group.group_id, error_pb2.ERROR_REASON_INVALID_ARGUMENT),
    ):
        request = channel_service_pb2.GetRequest(
            call_id=1, channel_id=one.channel_id, epoch=1, group_id=group_id, interval=between(0, 1)
        )
        responses = [response async for response in host.channels.Get(iter((request,)))]
        assert responses[-1].error.reason == reason


async def test_a_subscription_yields_items_in_the_order_in_which_they_become_visible(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    reading = await left.subscribe(group).opened()
    await left.put(t, t + 2, t + 4)
    await right.put(t + 3)
    assert await reading.take(2) == [t, t + 2]
    await left.put(t + 1)
    assert await reading.take(1) == [t + 1]
    await right.put(t + 9)
    await left.put(t + 9)
    assert await reading.take(1) == [t + 4]


async def test_a_subscription_to_the_newest_never_shows_hidden_items(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    await left.put(t, t + 2, t + 4)
    reading = await left.subscribe(group, mode=channel_service_pb2.SUBSCRIBE_MODE_NEWEST).opened()
    await right.put(t + 3)
    assert await reading.take(1) == [t + 2]


async def test_status_shows_the_member_that_holds_the_cut_back_each_position_and_the_hidden_items(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    await left.put(t, t + 2, t + 4)
    status = await host.status(group)
    assert not status.HasField("cut_unix_nano")
    assert list(status.waiting_on_channel_ids) == [right.channel_id]
    await right.put(t + 1)
    status = await host.status(group)
    of = {member.times.channel_id: member for member in status.members}
    assert (status.cut_unix_nano, list(status.waiting_on_channel_ids)) == (t + 1, [right.channel_id])
    assert (of[left.channel_id].lead_nanos, of[left.channel_id].hidden_items) == (3, 2)
    assert (of[right.channel_id].lead_nanos, of[right.channel_id].hidden_items) == (0, 1)
    assert not of[left.channel_id].window_too_short


async def test_get_cut_waits_for_the_cut_that_the_caller_has_seen_or_fails(host: Host) -> None:
    one, t = await host.open("one"), host.now() - S
    group = host.directory.add_group("alone", [one])
    await one.put(t)
    answer = await host.groups.GetCut(pb.GetCutRequest(group_id=group.group_id))
    assert (answer.floor.cut_unix_nano, answer.stalled) == (t, False)
    answer = await host.groups.GetCut(
        pb.GetCutRequest(group_id=group.group_id, cut_floor_unix_nano=t + 1, wait_nanos=10 * MS)
    )
    assert (answer.floor.cut_unix_nano, answer.stalled) == (t, True)
    assert list(answer.waiting_on_channel_ids) == [one.channel_id]


async def test_cut_events_have_each_item_once_and_late_items_separately(host: Host) -> None:
    text, video, t = await host.open("text"), await host.open("video"), host.now() - S
    group = host.directory.add_group("tv", [text, video])
    reader = CutReader(host, group, decides=True)
    await reader.opened()
    await video.put(*(t + at for at in range(10)))
    await text.put(t + 5)
    event = await reader.event()
    assert (event.boundary.cut_unix_nano, list(event.boundary.incomplete_channel_ids)) == (t + 5, [])
    assert (event.times(video), event.times(text)) == ([t + at for at in range(5)], [])
    await video.put(t + 2)
    await text.put(t + 8)
    event = await reader.event()
    assert (event.times(video), event.late(video), event.times(text)) == ([t + 5, t + 6, t + 7], [t + 2], [t + 5])
    resumed = CutReader(host, group, decides=True, after=event.cursor(group))
    await resumed.opened()
    await text.put(t + 9)
    assert (await resumed.event()).times(video) == [t + 8]


async def test_a_member_that_lags_is_waited_for_and_then_named(host: Host, clock: ManualClock) -> None:
    text, video, t = await host.open("text"), await host.open("video"), host.now() - S
    group = host.directory.add_group(
        "tv", [text, video], reference=group_pb2.GROUP_REFERENCE_CHANNEL, reference_channel_id=text.channel_id
    )
    reader = CutReader(host, group, decides=True, max_wait_nanos=30 * MS)
    await reader.opened()
    await text.put(t)
    waiting = asyncio.create_task(reader.event())
    while not waiting.done():
        clock.advance(MS)
        await host.status(group)
    event = await waiting
    assert list(event.boundary.incomplete_channel_ids) == [video.channel_id]
    await video.put(t - 1)
    await video.put(t + 2)
    await text.put(t + 1)
    assert (await reader.event()).late(video) == [t - 1]


async def test_a_position_of_another_incarnation_is_refused(host: Host) -> None:
    one = await host.open("one")
    group = host.directory.add_group("alone", [one])
    reader = CutReader(host, group, after=pb.CutCursor(incarnation=group.incarnation + 2, cut_unix_nano=5))
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await reader.opened()
    assert "incarnation" in (caught.value.details() or "")


async def test_matches_pair_the_nearest_items(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("stereo", [left, right])
    await left.put(t + 10, t + 20)
    opening = pb.SubscribeMatchesOpen(
        group_id=group.group_id,
        per_channel_id=left.channel_id,
        epoch=1,
        tolerance_nanos=3,
        after=pb.MatchCursor(after=item_pb2.ItemPosition(time_unix_nano=t)),
    )
    call = host.groups.SubscribeMatches(iter((pb.SubscribeMatchesRequest(open=opening, credit_bytes=2**40),)))
    await right.put(t + 9, t + 12, t + 40)
    found: list[pb.ItemMatch] = []
    async with asyncio.timeout(45):
        while len(found) < 2:
            response = await call.read()
            found += response.matches
    assert [list(one.item.run.time_unix_nano) for one in found] == [[t + 10], [t + 20]]
    assert [[near.position.time_unix_nano for near in one.matched] for one in found] == [[t + 9], []]
    assert found[0].matched[0].item.run.payloads == str(t + 9).encode()
    assert list(found[1].unmatched_channel_ids) == [right.channel_id]
    assert response.unmatched == 1


async def test_a_group_that_is_deleted_ends_its_streams(host: Host) -> None:
    one = await host.open("one")
    group = host.directory.add_group("alone", [one])
    reading = await one.subscribe(group).opened()
    await host.directory.called("Watch", times=1)
    host.directory.delete_group(group.group_id)
    with pytest.raises(grpc.aio.AioRpcError) as caught:
        await reading.take(1)
    assert caught.value.code() is grpc.StatusCode.NOT_FOUND


async def test_a_member_that_is_removed_releases_the_cut(host: Host) -> None:
    left, right, t = await host.open("left"), await host.open("right"), host.now() - S
    group = host.directory.add_group("pair", [left, right])
    await left.put(t, t + 1)
    assert (await left.get(group))[0] == []
    await host.directory.called("Watch", times=1)
    host.directory.change_members(group.group_id, [left])
    status = await host.until_cut(group, t + 1)
    assert [member.times.channel_id for member in status.members] == [left.channel_id]
