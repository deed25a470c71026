"""Handles whose host is lost open their channel or queue at another host, with the policy that it has now."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=2, supernodes=1, scope="function")
LIMIT_S = 40


@pytest.fixture
def rt(cluster: LocalCluster) -> Iterator[st.Connection]:
    with st.connect(cluster.address) as connection:
        yield connection


def test_handles_go_on_after_a_loss_of_the_host_although_the_policy_has_changed_since(
    cluster: LocalCluster, rt: st.Connection
) -> None:
    """In an earlier version a handle repeated its first policy, and every call raised ChannelExists or QueueExists."""
    channel, queue = rt.channel("lost/camera", host="h1", max_items=5), rt.queue("lost/work", host="h1", max_items=5)
    channel.put(b"gone")
    queue.put(b"gone")
    channel.configure(max_items=9)
    queue.configure(max_items=9)
    cluster.hosts[0].kill()
    channel.put(b"kept", timeout=LIMIT_S)
    queue.put(b"kept", timeout=LIMIT_S)
    assert (channel.host, channel.info.policy.max_items) == ("h2", 9)
    assert queue.stats().policy.max_items == 9
