"""Recorded channels whose host is unreachable, and only this host has their archive in its folder."""

from __future__ import annotations

import time
from collections.abc import Iterator

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.waiting import wait_until

ITEMS, HELD = 100, 8


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[LocalCluster]:
    with LocalCluster(hosts=2, supernodes=1, archive=tmp_path_factory.mktemp("archive")) as running:
        yield running


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address, secret=cluster.secret.text) as connection:
        yield connection


def filled(rt: st.Connection, name: str) -> st.Channel:
    """A channel at host h1 that has most of its items in the archive only."""
    channel = rt.channel(name, host="h1", max_items=HELD, archive="7d")
    for number in range(ITEMS):
        channel.put(b"%d" % number)
    wait_until(lambda: channel.stats().held <= HELD)
    return channel


def seqs(channel: st.Channel) -> list[int]:
    return [item.seq for item in channel.get(st.OLDEST, st.NEWEST)]


def test_a_recorded_channel_waits_for_its_host_after_a_start_of_all_hosts(
    cluster: LocalCluster, rt: st.Connection
) -> None:
    channel = filled(rt, "after-a-start")
    for host in cluster.hosts:
        host.stop()
    cluster.hosts[1].restart()
    with pytest.raises(
        st.Unavailable, match="waits for host h1, which is unreachable, because only its folder has the"
    ):
        channel.put(b"too early", timeout=1)
    with pytest.raises(st.Unavailable, match="waits for host h1"):
        rt.channel("after-a-start", create=False)
    cluster.hosts[0].restart()
    channel.put(b"later")
    assert (channel.info.host, channel.info.epoch) == ("h1", 2)
    assert seqs(channel) == [*range(1, ITEMS + 2)]


def test_a_recorded_channel_waits_for_a_killed_host(cluster: LocalCluster, rt: st.Connection) -> None:
    channel = filled(rt, "after-a-crash")
    cluster.hosts[0].kill()
    wait_until(lambda: [host.name for host in rt.hosts()] == ["h2"], "the lease of the host has ended")
    with pytest.raises(st.Unavailable, match="waits for host h1"):
        channel.put(b"too early", timeout=1)
    cluster.hosts[0].restart()
    channel.put(b"later")
    assert channel.info.host == "h1"
    assert seqs(channel)[: ITEMS - HELD] == [*range(1, ITEMS - HELD + 1)]


def test_a_recorded_channel_goes_to_another_host_after_the_time_of_its_host(
    cluster: LocalCluster, rt: st.Connection
) -> None:
    h1 = cluster.hosts[0]
    h1.arguments += ["--archive-wait-seconds", "1"]
    h1.restart()
    channel = filled(rt, "left")
    h1.stop()
    began = time.time_ns()
    channel.put(b"elsewhere", timeout=30)
    assert channel.info.host == "h2"
    assert channel.get(began - 10**9, began - 1).reason == "LOST"
