"""Handles, subscriptions and producers that a program drops without closing them: their streams end with these
objects.
"""

from __future__ import annotations

import asyncio
import gc
import threading
from typing import Literal

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt._async import put_streams as put_streams_async
from stampede_rt._sync import put_streams as put_streams_sync
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture
from tests.support.waiting import pause, until, wait_until

cluster = shared_cluster_fixture(hosts=1)
HANDLES = 600
LEFT_MAX = 40
LIMIT_S = 20.0


async def until_a_put_waits(channel: aio.Channel) -> None:
    async with asyncio.timeout(LIMIT_S):
        while not (await channel.stats()).waiting_puts:
            await pause()


def test_dropped_handles_of_channels_leave_no_stream_open(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        rt.channel("dropped/0").put(b"x")
        streams, before = rt._session.put_streams._streams, threading.active_count()
        most = 0
        for number in range(HANDLES):
            rt.channel(f"dropped/{number % 20}", max_items=5).put(b"x")
            most = max(most, len(streams))
        assert most == 1, "all handles share the stream of this thread"
        wait_until(lambda: threading.active_count() <= before)


async def test_dropped_handles_of_channels_leave_no_stream_open_in_asyncio(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        await (await rt.channel("dropped/first")).put(b"x")  # opens the stream of all handles
        streams, before = rt._session.put_streams._streams, len(asyncio.all_tasks())
        most = 0
        for number in range(HANDLES):
            on_full: Literal["block"] | None = None if number % 2 else "block"
            channel = await rt.channel(f"dropped/awaited/{number % 20}", max_items=500, max_age="60s", on_full=on_full)
            await channel.put(b"x")
            del channel
            most = max(most, len(streams))
        assert most < LEFT_MAX
        await until(lambda: len(streams) == 1 and len(asyncio.all_tasks()) <= before)


async def test_asyncio_handles_dropped_by_another_thread_are_closed(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        held = [await rt.channel("dropped/elsewhere", max_items=5, max_age="60s", on_full="block")]
        await held[0].put(b"x")
        dropping = threading.Thread(target=held.clear)
        dropping.start()
        await until(lambda: not rt._session.put_streams._streams)
        dropping.join()


async def test_a_handle_that_is_dropped_after_the_end_of_its_loop_raises_no_warning(cluster: LocalCluster) -> None:
    async def opened() -> tuple[aio.Connection, aio.Channel, aio.Queue]:
        rt = await aio.connect(cluster.address)
        channel, queue = await rt.channel("dropped/late", max_items=5), await rt.queue("dropped/late")
        await channel.put(b"x")
        await queue.put(b"x")
        await rt.aclose()
        return rt, channel, queue

    held = [await asyncio.to_thread(asyncio.run, opened())]
    held.clear()
    gc.collect()


def test_dropped_handles_of_queues_leave_no_stream_open(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        rt.queue("dropped/0").put(b"x")
        before = threading.active_count()
        for number in range(150):
            queue = rt.queue(f"dropped/{number % 5}")
            queue.put(b"%d" % number)
            message = queue.get(timeout=5)
            assert message is not None
            message.ack()
        del queue, message
        wait_until(lambda: not rt._session._attached and len(rt._session.put_streams._streams) == 1)
        wait_until(lambda: threading.active_count() <= before)


async def test_dropped_asyncio_handles_of_queues_nack_prefetched_messages(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        for number in range(10):
            queue = await rt.queue("dropped/prefetched", prefetch=10, lease="60s")
            if not number:
                for payload in (b"a", b"b", b"c"):
                    await queue.put(payload)
            message = await queue.get(timeout=5)
            assert message is not None
            assert message.payload == b"a"
            await message.nack()
            del queue, message
            await until(lambda: not rt._session._attached)


async def test_subscriptions_and_producers_that_are_dropped_end(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        channel = await rt.channel("dropped/subscribed", max_items=500)
        before = len(asyncio.all_tasks())
        for number in range(100):
            subscription = channel.subscribe(start=st.OLDEST)
            async with channel.producer() as closed:
                await closed.put(b"%d" % number)
            await anext(subscription)
        del subscription, closed
        for _ in range(200):
            if not (await channel.stats()).subscriptions:
                break
        assert (await channel.stats()).subscriptions == 0
        await until(lambda: len(asyncio.all_tasks()) <= before)


async def test_dropped_asyncio_producers_close_their_streams_when_their_items_are_acked(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        channel = await rt.channel("dropped/produced", max_items=500)
        await channel.put(b"x")
        before = len(asyncio.all_tasks())
        for number in range(50):
            producer = channel.producer()
            for _ in range(3):
                await producer.put(b"%d" % number)
        del producer
        await until(lambda: len(asyncio.all_tasks()) <= before)
        assert (await channel.stats()).accepted == 151


def test_dropped_producers_close_their_streams_when_their_items_are_acked(cluster: LocalCluster) -> None:
    with st.connect(cluster.address) as rt:
        channel = rt.channel("dropped/produced-by-threads", max_items=500)
        channel.put(b"x")
        before = threading.active_count()
        for number in range(50):
            producer = channel.producer()
            for _ in range(3):
                producer.put(b"%d" % number)
        del producer
        wait_until(lambda: threading.active_count() <= before)
        assert channel.stats().accepted == 151


def test_a_connection_that_was_closed_leaves_no_thread_although_its_handles_are_kept(cluster: LocalCluster) -> None:
    before = set(threading.enumerate())
    with st.connect(cluster.address, transport="grpc") as rt:  # over sockets the client has no threads of its own
        channels = [rt.channel(f"dropped/closed/{number}", max_items=5) for number in range(3)]
        for channel in channels:
            channel.put(b"x")
            worker = threading.Thread(target=channel.newest)
            worker.start()
            worker.join()
        started = set(threading.enumerate()) - before
        assert started
    wait_until(lambda: started.isdisjoint(threading.enumerate()))
    assert len(channels) == 3


def test_the_client_closes_the_least_recently_used_streams_of_many_kept_handles(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(put_streams_sync, "STREAMS_MAX", 8)
    with st.connect(cluster.address) as rt:
        channels = [rt.channel(f"dropped/kept/{number}", max_items=5) for number in range(30)]
        for _ in range(2):
            for channel in channels:
                channel.put(b"x")
                assert len(rt._session.put_streams._streams) <= 8
        assert [channel.stats().accepted for channel in channels] == [2] * 30


async def test_a_put_is_not_delayed_by_a_put_with_a_longer_timeout(cluster: LocalCluster) -> None:
    """In an earlier version, the ack of the short put came after the ack of the long one.

    The short put failed as if the host were overloaded.
    """
    async with await aio.connect(cluster.address) as rt:
        full = await rt.channel("dropped/longer", max_items=1, max_age="60s", on_full="block")
        await full.put(b"first")
        patient = [asyncio.ensure_future(full.put(b"%d" % number, timeout=60)) for number in range(2, 4)]
        await until_a_put_waits(full)
        with pytest.raises(st.ChannelFull):
            await full.put(b"hasty", timeout=0.1)
        with pytest.raises(st.ChannelFull):
            await full.put(b"without a timeout", timeout=0)
        assert len(rt._session.put_streams._streams) == 2  # puts with equal time limits share one stream
        await full.configure(max_items=5)
        async with asyncio.timeout(LIMIT_S):
            assert [(await put).seq for put in patient] == [2, 3]


async def test_each_of_many_waiting_puts_has_its_own_timeout(cluster: LocalCluster) -> None:
    """In an earlier version, each put waited for the puts before it, then waited again, and failed as if the host were
    overloaded.
    """
    async with await aio.connect(cluster.address) as rt:
        full = await rt.channel("dropped/side-by-side", max_items=1, max_age="60s", on_full="block")
        queue = await rt.queue("dropped/side-by-side", max_items=1)
        await full.put(b"first")
        await queue.put(b"first")
        puts = [full.put(b"x", timeout=0.5) for _ in range(40)] + [queue.put(b"x", timeout=0.5) for _ in range(40)]
        failures = await asyncio.gather(*puts, return_exceptions=True)
        assert {type(failure) for failure in failures} == {st.ChannelFull, st.QueueFull}
        await full.configure(max_items=3)
        await queue.configure(max_items=3)
        seqs = await asyncio.gather(*(queue.put(b"%d" % number, timeout=60) for number in range(2)))
        assert [one.seq for one in seqs] == [2, 3]
        assert [(await full.put(b"x")).seq for _ in range(2)] == [2, 3]


async def test_a_stream_with_a_put_that_waits_is_not_closed_for_others(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(put_streams_async, "STREAMS_MAX", 2)
    async with await aio.connect(cluster.address) as rt:
        full = await rt.channel("dropped/full", max_items=1, max_age="60s", on_full="block")
        await full.put(b"first")
        waiting = asyncio.ensure_future(full.put(b"second"))
        await until_a_put_waits(full)
        others = [await rt.channel(f"dropped/others/{number}", max_items=5) for number in range(6)]
        for other in others:
            await other.put(b"x")
        assert (await full.stats()).waiting_puts == 1
        await full.configure(max_items=5)
        async with asyncio.timeout(LIMIT_S):
            assert (await waiting).seq == 2


async def test_a_waiting_put_does_not_delay_a_put_without_a_timeout(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        channel = await rt.channel("dropped/two-lines", max_items=1, max_age="60s", on_full="block")
        await channel.put(b"first")
        waiting = asyncio.ensure_future(channel.put(b"second"))
        await until_a_put_waits(channel)
        with pytest.raises(st.ChannelFull):
            await channel.put(b"third", timeout=0)
        assert not waiting.done()
        await channel.delete()
        with pytest.raises(st.ChannelNotFound):
            await waiting
