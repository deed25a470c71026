"""A host that hangs (SIGSTOP): whoever waits for its items is told, and goes on where they are after it is given up."""

from __future__ import annotations

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.transports import grpc_async, grpc_sync
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=2, supernodes=1, scope="function")


def owner(cluster: LocalCluster, channel: st.Channel | aio.Channel) -> ServiceProcess:
    return next(host for host in cluster.hosts if channel.host in host.name)


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A live host gives a sign of life only every 5 s, but these are stopped before that."""
    monkeypatch.setattr(grpc_sync, "SILENCE_S_MAX", 3.0)
    monkeypatch.setattr(grpc_async, "SILENCE_S_MAX", 3.0)


def test_a_subscription_does_not_wait_for_ever(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        channel = rt.channel("cam/a", max_age="60s")
        subscription = channel.subscribe()
        frozen = owner(cluster, channel)
        frozen.pause()
        with pytest.raises(st.IncarnationLost, match="was lost"):
            next(subscription)
        assert channel.put(b"goes on elsewhere").incarnation == channel.incarnation
        frozen.resume()


async def test_an_awaited_subscription_does_not_wait_for_ever(cluster: LocalCluster) -> None:
    async with aio.connect(cluster.address) as rt:
        channel = await rt.channel("cam/a", max_age="60s")
        async with channel.subscribe() as subscription:
            frozen = owner(cluster, channel)
            frozen.pause()
            with pytest.raises(st.IncarnationLost, match="was lost"):
                await anext(subscription)
        frozen.resume()
