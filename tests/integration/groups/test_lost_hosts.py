"""Readers of a group whose hosts stop or are lost."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture

SECOND = 1_000_000_000
FAR_BELOW = 30 * SECOND

cluster = cluster_fixture(hosts=2, supernodes=1)


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


def group_of_two(rt: st.Connection, name: str) -> st.Group:
    members = [rt.channel(f"{name}/{host.name}", host=host.name, max_age="300s") for host in rt.hosts()]
    return rt.group(name, members)


def put_all(group: st.Group, payload: bytes, time: int) -> None:
    for channel in group.channels:
        channel.put(payload, time=time)


def test_another_host_gives_the_status_while_the_first_one_is_stopped(cluster: LocalCluster, rt: st.Connection) -> None:
    group = group_of_two(rt, "stopped")
    put_all(group, b"0", st.now() - SECOND)
    first, second = group.channels
    assert group[second].newest(timeout=0) is None
    stopped = next(host for host in cluster.hosts if host.name == f"host {first.host}")
    stopped.pause()
    try:
        second.put(b"1")
        assert [channel.name for channel in group.status().waiting_on] == [first.name]
    finally:
        stopped.resume()


def test_an_older_descriptor_shows_a_group_that_began_anew(cluster: LocalCluster, rt: st.Connection) -> None:
    group, now = group_of_two(rt, "anew"), st.now()
    first = group.channels[0]
    for at in (0, 1):
        put_all(group, b"lost", now + (at - 2) * SECOND)
    assert [item.payload for item in group[first].get(st.OLDEST, st.NEWEST, timeout=10)] == [b"lost"]
    incarnation = group.incarnation
    for host in cluster.hosts:
        host.kill()
    for host in cluster.hosts:
        host.restart()
    for at in (0, 1):
        put_all(group, b"new", now - FAR_BELOW + at * SECOND)  # below the cut that was shown before
    assert [item.payload for item in group[first].get(st.OLDEST, st.NEWEST, timeout=10)] == [b"new"]
    assert group.incarnation != incarnation


def test_a_cut_subscription_ends_with_the_loss_after_its_hosts_restarted_one_after_the_other(
    cluster: LocalCluster, rt: st.Connection
) -> None:
    group, now = group_of_two(rt, "in-turn"), st.now()
    with group.subscribe() as cuts:
        put_all(group, b"0", now)
        next(cuts)
        first, second = cluster.hosts
        first.restart()
        put_all(group, b"1", now + SECOND)
        next(cuts)  # the group goes on: the restarted host has the cut from the second host
        second.restart()
        put_all(group, b"2", now - SECOND)
        with pytest.raises(st.IncarnationLost, match="has restarted or was lost since then, together or one after"):
            list(cuts)  # an event from before the restarts may come first
