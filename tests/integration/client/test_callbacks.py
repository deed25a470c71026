"""Listeners and failures: the function is called again after its channel's host is lost."""

from __future__ import annotations

import logging
import queue

import pytest

import stampede_rt as st
from stampede_rt_local.cluster import LocalCluster
from tests.support.cluster import cluster_fixture
from tests.support.waiting import wait_until

cluster = cluster_fixture(hosts=2, supernodes=1, scope="function")


def test_a_callback_continues_with_the_items_of_a_new_incarnation(
    cluster: LocalCluster, caplog: pytest.LogCaptureFixture
) -> None:
    called: queue.SimpleQueue[bytes | None] = queue.SimpleQueue()
    with st.connect(cluster.address) as rt, caplog.at_level(logging.WARNING, "stampede_rt"):
        channel = rt.channel("cam/left", max_age="60s")
        handle = channel.on_item(lambda item: called.put(item.payload))
        beside: list[bytes | None] = []
        also = channel.on_item(lambda item: beside.append(item.payload), via="multicast")  # the host sends no datagrams
        channel.put(b"before")
        assert called.get(timeout=10) == b"before"
        wait_until(lambda: beside == [b"before"], "the other callback has the item that will be lost")
        next(host for host in cluster.hosts if channel.host in host.name or host.name in channel.host).kill()
        for payload in (b"after 1", b"after 2"):
            channel.put(payload)
        assert [called.get(timeout=30) for _ in range(2)] == [b"after 1", b"after 2"]
        assert (handle.losses, handle.active, handle.error) == (1, True, None)
        wait_until(lambda: len(beside) == 3, "the callback that asked for multicast has everything")
        assert (beside, also.losses) == ([b"before", b"after 1", b"after 2"], 1)
        for one in (handle, also):
            one.cancel()
            assert one.join(10)
    assert any("continues with a new incarnation" in record.getMessage() for record in caplog.records)
