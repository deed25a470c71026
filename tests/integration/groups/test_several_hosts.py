"""Groups whose channels are at different hosts: real gRPC between them, in one process."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager

import grpc
import pytest

from stampede_rt.v1 import error_pb2, group_pb2, item_pb2
from stampede_rt.v1 import group_service_pb2 as pb
from stampede_rt_channel_host.groups.exchange import FLOORS_MAX_PER_HOST
from tests.support.channel_host.group_rig import WAIT_SECONDS, Cluster, CutReader, GroupedChannel, running_cluster
from tests.support.channel_host.rig import MAX_INSTANT, MS, S
from tests.support.clock import ManualClock

LOWER, HIGHER = b"a-lower-host-id!", b"b-higher-host-id"


class Pair:
    """A channel at each of two hosts, and a group of both."""

    def __init__(self, cluster: Cluster, left: GroupedChannel, right: GroupedChannel) -> None:
        self.cluster = cluster
        self.left, self.right = left, right
        self.group = cluster.directory.add_group("pair", [left, right])
        self.start = left.host.now() - S

    async def until_synced(self, cut: int) -> None:
        for host in (self.left.host, self.right.host):
            await host.until_cut(self.group, cut)


@asynccontextmanager
async def pair_of(*host_ids: bytes) -> AsyncIterator[Pair]:
    async with running_cluster(ManualClock()) as cluster:
        hosts = [await cluster.start(f"h{number}", host_id) for number, host_id in enumerate(host_ids)]
        yield Pair(cluster, await hosts[0].open("left"), await hosts[1].open("right"))


@pytest.fixture
async def pair() -> AsyncIterator[Pair]:
    async with pair_of(LOWER, HIGHER) as pair:
        yield pair


@pytest.mark.parametrize("first_host_id", [LOWER, HIGHER])
async def test_a_host_learns_of_a_group_from_another_host_that_serves_it(first_host_id: bytes) -> None:
    other = HIGHER if first_host_id == LOWER else LOWER
    async with pair_of(first_host_id, other) as pair:
        t = pair.start
        await pair.left.put(t, t + 2, t + 4)
        await pair.right.put(t + 3)
        assert (await pair.left.get(pair.group, wait_nanos=-1))[0] == [t, t + 2]  # no caller has read at the other host


async def test_a_put_at_one_host_moves_the_cut_at_the_other(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t, t + 5)
    await pair.right.put(t + 1)
    await pair.until_synced(t + 1)
    assert (await pair.right.get(pair.group))[0] == []
    waiting = asyncio.create_task(pair.left.get(pair.group, cut_floor_unix_nano=t + 3, wait_nanos=-1))
    await pair.right.put(t + 7)
    times, summary = await waiting
    assert (times, summary.cut_unix_nano) == ([t], t + 5)


async def test_an_advance_counts_as_much_as_an_item(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t, t + 5)
    await pair.right.advance(t + 4)
    await pair.until_synced(t + 4)
    assert (await pair.left.get(pair.group))[0] == [t]


async def test_the_status_shows_the_position_of_a_channel_of_another_host(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t)
    await pair.right.put(t + 5)
    await pair.until_synced(t)
    status = await pair.left.host.until(pair.group, lambda status: len(status.members) == 2)
    members = {member.times.channel_id: member for member in status.members}
    assert members[pair.right.channel_id].lead_nanos == 5
    assert not members[pair.right.channel_id].HasField("hidden_items")
    assert members[pair.left.channel_id].hidden_items == 1
    assert list(status.waiting_on_channel_ids) == [pair.left.channel_id]


async def test_one_cut_serves_a_read_over_both_hosts(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t, t + 2, t + 4)
    await pair.right.put(t + 1, t + 3, t + 5)
    await pair.left.host.until_cut(pair.group, t + 4)
    cut = (await pair.left.host.groups.GetCut(pb.GetCutRequest(group_id=pair.group.group_id))).floor.cut_unix_nano
    assert (await pair.left.get(pair.group, cut_unix_nano=cut))[0] == [t, t + 2]
    assert (await pair.right.get(pair.group, cut_unix_nano=cut))[0] == [t + 1, t + 3]


async def test_cut_events_may_begin_before_any_item_is_visible(pair: Pair) -> None:
    t = pair.start
    decider = CutReader(pair.left.host, pair.group, decides=True)
    position = await decider.opened()
    other = CutReader(pair.right.host, pair.group, after=position)
    await other.opened()
    await pair.left.put(t, t + 2)
    await pair.right.put(t + 1, t + 3)
    left: list[int] = []
    right: list[int] = []
    while left + right != [t, t + 1]:
        event = await decider.event()
        await other.send_boundary(event.boundary)
        left += event.times(pair.left)
        right += (await other.event()).times(pair.right)


async def test_cut_events_of_two_hosts_have_the_same_cuts(pair: Pair) -> None:
    t = pair.start
    decider = CutReader(pair.left.host, pair.group, decides=True)
    other = CutReader(pair.right.host, pair.group)
    await asyncio.gather(decider.opened(), other.opened())
    await pair.left.put(t, t + 2)
    await pair.right.put(t + 1, t + 3)
    shown: dict[str, list[int]] = {"left": [], "right": []}
    for last in (t + 2, t + 12):
        while True:
            event = await decider.event()
            await other.send_boundary(event.boundary)
            answer = await other.event()
            assert answer.boundary.cut_unix_nano == event.boundary.cut_unix_nano
            assert list(event.boundary.incomplete_channel_ids) == []
            shown["left"] += event.times(pair.left)
            shown["right"] += answer.times(pair.right)
            if event.boundary.cut_unix_nano >= last:
                break
        if last == t + 2:
            await pair.left.put(t + 12)
            await pair.right.put(t + 13)
    assert shown == {"left": [t, t + 2], "right": [t + 1, t + 3]}


async def test_cut_events_end_when_their_host_becomes_the_owner_of_another_member(pair: Pair) -> None:
    reader = CutReader(pair.left.host, pair.group, decides=True)
    assert [one.channel_id for one in (await reader.opened()).channels] == [pair.left.channel_id]
    await pair.cluster.directory.called("Watch", times=2)
    record = pair.cluster.directory.give_to(pair.right.channel_id, LOWER)
    await pair.left.host.bound(record)
    async with asyncio.timeout(WAIT_SECONDS):
        assert await reader.call.code() is grpc.StatusCode.UNAVAILABLE
    assert "has come to this host" in await reader.call.details()


async def test_matches_have_items_of_several_hosts(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t + 10, t + 20)
    await pair.right.put(t + 11, t + 30)
    opening = pb.SubscribeMatchesOpen(
        group_id=pair.group.group_id,
        per_channel_id=pair.left.channel_id,
        epoch=1,
        tolerance_nanos=3,
        after=pb.MatchCursor(after=item_pb2.ItemPosition(time_unix_nano=t)),
    )
    call = pair.left.host.groups.SubscribeMatches(iter((pb.SubscribeMatchesRequest(open=opening, credit_bytes=2**40),)))
    found: list[pb.ItemMatch] = []
    async with asyncio.timeout(45):
        while len(found) < 2:
            found += (await call.read()).matches
    assert [[near.position.time_unix_nano for near in one.matched] for one in found] == [[t + 11], []]
    assert not found[0].matched[0].HasField("item")  # the item is at the other host
    assert found[0].matched[0].position.incarnation == pair.right.record.incarnation


async def test_a_host_that_regains_its_lease_sends_its_times_again(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t)
    await pair.right.put(t + 1)
    await pair.until_synced(t)
    for fenced in (pair.right.host.host.store, pair.right.host.host.groups):
        fenced.fence()  # this host has no reader of the group, but the other host needs the times of its channel
    await pair.left.put(t + 20)
    await pair.right.put(t + 10)
    await pair.left.host.until_cut(pair.group, t + 10)


async def test_a_lost_host_holds_the_cut_back_until_its_channel_has_another_owner(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t, t + 5)
    await pair.right.put(t + 3)
    await pair.until_synced(t + 3)
    await pair.right.host.stop()
    await pair.left.put(t + 9)
    status = await pair.left.host.status(pair.group)
    assert (status.cut_unix_nano, list(status.waiting_on_channel_ids)) == (t + 3, [pair.right.channel_id])
    third = await pair.cluster.start("h3", b"c-another-host!!")
    record = pair.cluster.directory.give_to(pair.right.channel_id, third.host.identity.host_id)
    channel = await third.bound(record)
    assert (await pair.left.get(pair.group))[1].cut_unix_nano == t + 3  # the new owner has no item
    await channel.put(t + 8)
    await pair.left.host.until_cut(pair.group, t + 8)


async def test_the_cut_of_a_restarted_host_does_not_go_back(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t, t + 5)
    await pair.right.put(t + 9)
    await pair.until_synced(t + 5)
    await pair.left.host.stop()
    restarted = await pair.cluster.start("h0", LOWER, boot=8)  # a new process of the same host
    left = await restarted.bound(pair.cluster.directory.channels[pair.left.channel_id])
    times, summary = await left.get(pair.group, wait_nanos=100 * MS)
    assert (times, summary.cut_unix_nano) == ([], t + 5)
    await left.put(t + 7)
    status = await restarted.until_cut(pair.group, t + 7)
    assert status.cut_unix_nano == t + 7


async def test_a_host_shows_no_item_before_it_knows_the_cuts_of_the_others(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t, t + 5)
    await pair.right.put(t + 9)
    await pair.right.host.server.grpc.stop(None)  # the directory counts the host as live, but no caller can reach it
    times, summary = await pair.left.get(pair.group)
    assert (times, summary.reason) == ([], error_pb2.ABSENCE_REASON_HIDDEN)
    assert not summary.HasField("cut_unix_nano")
    assert "h1" in summary.detail
    assert list((await pair.left.host.status(pair.group)).waiting_on_channel_ids) == [pair.right.channel_id]
    # The left host shows the group when the other host is lost, and the left channel alone decides the cut.
    pair.cluster.directory.hosts[HIGHER].alive = False
    pair.cluster.directory.groups[pair.group.group_id].spec.reference = group_pb2.GROUP_REFERENCE_CHANNEL
    pair.cluster.directory.groups[pair.group.group_id].spec.reference_channel_id = pair.left.channel_id
    pair.cluster.directory.groups[pair.group.group_id].spec_version += 1
    await pair.left.host.until_cut(pair.group, t + 5)


async def test_a_member_that_is_added_holds_the_cut_back_at_every_host(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t, t + 5)
    await pair.right.put(t + 3)
    await pair.until_synced(t + 3)
    third = await pair.left.host.open("third")
    await pair.cluster.directory.called("Watch", times=2)
    pair.cluster.directory.change_members(pair.group.group_id, [pair.left, pair.right, third])
    for host in (pair.left.host, pair.right.host):
        await host.until(pair.group, lambda status: len(status.members) == 3)
    await pair.right.put(t + 9)
    assert (await pair.left.host.status(pair.group)).cut_unix_nano == t + 3
    await third.put(t + 4)
    await pair.until_synced(t + 4)


async def test_a_host_keeps_the_cut_floor_of_an_unknown_group_until_it_learns_of_the_group(pair: Pair) -> None:
    t = pair.start
    floors = [
        group_pb2.CutFloor(group_id=pair.group.group_id, incarnation=pair.group.incarnation, cut_unix_nano=t + at)
        for at in (30, 50, 40)
    ]
    pair.right.host.host.groups.exchange.receive(LOWER, pb.TimesUpdate(floors=floors), is_first=False)
    assert (await pair.right.host.until_cut(pair.group, t)).cut_unix_nano == t + 50
    assert (await pair.left.host.until_cut(pair.group, t)).cut_unix_nano == t + 50  # by the right host


async def test_a_host_that_does_not_name_itself_gets_no_times(pair: Pair) -> None:
    call = pair.left.host.groups.ExchangeTimes()
    await call.write(pb.ExchangeTimesRequest(update=pb.TimesUpdate()))
    async with asyncio.timeout(45):
        assert (await call.read()).hello.host_id == LOWER
        assert "hello" in (await call.details())


async def test_a_message_about_a_channel_that_its_sender_does_not_own_changes_nothing(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t)
    await pair.right.put(t + 1)
    await pair.until_synced(t)
    exchange = pair.right.host.host.groups.exchange
    false_times = group_pb2.ChannelTimes(
        channel_id=pair.right.channel_id, epoch=9, incarnation=pair.right.record.incarnation, newest_unix_nano=t + 99
    )
    exchange.receive(LOWER, pb.TimesUpdate(times=[false_times]), is_first=False)
    await pair.left.put(t + 50)
    await pair.until_synced(t + 1)
    status = await pair.right.host.until_cut(pair.group, t + 1)
    assert status.cut_unix_nano == t + 1


async def test_a_host_that_owns_no_member_cannot_move_the_cut(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t)
    await pair.right.put(t)
    await pair.until_synced(t)
    exchange = pair.left.host.host.groups.exchange
    stranger = b"not-a-host-at-al"
    exchange.receive(stranger, pb.TimesUpdate(floors=[floor_of(pair, t + S)]), is_first=True)
    assert (await pair.left.host.status(pair.group)).cut_unix_nano == t
    exchange.receive(HIGHER, pb.TimesUpdate(floors=[floor_of(pair, t + 5)]), is_first=False)
    assert (await pair.left.host.status(pair.group)).cut_unix_nano == t + 5  # the owner of a member may move the cut


async def test_no_host_can_move_the_cut_beyond_max_lead_and_max_future(pair: Pair) -> None:
    t = pair.start
    await pair.left.put(t)
    await pair.right.put(t)
    await pair.until_synced(t)
    exchange = pair.left.host.host.groups.exchange
    now = pair.left.host.now()
    lead = 6 * S  # max_lead of 5 s and max_future of 1 s, by default
    for far in (MAX_INSTANT, now + lead + 60 * S):
        exchange.receive(HIGHER, pb.TimesUpdate(floors=[floor_of(pair, far)]), is_first=False)
        assert (await pair.left.host.status(pair.group)).cut_unix_nano == t
    exchange.receive(HIGHER, pb.TimesUpdate(floors=[floor_of(pair, now + lead)]), is_first=False)
    assert (await pair.left.host.status(pair.group)).cut_unix_nano == now + lead


async def test_floors_of_unknown_groups_are_kept_for_each_host_up_to_a_bound(pair: Pair) -> None:
    exchange = pair.left.host.host.groups.exchange
    stranger, floors = b"not-a-host-at-al", [floor_of(pair, pair.start, index) for index in range(1200)]
    exchange.receive(stranger, pb.TimesUpdate(floors=floors), is_first=False)
    exchange.receive(HIGHER, pb.TimesUpdate(floors=floors[-1:]), is_first=False)
    kept = [exchange.take_floors(floor.group_id) for floor in floors]
    assert sum(stranger in one for one in kept) == FLOORS_MAX_PER_HOST
    assert HIGHER in kept[-1]


def floor_of(pair: Pair, cut: int, group: int | None = None) -> group_pb2.CutFloor:
    """The cut floor of the pair's group, or of an unknown group with that number."""
    group_id = pair.group.group_id if group is None else group.to_bytes(16, "big")
    return group_pb2.CutFloor(group_id=group_id, incarnation=pair.group.incarnation, cut_unix_nano=cut)
