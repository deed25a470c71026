"""Channels whose replicas no host can hold: puts that are not replicated in time, and owners that go on alone."""

from __future__ import annotations

from typing import Any

import pytest

import stampede_rt as st
import stampede_rt.aio
from stampede_rt_local.cluster import LocalCluster
from tests.integration.proxies.readers import eventually
from tests.support.sharing.shared_cluster import shared_cluster_fixture

cluster = shared_cluster_fixture(hosts=1)


@pytest.mark.parametrize("transport", ["grpc", None])
def test_a_put_that_is_not_replicated_in_time_fails_and_stays_hidden(cluster: LocalCluster, transport: Any) -> None:
    with st.connect(cluster.address, transport=transport) as rt:
        channel = rt.channel(f"waits/{transport}", max_items=10, replicas=1, ack="replica")
        with pytest.raises(st.NotReplicated) as caught:
            channel.put(b"an item", timeout=0.2)
        assert (caught.value.metadata["seq"], caught.value.metadata["copies"]) == ("1", "1")
        assert channel.newest() is None
        stats = channel.stats()
        assert (stats.accepted, stats.replicated, stats.not_replicated) == (1, 1, 1)
        channel.configure(min_replicas=0)
        eventually(lambda: channel.newest() is not None, "the owner shows it alone")
        item = channel.put(b"the next")
        assert (item.seq, item.copies, item) == (2, 1, channel.newest())


async def test_a_put_on_asyncio_waits_for_replicas_and_no_longer_than_its_timeout(cluster: LocalCluster) -> None:
    async with stampede_rt.aio.connect(cluster.address) as rt:
        channel = await rt.channel("aio", max_items=10, replicas=1, ack="replica")
        with pytest.raises(st.NotReplicated):
            await channel.put(b"an item", timeout=0.2)
        await channel.configure(replicas=0, ack="host")
        assert (await channel.put(b"the next")).seq == 2
        assert [item.seq for item in await channel.get(st.OLDEST, st.NEWEST)] == [1, 2]


def test_a_producer_gets_the_errors_of_items_that_were_not_replicated_in_time(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        channel = rt.channel("produced", max_items=10, replicas=1, ack="replica", min_replicas=0)
        with channel.producer() as producer:
            for at in range(5):
                producer.put(b"%d" % at)
        assert [item.payload for item in channel.get(st.OLDEST, st.NEWEST)] == [b"0", b"1", b"2", b"3", b"4"]


@pytest.mark.parametrize("transport", ["grpc", None])
def test_with_ack_host_a_put_waits_for_replicas_only_if_it_asks_to(cluster: LocalCluster, transport: Any) -> None:
    with st.connect(cluster.address, transport=transport) as rt:
        channel = rt.channel(f"lags/{transport}", max_items=10, replicas=1)
        assert channel.put(b"an item") == channel.newest()
        with pytest.raises(st.NotReplicated):
            channel.put(b"the next", ack="replica", timeout=0.2)
        assert [item.seq for item in channel.get(st.OLDEST, st.NEWEST)] == [1, 2]
        assert (channel.stats().replicated, channel.stats().inherited_next_seq) == (None, None)


async def test_an_asyncio_put_waits_for_lagging_replicas_only_if_it_asks_to(cluster: LocalCluster) -> None:
    async with stampede_rt.aio.connect(cluster.address) as rt:
        channel = await rt.channel("aio-lags", max_items=10, replicas=1)
        assert (await channel.put(b"an item")).seq == 1
        with pytest.raises(st.NotReplicated):
            await channel.put(b"the next", ack="replica", timeout=0.2)
        await channel.configure(replicas=0)
        assert (await channel.put(b"the last")).seq == 3


@pytest.mark.parametrize(
    ("policy", "says"),
    [
        ({"ack": "replica"}, "state replicas of 1 or more"),
        ({"replicas": 1, "ack": "replica", "min_replicas": 2}, "state 1 or less"),
        ({"replicas": 5, "ack": "replica"}, "it must be 0 to 4"),
        ({"replicas": 1, "ack": "disc"}, "'host', 'disk', 'replica'"),
    ],
)
def test_a_policy_that_cannot_be_served_is_refused_with_advice(
    cluster: LocalCluster, policy: dict[str, Any], says: str
) -> None:
    with st.connect(cluster.address) as rt, pytest.raises(st.InvalidArgument, match=says):
        rt.channel("refused", max_items=10, **policy)
