"""Puts, producers, advances, retention and counters, on every surface."""

from __future__ import annotations

import asyncio
import itertools

import pytest

import stampede_rt as st
from tests.contract.surfaces import Surface

MS = 1_000_000
SECOND = 1_000 * MS
LONG_S = 60


async def consistent_stats(channel: object) -> st.ChannelStats:
    """The counters of the channel. Fails unless each accepted item is held or was collected."""
    stats = await channel.stats()
    assert stats.accepted == stats.held + sum(stats.collected.values())
    return stats


async def test_seqs_grow_by_one(surface: Surface) -> None:
    channel = await surface.channel()
    seqs = [(await channel.put(b"x")).seq for _ in range(3)]
    assert seqs == [seqs[0], seqs[0] + 1, seqs[0] + 2]


async def test_a_put_stamped_by_the_host_is_accepted_after_an_advance_into_the_future(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s", max_future="60s")
    ahead = await channel.advance(st.now() + 30_000_000_000)
    assert (await channel.put(b"stamped")).time == ahead


async def test_a_put_earlier_than_an_advance_is_too_old(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    time = st.now() - SECOND
    assert await channel.advance(time) == time
    with pytest.raises(st.TooOld, match="advance"):
        await channel.put(b"x", time=time - 1)
    await channel.put(b"x", time=time)
    assert await channel.advance(time - 5) == time


async def test_a_put_before_the_window_is_too_old(surface: Surface) -> None:
    channel = await surface.channel(max_age="1s")
    await channel.put(b"newest", time=st.now() - 30 * SECOND)
    with pytest.raises(st.TooOld):
        await channel.put(b"x", time=st.now() - 60 * SECOND)
    assert (await consistent_stats(channel)).rejected["too_old"] == 1


async def test_the_error_of_a_put_far_in_the_future_names_the_clock_offset(surface: Surface) -> None:
    channel = await surface.channel()
    with pytest.raises(st.InFuture) as caught:
        await channel.put(b"x", time=st.now() + 60 * SECOND)
    assert 30 * SECOND < int(caught.value.metadata["offset_nanos"]) <= 60 * SECOND
    assert (await consistent_stats(channel)).rejected["in_future"] == 1


async def test_max_items_drops_the_oldest(surface: Surface) -> None:
    channel = await surface.channel(max_items=3)
    for number in range(5):
        await channel.put(bytes([number]))
    assert [item.payload for item in await channel.get(st.OLDEST, st.NEWEST)] == [b"\2", b"\3", b"\4"]
    stats = await consistent_stats(channel)
    assert (stats.accepted, stats.held, stats.collected["count"]) == (5, 3, 2)


async def test_max_bytes_drops_the_oldest(surface: Surface) -> None:
    channel = await surface.channel(max_bytes=3 * (1000 + 64))
    for _ in range(5):
        await channel.put(bytes(1000))
    stats = await consistent_stats(channel)
    assert (stats.held, stats.collected["bytes"], stats.held_bytes) == (3, 2, 3000)


async def test_an_item_larger_than_max_bytes_is_refused(surface: Surface) -> None:
    channel = await surface.channel(max_bytes=1000)
    with pytest.raises(st.ItemTooLarge, match="at most 936"):
        await channel.put(bytes(2000))
    assert (await consistent_stats(channel)).rejected["too_large"] == 1


async def test_a_full_channel_that_rejects_refuses_a_put(surface: Surface) -> None:
    channel = await surface.channel(max_items=1, on_full="reject")
    await channel.put(b"first")
    with pytest.raises(st.ChannelFull):
        await channel.put(b"second")
    assert (await consistent_stats(channel)).rejected["full"] == 1


async def test_a_put_on_a_full_channel_waits_until_the_oldest_item_is_old_enough(surface: Surface) -> None:
    channel = await surface.channel(max_items=1, max_age="100ms", on_full="block")
    first = await channel.put(b"first")
    second = await channel.put(b"second", timeout=10)
    assert second.time - first.time >= 100 * MS
    assert [item.payload for item in await channel.get(st.OLDEST, st.NEWEST)] == [b"second"]
    assert (await consistent_stats(channel)).collected["age"] == 1


async def test_a_put_with_no_time_to_wait_is_refused_by_a_full_channel_immediately(surface: Surface) -> None:
    channel = await surface.channel(max_items=1, max_age="1h", on_full="block")
    await channel.put(b"first")
    with pytest.raises(st.ChannelFull):
        await channel.put(b"second", timeout=0)
    assert (await consistent_stats(channel)).held == 1


async def test_a_put_waits_until_an_item_from_the_future_is_old_enough(surface: Surface) -> None:
    channel = await surface.channel(max_items=1, max_age="100ms", on_full="block")
    ahead = await channel.put(b"ahead", time=st.now() + 300 * MS)
    late = await channel.put(b"late", timeout=LONG_S)
    assert late.time - ahead.time > 100 * MS


async def test_waiting_puts_are_admitted_one_by_one(surface: Surface) -> None:
    channel = await surface.channel(max_items=1, max_age="100ms", on_full="block")
    first = await channel.put(b"first")
    handles = [await surface.channel(channel.name) for _ in range(2)]
    puts = [handle.put(b"later", timeout=LONG_S) for handle in handles]
    items = sorted(await asyncio.gather(*puts), key=lambda item: item.seq)
    for before, after in itertools.pairwise([first, *items]):
        assert after.time - before.time > 100 * MS


async def test_max_age_keeps_the_newest_bucket_of_a_quiet_stream(surface: Surface) -> None:
    channel = await surface.channel(max_age="50ms")
    base = st.now() - 40 * MS
    await channel.put(b"old", time=base)
    await channel.put(b"new", time=base + MS)
    items = await channel.get(st.NOW + "1s", st.NOW + "2s", match="start", timeout=0.15)
    assert not items  # only to let time pass
    assert [item.payload for item in await channel.get(st.OLDEST, st.NEWEST)] == [b"new"]
    assert (await consistent_stats(channel)).collected["age"] == 1


async def test_a_producer_keeps_order_and_loses_nothing(surface: Surface) -> None:
    channel = await surface.channel(max_items=10_000)
    async with channel.producer() as producer:
        for number in range(5_000):
            await producer.put(number.to_bytes(2, "big"))
        await producer.flush()
        assert producer.accepted == 5_000
    items = await channel.get(st.OLDEST, st.NEWEST)
    assert [int.from_bytes(item.payload, "big") for item in sorted(items, key=lambda item: item.seq)] == list(
        range(5_000)
    )


async def test_a_producer_gets_the_errors_of_refused_items(surface: Surface) -> None:
    channel = await surface.channel(max_age="1s")
    async with channel.producer() as producer:
        await producer.put(b"good", time=st.now() - 30 * SECOND)
        await producer.put(b"bad", time=st.now() - 60 * SECOND)
        await producer.put(b"good")
        with pytest.raises(st.TooOld):
            await producer.flush()
        assert (producer.accepted, producer.rejections) == (2, 1)


async def test_a_payload_must_be_bytes(surface: Surface) -> None:
    channel = await surface.channel()
    with pytest.raises(st.InvalidArgument, match="encode"):
        await channel.put("text")
