"""Subscriptions, on every surface."""

from __future__ import annotations

import asyncio

import pytest

import stampede_rt as st
from tests.contract.surfaces import Surface, take

MS = 1_000_000


async def test_a_subscription_without_a_start_yields_only_new_items(surface: Surface) -> None:
    channel = await surface.channel()
    await channel.put(b"before")
    async with channel.subscribe() as items:
        await channel.put(b"after")
        assert [item.payload for item in await take(items, 1)] == [b"after"]


async def test_a_subscription_with_a_start_yields_held_items_first_in_the_order_of_seqs(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 1_000 * MS
    for offset in (30, 10, 20, 5):
        await channel.put(str(offset).encode(), time=base + offset * MS)
    async with channel.subscribe(start=base + 10 * MS) as items:
        await channel.put(b"late", time=base)
        assert [item.payload for item in await take(items, 4)] == [b"30", b"10", b"20", b"late"]


async def test_a_subscription_yields_each_item_once_however_puts_and_reads_interleave(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 1_000 * MS
    async with channel.subscribe() as items:
        async with channel.producer() as producer:
            for number in range(1_000):
                await producer.put(number.to_bytes(2, "big"), time=base + (number * 7919 % 1000) * 1000)
        found = await take(items, 1_000)
    assert [int.from_bytes(item.payload, "big") for item in found] == list(range(1_000))
    assert [item.seq for item in found] == list(range(found[0].seq, found[0].seq + 1_000))


async def test_a_newest_subscription_never_goes_back_and_counts_skipped_items(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 1_000 * MS
    async with channel.subscribe(mode="newest") as items:
        for offset in (10, 5, 20):
            await channel.put(str(offset).encode(), time=base + offset * MS)
        found = await take(items, 1)
        while found[-1].payload != b"20":
            found += await take(items, 1)
    times = [item.time for item in found]
    assert times == sorted(times)
    assert base + 5 * MS not in times


async def test_a_subscription_after_an_item_begins_with_the_next_one(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    first = await channel.put(b"1")
    await channel.put(b"2")
    async with channel.subscribe(after=first) as items:
        await channel.put(b"3")
        assert [item.payload for item in await take(items, 2)] == [b"2", b"3"]


async def test_items_that_retention_removed_before_a_slow_reader_read_them_are_reported(surface: Surface) -> None:
    channel = await surface.channel(max_items=2)
    first = await channel.put(b"1")
    for number in range(2, 7):
        await channel.put(str(number).encode())
    async with channel.subscribe(after=first) as items:
        assert [item.payload for item in await take(items, 2)] == [b"5", b"6"]
        assert items.dropped == 3


async def test_a_subscription_without_payloads_has_their_lengths(surface: Surface) -> None:
    channel = await surface.channel()
    async with channel.subscribe(payloads=False) as items:
        await channel.put(b"12345")
        (item,) = await take(items, 1)
    assert (item.payload, item.payload_length_bytes) == (None, 5)


async def test_close_ends_the_iteration(surface: Surface) -> None:
    channel = await surface.channel()
    async with channel.subscribe() as items:
        await channel.put(b"1")
        await take(items, 1)
        step = asyncio.ensure_future(anext(items, None))
        items.close()
        async with asyncio.timeout(45):
            assert await step is None


async def test_a_wrong_mode_is_refused(surface: Surface) -> None:
    channel = await surface.channel()
    with pytest.raises(st.InvalidArgument, match="mode"):
        async with channel.subscribe(mode="latest"):
            pass
