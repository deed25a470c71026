"""Real processes, killed: the calls that still succeed, and the log lines."""

from __future__ import annotations

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=2, supernodes=3, frontends=2, scope="function")
alone = cluster_fixture(hosts=1, supernodes=1, scope="function")


def owner(cluster: LocalCluster, channel: st.Channel) -> object:
    """The process that hosts a channel."""
    return next(host for host in cluster.hosts if channel.host in host.name or host.name in channel.host)


def test_clients_continue_after_the_loss_of_a_supernode_and_a_front_end(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        channel = rt.channel("cam/left", max_age="60s")
        channel.put(b"before")
        leader = next(one for one in rt.supernodes() if one.is_leader)
        cluster.frontends[0].kill()
        next(one for one in cluster.supernodes if leader.supernode_id in one.name).kill()
        channel.put(b"after")
        assert [item.payload for item in channel.get(st.OLDEST, st.NEWEST)] == [b"before", b"after"]
        assert rt.channel("cam/right").put(b"x").seq
        assert {info.name for info in rt.channels("cam/*")} == {"cam/left", "cam/right"}
    with st.connect(cluster.address) as rt:
        assert rt.channel("cam/left", create=False).newest() is not None


def test_the_directory_survives_a_restart_of_all_supernodes(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        channel = rt.channel("cam/left", max_age="60s")
        channel.put(b"kept by its host")
        for supernode in cluster.supernodes:
            supernode.kill()
        channel.put(b"without any supernode")
        for supernode in cluster.supernodes:
            supernode.restart()
        assert [info.name for info in rt.channels()] == ["cam/left"]
        assert len(channel.get(st.OLDEST, st.NEWEST)) == 2


def test_a_channel_of_a_lost_host_is_reopened_elsewhere_as_a_new_incarnation(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        channel = rt.channel("cam/left", max_age="60s")
        first = channel.put(b"lost with its host")
        before = channel.info
        subscription = channel.subscribe(after=first)
        owner(cluster, channel).kill()  # type: ignore[attr-defined]
        item = channel.put(b"new life")
        assert channel.info.channel_id == before.channel_id
        assert channel.info.epoch > before.epoch
        assert item.incarnation == channel.incarnation != before.incarnation
        assert channel.host != before.host
        with pytest.raises(st.IncarnationLost, match="was lost"):
            next(subscription)
        with pytest.raises(st.IncarnationLost):
            channel.newest(after=first)
        assert [one.payload for one in channel.get(st.OLDEST, st.NEWEST)] == [b"new life"]


def test_the_error_names_the_lost_host_and_a_restart_repairs_the_channel(alone: LocalCluster) -> None:
    with st.connect(alone.address) as rt:
        channel = rt.channel("cam/left", max_age="60s")
        channel.put(b"lost")
        before = channel.info
        alone.hosts[0].kill()
        with pytest.raises(st.Unavailable, match="host"):
            channel.put(b"nobody is there")
        alone.hosts[0].restart()
        item = channel.put(b"back")
        assert channel.info.epoch > before.epoch
        assert item.incarnation != before.incarnation
