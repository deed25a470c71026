"""Batches of subscriptions, over each transport with both clients."""

from __future__ import annotations

import random
from collections.abc import AsyncIterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt.pacing import crediting
from stampede_rt.pacing.crediting import WINDOW_BYTES_MAX
from tests.contract.surfaces import Surface, take
from tests.contract.test_resumed_streams import cut_off

MS = 1_000_000
ITEMS = 1_000
pytestmark = pytest.mark.parametrize("surface", ["aio", "sync"], indirect=True)


async def taken(batches: AsyncIterator[Any], count: int) -> list[tuple[int, int, bytes | None]]:
    """Return the columns of the next batches, which must have `count` items."""
    rows = list[tuple[int, int, bytes | None]]()
    while len(rows) < count:
        (batch,) = await take(batches, 1)
        rows += zip(batch.times, batch.seqs, batch.payloads, strict=True)
    assert len(rows) == count
    return rows


async def put_numbers(channel: Any, count: int) -> list[tuple[int, bytes]]:
    """Put numbers, some with payloads of several KiB. Return the times and the payloads."""
    base, rows = st.now() - 2 * count * MS, list[tuple[int, bytes]]()
    async with channel.producer() as producer:
        for number in range(count):
            rows.append((base + number * MS, b"%d" % number + bytes(5_000 if number % 50 == 7 else 0)))
            await producer.put(rows[-1][1], time=rows[-1][0])
    return rows


async def test_batches_have_each_item_once_and_in_order(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    async with channel.subscribe() as items:
        put = await put_numbers(channel, ITEMS)
        rows = await taken(items.batches(), ITEMS)
    assert [(time, payload) for time, _, payload in rows] == put
    assert [seq for _, seq, _ in rows] == [*range(rows[0][1], rows[0][1] + ITEMS)]


async def test_steps_and_batches_of_one_subscription_take_turns(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    rng, seqs = random.Random(1), list[int]()
    async with channel.subscribe() as items:
        await put_numbers(channel, ITEMS)
        batches = items.batches()
        while len(seqs) < ITEMS:
            if rng.random() < 0.9:
                seqs.append((await take(items, 1))[0].seq)
            else:
                seqs += (await take(batches, 1))[0].seqs
    assert seqs == [*range(seqs[0], seqs[0] + ITEMS)]


async def test_a_batch_of_the_newest_has_one_item(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    async with channel.subscribe(mode="newest") as items:
        await channel.put(b"skipped")
        await channel.put(b"newest")
        assert [payload for _, _, payload in await taken(items.batches(), 1)] == [b"newest"]
        assert items.skipped == 1


async def test_batches_of_a_resumed_subscription_have_no_gap_and_no_repetition(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    put, seqs = list[int](), list[int]()
    async with channel.subscribe() as items:
        batches = items.batches()
        for number in range(20):
            put += [(await channel.put(b"%d" % number)).seq, (await channel.put(b"again")).seq]
            if number % 3:
                cut_off(items)
            if number % 2:
                while len(seqs) < len(put):
                    seqs += (await take(batches, 1))[0].seqs
        assert (items.skipped, items.dropped) == (0, 0)
    assert seqs == put


async def test_batches_without_payloads_have_none_in_the_column(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    async with channel.subscribe(payloads=False) as items:
        await channel.put(b"abc")
        (batch,) = await take(items.batches(), 1)
    assert (batch.payloads, batch[0].payload_length_bytes) == ([None], 3)


async def test_items_of_a_batch_have_values_and_its_column_has_the_payloads(surface: Surface) -> None:
    channel = await surface.channel(codec="json")
    async with channel.subscribe() as items:
        await channel.put({"a": 1})
        (batch,) = await take(items.batches(), 1)
    assert ([item.value for item in batch], batch.payloads) == ([{"a": 1}], [b'{"a":1}'])


async def test_close_ends_the_batches(surface: Surface) -> None:
    channel = await surface.channel()
    async with channel.subscribe() as items:
        batches = items.batches()
        await channel.put(b"1")
        await taken(batches, 1)
    assert [batch async for batch in batches] == []


async def test_a_reader_that_stops_between_batches_has_a_bounded_number_of_unread_items(surface: Surface) -> None:
    channel = await surface.channel(max_items=4)
    size, count = 2**16, 100
    async with channel.subscribe() as items:
        batches = items.batches()
        for _ in range(count):  # the reader is fast, so the host sends ahead
            await channel.put(b"quick" + bytes(size))
            await taken(batches, 1)
        for number in range(count):
            await channel.put(number.to_bytes(1, "big") + bytes(size))
        found = list[int]()
        while not found or found[-1] != count - 1:
            found += [payload[0] for payload in (await take(batches, 1))[0].payloads]
        assert found == sorted({*found})
        assert len(found[:-4]) * size <= WINDOW_BYTES_MAX
        assert items.dropped == count - len(found)


async def test_a_reader_that_works_long_on_a_batch_gets_all_items_that_came_meanwhile(
    surface: Surface, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(crediting, "QUICK_S", 0.0)  # every reader counts as slow
    channel, count = await surface.channel(max_age="60s"), 50
    async with channel.subscribe() as items:
        batches = items.batches()
        await channel.put(b"first")
        await taken(batches, 1)
        for _ in range(3):
            for number in range(count):
                await channel.put(b"%d" % number)
            (batch,) = await take(batches, 1)
            assert batch.payloads == [b"%d" % number for number in range(count)]


async def test_single_steps_after_batches_of_a_slow_reader_miss_nothing(
    surface: Surface, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(crediting, "QUICK_S", 0.0)
    channel, rng, seqs = await surface.channel(max_age="60s"), random.Random(2), list[int]()
    async with channel.subscribe() as items:
        batches = items.batches()
        for number in range(200):
            await channel.put(b"%d" % number)
            turn = rng.randrange(4)
            if turn == 0 and len(seqs) <= number:
                seqs.append((await take(items, 1))[0].seq)
            elif turn == 1 and len(seqs) <= number:
                seqs += (await take(batches, 1))[0].seqs
        while len(seqs) < 200:
            seqs.append((await take(items, 1))[0].seq)
    assert seqs == [*range(seqs[0], seqs[0] + 200)]


async def test_batches_through_a_group_have_the_visible_items(surface: Surface) -> None:
    channel, other = await surface.channel(max_age="60s"), await surface.channel(max_age="60s")
    group = await surface.group(f"batches/{st.now()}", [channel, other], reference="oldest")
    base = st.now() - 1_000 * MS
    async with group[channel].subscribe() as items:
        for number in range(10):
            await channel.put(b"%d" % number, time=base + number * MS)
        await other.put(b"", time=base + 5 * MS)
        rows = await taken(items.batches(), 5)
    assert [payload for _, _, payload in rows] == [b"%d" % number for number in range(5)]
