"""Moves of channels with replicas between real processes: to the replica's host, and to a host without a copy."""

from __future__ import annotations

from typing import Any

import pytest

import stampede_rt as st
from stampede_rt.cli.commands import run
from stampede_rt_local.cluster import LocalCluster
from tests.integration.proxies.readers import all_saw, eventually, produced, reading, wait_for_puts
from tests.integration.replicas.test_replicas import holds_all, in_sync, opened, owner_of
from tests.support.cluster import cluster_fixture, drained

cluster = cluster_fixture(hosts=3, supernodes=1, scope="function")


def name_of(rt: Any, host_id: bytes) -> str:
    return str(next(one.name for one in rt.hosts() if one.host_id == host_id))


def names_in_sync(rt: Any, channel: Any) -> list[str]:
    return [name_of(rt, one) for one in in_sync(channel)]


def test_a_channel_with_a_replica_moves_under_load_and_survives_the_loss_of_its_new_host(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = opened(rt)
        eventually(lambda: len(in_sync(channel)) == 1, "the replica is in sync")
        incarnation, (replica,) = channel.incarnation, names_in_sync(rt, channel)
        without_copy = ({"h2", "h3"} - {replica}).pop()
        with reading(channel, 2) as readers, produced(channel) as producing:
            wait_for_puts(producing, 50)
            rt.move(channel, replica)
            assert owner_of(rt, channel) == replica
            eventually(lambda: names_in_sync(rt, channel) == ["h1"], "the former owner has taken the replica's place")
            wait_for_puts(producing, 50)
            rt.move(channel, without_copy)
            eventually(lambda: names_in_sync(rt, channel) == ["h1"], "the replica stays")
            wait_for_puts(producing, 50)
            rt.move(channel, "h1")
            eventually(lambda: names_in_sync(rt, channel) == [without_copy], "the two hosts have changed places")
            wait_for_puts(producing, 50)
            assert channel.put(b"x").copies == 2
            cluster.hosts[0].kill()
            wait_for_puts(producing, 50)
            assert owner_of(rt, channel) == without_copy
            last = producing.stop()
            all_saw(readers, last)
        assert channel.incarnation == incarnation
        holds_all(channel, last)


def test_a_drain_moves_channels_with_replicas_and_a_stopped_host_is_replaced(
    cluster: LocalCluster, capsys: pytest.CaptureFixture[str]
) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = opened(rt, replicas=2)
        eventually(lambda: len(in_sync(channel)) == 2, "the replicas are in sync")
        with reading(channel, 2) as readers, produced(channel) as producing:
            wait_for_puts(producing, 50)
            assert run(["replicas", "cam", "--url", cluster.address]) == 0
            assert [line.split()[1:3] for line in capsys.readouterr().out.splitlines()[1:]] == [["in", "sync"]] * 2
            assert drained(cluster, "h1").left == {}
            assert owner_of(rt, channel) in ("h2", "h3")
            wait_for_puts(producing, 50)
            cluster.hosts[0].stop()
            wait_for_puts(producing, 50)
            last = producing.stop()
            all_saw(readers, last)
        holds_all(channel, last)


def test_a_channel_does_not_move_while_too_few_replicas_have_its_items(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = opened(rt, replicas=2, min_replicas=2)
        eventually(lambda: len(in_sync(channel)) == 2, "the replicas are in sync")
        cluster.hosts[2].kill()
        eventually(lambda: len(in_sync(channel)) == 1, "a replica is lost")
        with pytest.raises(st.NotReplicated):
            channel.put(b"x", timeout=0.2)
        with pytest.raises(st.Unavailable, match=r"needs 2 replicas in sync .* and has 1"):
            rt.move(channel, "h2")
