"""The links between hosts that share groups, and their calls to the directory."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator

import pytest

from stampede_rt.v1 import group_pb2
from stampede_rt_channel_host.groups import link
from stampede_rt_channel_host.groups.link import HostLink
from tests.support.channel_host.group_rig import WAIT_SECONDS, Cluster, GroupedChannel, running_cluster
from tests.support.channel_host.rig import S
from tests.support.clock import ManualClock

LOWER, HIGHER = b"a-lower-host-id!", b"b-higher-host-id"


@pytest.fixture
def clock() -> ManualClock:
    return ManualClock()


@pytest.fixture
async def cluster(clock: ManualClock) -> AsyncIterator[Cluster]:
    """Two hosts on one clock, which stands until a test moves it."""
    async with running_cluster(clock) as cluster:
        await cluster.start("h1", LOWER)
        await cluster.start("h2", HIGHER)
        yield cluster


async def two_channels(cluster: Cluster) -> tuple[GroupedChannel, GroupedChannel]:
    lower, higher = cluster.hosts
    return await lower.open("left"), await higher.open("right")


async def synced(channels: list[GroupedChannel], group: group_pb2.GroupRecord, cut: int) -> None:
    for channel in channels:
        await channel.host.until_cut(group, cut)


async def wait_until_known(
    at: GroupedChannel, channel: GroupedChannel, group: group_pb2.GroupRecord, newest: int
) -> None:
    """Wait until the host of `at` has received the newest time of `channel`."""

    def has_report(status: group_pb2.GroupStatus) -> bool:
        newest_times = {one.times.channel_id: one.times.newest_unix_nano for one in status.members}
        return newest_times.get(channel.channel_id) == newest

    await at.host.until(group, has_report)


async def test_a_link_is_opened_again_although_a_write_came_after_its_end(
    cluster: Cluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, broken = HostLink.run, asyncio.Event()

    async def run_once_in_vain(self: HostLink, peer: bytes | None = None) -> None:
        if peer is not None and not broken.is_set():
            broken.set()
            raise asyncio.InvalidStateError("RPC already finished.")
        await run(self, peer)

    monkeypatch.setattr(HostLink, "run", run_once_in_vain)
    left, right = await two_channels(cluster)
    group, t = cluster.directory.add_group("pair", [left, right]), left.host.now()
    await left.put(t, t + 5)
    await right.put(t + 3)
    await synced([left, right], group, t + 3)
    assert broken.is_set()


async def test_two_hosts_that_leave_one_group_and_share_another_exchange_times_again(cluster: Cluster) -> None:
    left, right = await two_channels(cluster)
    first, t = cluster.directory.add_group("first", [left, right]), left.host.now()
    await left.put(t)
    await right.put(t)
    await synced([left, right], first, t)
    cluster.directory.groups.pop(first.group_id)  # the lower host, which opened the link, does not know it yet
    await right.host.host.groups._look_up_again(first.group_id)
    second = cluster.directory.add_group("second", [left, right])
    await left.put(t + 5)
    await right.put(t + 7)
    await synced([right, left], second, t + 5)


async def test_a_member_is_followed_though_the_group_was_last_named_at_its_host_long_ago(cluster: Cluster) -> None:
    left, right = await two_channels(cluster)
    third, fourth = await right.host.open("third"), await right.host.open("fourth")
    group, t = cluster.directory.add_group("group", [left, right]), left.host.now()
    await left.put(t)
    await right.put(t)
    await synced([left, right], group, t)
    await cluster.directory.called("Watch", times=2)
    hosted = right.host.host.groups.known(group.group_id)
    assert hosted is not None
    cluster.directory.change_members(group.group_id, [left, right, third])
    async with asyncio.timeout(WAIT_SECONDS):
        while hosted.record.spec_version < 2:
            await left.host.status(group)
    hosted.named_s = -1_000.0  # no caller has named the group for long, but the host has just asked for the record
    cluster.directory.change_members(group.group_id, [left, right, third, fourth])
    await fourth.put(t + 5)
    await wait_until_known(left, fourth, group, t + 5)


async def test_a_host_that_missed_a_new_member_learns_of_it_from_the_host_that_waits_for_it(cluster: Cluster) -> None:
    left, right = await two_channels(cluster)
    third = await right.host.open("third")
    group, t = cluster.directory.add_group("group", [left, right]), left.host.now()
    for channel in (left, right):
        await channel.host.status(group)
    hosted = right.host.host.groups.known(group.group_id)
    assert hosted is not None
    hosted.named_s = -1_000.0  # no caller has named the group for long
    cluster.directory.change_members(group.group_id, [left, right, third], reported=False)
    await left.host.host.groups._look_up_again(group.group_id)
    await third.put(t + 5)
    await wait_until_known(left, third, group, t + 5)


async def test_hosts_agree_on_the_idle_channels_without_waiting_for_a_sign_of_life(
    cluster: Cluster, clock: ManualClock, monkeypatch: pytest.MonkeyPatch
) -> None:
    for limit in ("LINK_SIGN_OF_LIFE_SECONDS", "BROKEN_AFTER_SECONDS"):
        monkeypatch.setattr(link, limit, 10 * WAIT_SECONDS)
    left, right = await two_channels(cluster)
    group, t = cluster.directory.add_group("pair", [left, right], idle_after_nanos=S // 10), left.host.now()
    await left.put(t)
    await right.put(t + 9)
    await synced([left, right], group, t)
    clock.advance(S // 10 - 1)
    await left.put(t + 2)
    await synced([left, right], group, t + 2)  # each host has received all effects of the put
    clock.advance(1)  # from now on the right channel counts as idle; the cut stays, because the left channel holds it

    def only_the_other_is_left_out(status: group_pb2.GroupStatus) -> bool:
        return [one.times.channel_id for one in status.members if one.idle] == [right.channel_id]

    async with asyncio.timeout(WAIT_SECONDS):
        for host in cluster.hosts:
            await host.until(group, only_the_other_is_left_out)
    assert (await left.host.status(group)).cut_unix_nano == t + 2


async def test_a_channel_of_a_lost_host_becomes_idle_like_any_other(cluster: Cluster, clock: ManualClock) -> None:
    left, right = await two_channels(cluster)
    group, t = cluster.directory.add_group("pair", [left, right], idle_after_nanos=2 * S), left.host.now()
    await left.put(t)
    await right.put(t + 1)
    await synced([left, right], group, t)
    await right.host.stop()
    cluster.directory.hosts[HIGHER].alive = False
    clock.advance(3 * S)
    await left.put(t + 9)
    await synced([left], group, t + 9)
