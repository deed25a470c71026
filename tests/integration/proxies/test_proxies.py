"""Proxies of channels, between real processes: added, read and removed, under load (paper, section 4.1)."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.integration.proxies.readers import all_saw, eventually, produced, reading, wait_for_puts
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=3, supernodes=1)
numbers = itertools.count()


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[Any]:
    with st.connect(cluster.address, transport="grpc") as made:
        yield made


@pytest.fixture
def channel(rt: Any) -> Any:
    return rt.channel(f"cam/{next(numbers)}", max_items=100_000, host="h1")


def test_a_proxy_has_the_held_items_and_the_new_ones(rt: Any, channel: Any) -> None:
    before = [channel.put(b"%d" % number).seq for number in range(300)]
    proxy = rt.proxy(channel, "h2")
    assert (proxy.channel, proxy.host, proxy.source, proxy.ready) == (channel.name, "h2", "h1", True)
    assert (proxy.held, proxy.missed) == (300, 0)
    item = channel.put(b"another")
    found: list[st.Items] = []

    def read_at_copy() -> bool:
        found[:] = [channel.get(st.OLDEST, st.NEWEST, least_seq=item.seq)]
        return found[0].staleness_nanos is not None

    eventually(read_at_copy, "the proxy answers")
    assert [one.seq for one in found[0]] == [*before, item.seq]
    assert found[0][-1].payload == b"another"
    assert found[0][-1].time == item.time


def test_a_read_that_no_proxy_can_answer_goes_to_the_owner(rt: Any, channel: Any) -> None:
    channel.put(b"first")
    rt.proxy(channel, "h2")
    answer = channel.get(st.OLDEST, st.NEWEST, max_staleness="0s")
    assert (len(answer), answer.staleness_nanos) == (1, None)
    for number in range(50):  # a client always reads its own item
        item = channel.put(b"%d" % number)
        assert channel.newest(least_seq=item.seq).seq == item.seq


def test_a_get_that_a_proxy_may_answer_waits_for_the_next_item(rt: Any, channel: Any) -> None:
    first = channel.put(b"first")
    rt.proxy(channel, "h2")
    with produced(channel):
        assert channel.newest(after=first, timeout=20, max_staleness="10s").seq > first.seq


def test_a_proxy_that_is_added_twice_exists_once(rt: Any, channel: Any) -> None:
    rt.proxy(channel, "h2")
    assert rt.proxy(channel.name, "h2").host == "h2"
    assert [one.host for one in rt.proxies(channel)] == ["h2"]


def test_a_proxy_without_a_named_host_is_placed_on_a_host_without_a_copy(rt: Any, channel: Any) -> None:
    assert {rt.proxy(channel).host, rt.proxy(channel).host} == {"h2", "h3"}


def test_the_owner_cannot_be_a_proxy_and_an_unknown_host_is_refused(rt: Any, channel: Any) -> None:
    with pytest.raises(st.ChannelExists, match="owns it"):
        rt.proxy(channel, "h1")
    with pytest.raises(st.HostNotFound, match="no host 'nowhere'"):
        rt.proxy(channel, "nowhere")
    with pytest.raises(st.ChannelNotFound):
        rt.proxy("never/made", "h2")


def test_subscriptions_spread_over_the_owner_and_the_proxies(rt: Any, channel: Any) -> None:
    rt.proxy(channel, "h2")
    rt.proxy(channel, "h3")
    with reading(channel, 9) as readers:
        last = channel.put(b"an item").seq
        all_saw(readers, last)

        def spread() -> list[int]:
            return [channel.stats().subscriptions, *(one.subscriptions for one in rt.proxies(channel))]

        eventually(
            lambda: sum(spread()) == 9 and max(spread()) - min(spread()) <= 2, "each copy has about three readers"
        )


def test_a_subscription_that_wants_the_owner_stays_there(rt: Any, channel: Any) -> None:
    rt.proxy(channel, "h2")
    with reading(channel, 4, stale_ok=False):
        with reading(channel, 8):
            eventually(lambda: rt.proxies(channel)[0].subscriptions, "some of the other readers are at the proxy")
        eventually(lambda: not rt.proxies(channel)[0].subscriptions, "the other readers have left")
        assert channel.stats().subscriptions == 4


def test_no_reader_misses_or_repeats_an_item_while_proxies_are_added_and_removed(rt: Any, channel: Any) -> None:
    with reading(channel, 8) as readers, produced(channel) as producing:
        for host in ("h2", "h3", "h2"):
            wait_for_puts(producing, 30)
            rt.proxy(channel, host)
            eventually(lambda: all(one.subscriptions for one in rt.proxies(channel)), "readers have moved there")
            wait_for_puts(producing, 30)
            rt.remove_proxy(channel, host)
            eventually(lambda: channel.stats().subscriptions == 8, "all readers are back at the owner")
        all_saw(readers, producing.stop())


def test_a_chain_of_proxies_continues_when_its_middle_ends(rt: Any, channel: Any) -> None:
    with produced(channel) as producing:
        rt.proxy(channel, "h2")
        assert rt.proxy(channel, "h3", source="h2").source == "h2"
        with reading(channel, 6) as readers:
            wait_for_puts(producing, 50)
            rt.remove_proxy(channel, "h2")
            eventually(
                lambda: [(one.host, one.source) for one in rt.proxies(channel)] == [("h3", "h1")],
                "h1 feeds the proxy at h3",
            )
            eventually(lambda: rt.proxies(channel)[0].ready, "the proxy serves readers again")
            wait_for_puts(producing, 50)
            all_saw(readers, producing.stop())


def test_items_that_leave_the_owner_leave_the_proxies(rt: Any) -> None:
    channel = rt.channel(f"cam/{next(numbers)}", max_items=3, host="h1")
    rt.proxy(channel, "h2")
    for number in range(20):
        last = channel.put(b"%d" % number)
    eventually(lambda: rt.proxies(channel)[0].waiting == 0, "the proxy has all items")
    answer = channel.get(st.OLDEST, st.NEWEST, least_seq=last.seq)
    assert [one.seq for one in answer] == [18, 19, 20]
    assert answer.staleness_nanos is not None


def test_a_changed_policy_and_the_end_of_the_channel_reach_the_proxies(rt: Any, channel: Any) -> None:
    rt.proxy(channel, "h2")
    channel.configure(max_items=2)
    for number in range(5):
        channel.put(b"%d" % number)
    eventually(lambda: rt.proxies(channel)[0].held == 2, "the proxy holds two items")
    with reading(channel, 4) as readers:
        channel.delete()
        eventually(
            lambda: all(isinstance(one.error, st.ChannelNotFound) for one in readers), "all readers learn of the end"
        )


def test_puts_and_changes_go_to_the_owner_also_after_reads_from_a_proxy(rt: Any, channel: Any) -> None:
    rt.proxy(channel, "h2")
    channel.put(b"first")
    eventually(lambda: channel.newest(least_seq=1).payload == b"first", "read")
    assert channel.put(b"second").seq == 2
    assert channel.advance(channel.newest().time) > 0
    assert channel.stats().accepted == 2


def test_ended_proxies_keep_no_connections(rt: Any, cluster: LocalCluster) -> None:
    """In an earlier version, the error of each cancelled feed kept its stream, and so a connection, until the garbage
    collector ran.
    """

    def connections() -> list[int]:
        return [len(os.listdir(f"/proc/{host.pid}/fd")) for host in cluster.hosts[:2]]

    channels = [rt.channel(f"many/{number}", host="h1") for number in range(10)]
    for one in channels:  # so that all connections of clients are there
        one.put(b"an item")
    before = connections()
    for _ in range(2):
        for one in channels:
            rt.proxy(one, "h2")
        assert max(connections()) >= max(before) + 8
        for one in channels:
            rt.remove_proxy(one, "h2")
        eventually(lambda: not rt.hosted_channels("h2", "many/*"), "the proxies have ended")
    eventually(
        lambda: all(now <= then + 4 for now, then in zip(connections(), before, strict=True)),
        "all connections of the proxies are closed",
    )
