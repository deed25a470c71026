"""Channels that a real host records only after they have got items."""

from __future__ import annotations

import time

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import recorded_cluster_fixture
from tests.support.waiting import wait_until

MS, SECOND = 10**6, 10**9

cluster = recorded_cluster_fixture()


def test_reads_say_that_earlier_items_have_left_memory(cluster: LocalCluster) -> None:
    """An item of the same time as the first archived one. In an earlier version, such a read gave no reason."""
    with st.connect(cluster.address, secret=cluster.secret.text) as rt:
        channel, began = rt.channel("later/data", max_items=2), time.time_ns() - SECOND
        for at in (0, 20):
            channel.put(b"before", time=began + at * MS)
        channel.configure(archive="7d")
        for at in (20, 30, 40):
            channel.put(b"after", time=began + at * MS)
        wait_until(lambda: channel.stats().held == 2, "the archive has the other items")
        found = channel.get(began + 20 * MS, began + 40 * MS)
        assert ([item.payload for item in found], found.reason) == ([b"after"] * 3, "COLLECTED")
        found = channel.get(began + 20 * MS + 1, began + 40 * MS, match="start")
        assert (len(found), found.reason) == (2, None)
