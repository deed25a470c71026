"""A host that hangs (SIGSTOP): callers that wait for its items get an error, and go on at the new owner."""

from __future__ import annotations

import asyncio
from concurrent.futures import ThreadPoolExecutor

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt.transports import streams_async, streams_sync
from stampede_rt_local.cluster import LocalCluster
from stampede_rt_local.process import ServiceProcess
from tests.support.cluster import cluster_fixture

cluster = cluster_fixture(hosts=2, supernodes=1, scope="function")


def owner(cluster: LocalCluster, channel: st.Channel | aio.Channel) -> ServiceProcess:
    return next(host for host in cluster.hosts if channel.host in host.name)


@pytest.fixture(autouse=True)
def _impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """A live host gives a sign of life only every 5 s. These tests stop hosts before that."""
    monkeypatch.setattr(streams_sync, "SILENCE_S_MAX", 3.0)
    monkeypatch.setattr(streams_async, "SILENCE_S_MAX", 3.0)


def test_calls_of_every_kind_continue_at_another_host_within_their_timeouts(cluster: LocalCluster) -> None:
    """No caller need repeat its call: the client notices the silence before the time for one call is over."""
    with st.connect(cluster.address) as rt, ThreadPoolExecutor(8) as pool:
        channel = rt.channel("cam/a", max_age="60s")
        queue = rt.queue("work/a", host=channel.host)
        lost = channel.put(b"lost")
        queue.put(b"lost")
        frozen = owner(cluster, channel)
        frozen.pause()
        calls = [
            pool.submit(channel.put, b"goes on elsewhere"),
            pool.submit(channel.newest, timeout=30),
            pool.submit(channel.stats),
            pool.submit(queue.put, b"waits for room if there is none"),
        ]
        put, item, _, enqueued = (call.result() for call in calls)
        assert put.incarnation == channel.incarnation
        assert (item.payload, enqueued.seq) == (b"goes on elsewhere", 1)
        assert channel.at(lost.time).reason == "LOST"
        frozen.resume()


async def test_awaited_calls_of_every_kind_continue_at_another_host_within_their_timeouts(
    cluster: LocalCluster,
) -> None:
    async with aio.connect(cluster.address) as rt:
        channel = await rt.channel("cam/a", max_age="60s")
        queue = await rt.queue("work/a", host=channel.host)
        await channel.put(b"lost")
        await queue.put(b"lost")
        frozen = owner(cluster, channel)
        frozen.pause()
        put, item, _, enqueued = await asyncio.gather(
            channel.put(b"goes on elsewhere"),
            channel.newest(timeout=30),
            channel.stats(),
            queue.put(b"waits for room if there is none"),
        )
        assert put.incarnation == channel.incarnation
        assert (item.payload, enqueued.seq) == (b"goes on elsewhere", 1)
        frozen.resume()


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


def pause_with_large_payload(frozen: ServiceProcess) -> bytes:
    """Stop the host. Returns a payload so large that only eight puts of it may be in flight."""
    frozen.pause()
    return bytes(2**20)


def test_a_producers_put_does_not_wait_for_ever(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        channel = rt.channel("cam/a", max_age="60s")
        producer = channel.producer()
        producer.put(b"before")
        producer.flush()
        frozen = owner(cluster, channel)
        payload, handed_over = pause_with_large_payload(frozen), 0
        error_text = ""
        while not error_text:
            try:
                producer.put(payload, timeout=0.2)
                handed_over += 1
            except st.DeadlineExceeded as error:
                error_text = error.message
        assert "the host of channel 'cam/a' did not acknowledge" in error_text
        assert handed_over >= 8
        frozen.resume()
        producer.flush(30)
        assert producer.accepted == 1 + handed_over  # the producer did not take the put that raised
        producer.close()


async def test_an_awaited_producers_put_does_not_wait_for_ever(cluster: LocalCluster) -> None:
    async with aio.connect(cluster.address) as rt:
        channel = await rt.channel("cam/a", max_age="60s")
        producer = channel.producer()
        await producer.put(b"before")
        await producer.flush()
        frozen = owner(cluster, channel)
        payload, handed_over = pause_with_large_payload(frozen), 0
        error_text = ""
        while not error_text:
            try:
                await producer.put(payload, timeout=0.2)
                handed_over += 1
            except st.DeadlineExceeded as error:
                error_text = error.message
        assert "the host of channel 'cam/a' did not acknowledge" in error_text
        assert handed_over >= 8
        frozen.resume()
        await producer.flush(30)
        assert producer.accepted == 1 + handed_over
        await producer.aclose()
