"""After a cancelled, closed or broken stream the client loses and duplicates no item, and does not hang or leak."""

from __future__ import annotations

import asyncio
import gc
import threading
from functools import partial
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.support.sharing.shared_cluster import shared_cluster_fixture
from tests.support.waiting import until

cluster = shared_cluster_fixture(hosts=1)
LIMIT_S = 10.0


async def test_a_cancelled_step_of_a_subscription_causes_no_gap_and_no_duplicate(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        channel = await rt.channel("client/cancelled", max_age="60s")
        await channel.put(b"1")
        subscription = channel.subscribe(start=st.OLDEST)
        async with subscription:
            assert (await anext(subscription)).payload == b"1"
            step = asyncio.ensure_future(anext(subscription))
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(step, 0.05)
            await channel.put(b"2")
            async with asyncio.timeout(LIMIT_S):
                assert (await anext(subscription)).payload == b"2"


async def test_a_cancelled_step_of_a_subscription_to_new_items_loses_no_item(
    cluster: LocalCluster,
) -> None:
    async with await aio.connect(cluster.address) as rt:
        channel = await rt.channel("client/cancelled-new", max_age="60s")
        async with channel.subscribe() as subscription:
            with pytest.raises(TimeoutError):
                await asyncio.wait_for(anext(subscription), 0.05)
            await channel.put(b"between")
            async with asyncio.timeout(LIMIT_S):
                assert (await anext(subscription)).payload == b"between"


async def test_closing_the_connection_ends_a_task_that_reads_with_an_error_and_no_cancellation(
    cluster: LocalCluster,
) -> None:
    rt = await aio.connect(cluster.address)
    channel = await rt.channel("client/closed", max_age="60s")
    subscription = channel.subscribe()
    await subscription.__aenter__()
    reader = asyncio.ensure_future(anext(subscription))
    waiter = asyncio.ensure_future(channel.newest(timeout=None))
    await channel.put(b"the get is answered, and so under way before")
    await asyncio.wait([waiter], timeout=LIMIT_S)
    assert (await reader).payload
    reader = asyncio.ensure_future(anext(subscription))
    await asyncio.sleep(0)
    await rt.aclose()
    with pytest.raises(st.Unavailable, match="closed"):
        await asyncio.wait_for(reader, LIMIT_S)


async def test_a_connection_opens_a_further_stream_for_more_waiting_gets(cluster: LocalCluster) -> None:
    """In an earlier version, the host refused gets beyond 1024, the client repeated them, and some failed in the
    end.
    """
    async with await aio.connect(cluster.address) as rt:
        channel = await rt.channel("client/crowd", max_age="60s")
        await channel.newest()
        gets = [asyncio.ensure_future(channel.newest(timeout=60)) for _ in range(1100)]
        while (await channel.stats()).waiting_gets < len(gets):
            assert not any(get.done() for get in gets)
        item = await channel.put(b"for all")
        assert {got.seq for got in await asyncio.gather(*gets) if got} == {item.seq}


async def test_many_simultaneous_lookups_of_a_channel_make_one_request(
    cluster: LocalCluster, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In an earlier version, before the first get waited, all gets on a new handle had sent a request to the
    gatekeeper.
    """
    async with await aio.connect(cluster.address) as rt:
        channel = await rt.channel("client/herd", max_age="60s")
        bind_requests, bind_at = [], rt._session._bind_at

        async def count(*arguments: Any) -> Any:
            bind_requests.append(arguments)
            return await bind_at(*arguments)

        monkeypatch.setattr(rt._session, "_bind_at", count)
        await asyncio.gather(*(channel.newest() for _ in range(100)))
        assert len(bind_requests) == 1


def test_every_call_on_a_closed_connection_is_refused(cluster: LocalCluster) -> None:
    rt = st.connect(cluster.address)
    channel = rt.channel("client/after-close")
    watch = rt.watch()
    rt.close()
    for use in (rt.channels, rt.hosts, channel.newest, partial(channel.put, b"x"), partial(rt.channel, "another")):
        with pytest.raises(st.Unavailable, match="closed"):
            use()
    with pytest.raises(st.Unavailable, match="closed"):
        next(watch)


def test_closing_the_connection_ends_a_thread_that_watches(cluster: LocalCluster) -> None:
    rt = st.connect(cluster.address)
    met: list[BaseException] = []
    watch = rt.watch()

    def look() -> None:
        try:
            for _ in watch:
                pass
        except st.StampedeError as error:
            met.append(error)

    thread = threading.Thread(target=look, daemon=True)
    thread.start()
    rt.close()
    thread.join(LIMIT_S)
    assert not thread.is_alive()
    assert isinstance(met[0], st.Unavailable)


async def until_put_streams(rt: Any) -> Any:
    """Return the open put streams as soon as there is one, even before it is connected."""
    streams = rt._session.put_streams._streams
    async with asyncio.timeout(LIMIT_S):
        while not streams:  # noqa: ASYNC110  (a pause could outlast the opening)
            await asyncio.sleep(0)
    return streams


async def lose(response: Any) -> None:
    """Lose an answer on a stream."""


def are_under_way(rt: Any) -> bool:
    """Whether puts or gets wait for answers on the streams of a connection."""
    exchanges = [stream.exchange for stream in rt._session.put_streams._streams.values()]
    for endpoint in rt._session.endpoints._endpoints.values():
        exchanges += endpoint._gets
    return any(exchange._waiting for exchange in exchanges)


async def test_puts_on_a_broken_stream_end(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        channel = await rt.channel("client/broken", max_age="60s")
        await channel.put(b"opens the stream")
        (stream,) = (await until_put_streams(rt)).values()
        stream.exchange._receive = lose
        puts = [asyncio.ensure_future(channel.put(b"%d" % number)) for number in range(3)]
        await until(lambda: len(stream.exchange._waiting) == len(puts))
        stream.exchange.cancel()
        async with asyncio.timeout(LIMIT_S):
            await asyncio.gather(*puts)
        items = await channel.get(st.OLDEST, st.NEWEST)
        assert sorted(item.payload for item in items) == [b"0", b"1", b"2", b"opens the stream"]


async def test_a_put_cancelled_while_its_stream_opens_delays_no_other_put(cluster: LocalCluster) -> None:
    """In an earlier version, the second put waited for ever for the stream that the cancelled put had been opening."""
    async with await aio.connect(cluster.address) as rt:
        channel = await rt.channel("client/opening", max_age="60s")
        await channel.stats()
        first, second = (asyncio.ensure_future(channel.put(payload)) for payload in (b"first", b"second"))
        await until_put_streams(rt)
        first.cancel()
        async with asyncio.timeout(LIMIT_S):
            assert (await second).payload == b"second"
            assert (await channel.put(b"third")).payload == b"third"
        assert first.cancelled()


async def test_puts_do_not_wait_for_a_stream_that_was_given_up_while_it_opened(cluster: LocalCluster) -> None:
    """In such a stream a write of gRPC waits for ever."""
    async with await aio.connect(cluster.address) as rt:
        channel = await rt.channel("client/given-up", max_age="60s")
        await channel.stats()
        put = asyncio.ensure_future(channel.put(b"x", timeout=LIMIT_S))
        (stream,) = (await until_put_streams(rt)).values()
        stream.exchange.cancel()
        async with asyncio.timeout(LIMIT_S):
            assert (await put).payload == b"x"


async def test_closing_a_connection_ends_calls_that_wait_for_a_stream(cluster: LocalCluster) -> None:
    rt = await aio.connect(cluster.address)
    channel = await rt.channel("client/closing", max_age="60s")
    queue = await rt.queue("client/closing", host=channel.host)
    await channel.stats()
    calls = [asyncio.ensure_future(call) for call in (channel.put(b"x"), channel.newest(), queue.put(b"x"))]
    take, producer = asyncio.ensure_future(queue.get()), channel.producer()
    await producer.put(b"x")
    await until_put_streams(rt)
    async with asyncio.timeout(LIMIT_S):
        await rt.aclose()
        for call in (*calls, take):
            with pytest.raises(st.Unavailable, match="closed"):
                await call
        with pytest.raises(st.StampedeError):
            await producer.flush(timeout=5)


async def test_cancelled_calls_leave_no_unretrieved_exception(
    cluster: LocalCluster, caplog: pytest.LogCaptureFixture
) -> None:
    async with await aio.connect(cluster.address) as rt:
        channel = await rt.channel("client/unretrieved", max_age="60s")
        await channel.stats()
        for call in (channel.put, channel.get):
            pending = [asyncio.ensure_future(call(*([b"x"] if call == channel.put else [st.OLDEST, st.NEWEST])))]
            async with asyncio.timeout(LIMIT_S):
                while not are_under_way(rt):  # noqa: ASYNC110  (a pause could outlast the call)
                    await asyncio.sleep(0)
            pending[0].cancel()
            await asyncio.wait(pending)
            for stream in rt._session.put_streams._streams.values():
                stream.exchange.cancel()
    gc.collect()
    await asyncio.sleep(0)
    assert not [record for record in caplog.records if "never retrieved" in record.getMessage()]


async def test_a_producer_whose_stream_breaks_repeatedly_has_no_gap_and_no_duplicate(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        channel, broken = await rt.channel("client/producer", max_age="60s", max_items=100_000), 0
        async with channel.producer() as producer:
            for number in range(20_000):
                await producer.put(b"%d" % number)
                if number % 3_000 == 2_999 and producer._stream is not None:
                    producer._stream._duplex._call.cancel()
                    broken += 1
            await producer.flush()
        assert producer.accepted == 20_000
        assert (await channel.stats()).accepted == 20_000
        items = await channel.get(st.OLDEST, st.NEWEST)
        assert broken > 1
        assert [item.payload for item in items] == [b"%d" % number for number in range(len(items))]


async def test_binding_again_at_the_same_host_leaves_no_stream_open(cluster: LocalCluster) -> None:
    async with await aio.connect(cluster.address) as rt:
        channel = await rt.channel("client/rebound", max_age="60s")
        await channel.put(b"1")
        tasks = len(asyncio.all_tasks())
        for number in range(5):
            rt._session.cache.forget(channel.info.channel_id)
            await channel.put(b"%d" % number)
        await until(lambda: len(asyncio.all_tasks()) <= tasks)
