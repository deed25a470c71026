"""Channels with replicas together with other things, between real processes."""

from __future__ import annotations

from typing import Any

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.integration.proxies.readers import eventually
from tests.integration.replicas.test_replicas import in_sync, opened
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=3, supernodes=1, scope="function")


def name_of(rt: Any, host_id: bytes) -> str:
    return str(next(one.name for one in rt.hosts() if one.host_id == host_id))


@pytest.mark.without_rules("it acts as an operator")
def test_a_channel_with_replicas_does_not_move_and_its_replica_stays_in_sync(cluster: LocalCluster) -> None:
    with st.connect(cluster.address, transport="grpc") as rt:
        channel = opened(rt)
        eventually(lambda: len(in_sync(channel)) == 1, "the replica is in sync")
        replica = in_sync(channel)
        other = ({"h2", "h3"} - {name_of(rt, replica[0])}).pop()
        for target in (other, name_of(rt, replica[0])):
            with pytest.raises(st.StampedeError, match="has replicas"):
                rt.move("cam", target)
            assert in_sync(channel) == replica
            assert channel.put(b"x").copies == 2
        drained = rt.drain("h1")
        assert "has replicas" in drained.left["cam"]
        assert channel.put(b"x").copies == 2
