"""Readers that pause: items wait at the host, and the next item that the reader takes is not old."""

from __future__ import annotations

import asyncio
import inspect
import itertools
import threading
from collections.abc import AsyncIterator
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt.pacing.crediting import WINDOW_BYTES_MAX
from stampede_rt_local.cluster import LocalCluster
from tests.contract.surfaces import Surface, connected, take
from tests.support.waiting import pause

MS = 1_000_000
ITEMS = 40
_names = itertools.count()


@pytest.fixture(params=["aio", "sync"])
async def pair(request: pytest.FixtureRequest, grouped_cluster: LocalCluster) -> AsyncIterator[Surface]:
    """Yield a connection to a cluster with two hosts."""
    async with connected(request.param, grouped_cluster.address) as surface:
        yield surface


async def test_a_newest_subscription_yields_the_newest_item_at_the_moment_of_the_request(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    async with channel.subscribe(mode="newest") as items:
        await channel.put(b"first")
        assert (await take(items, 1))[0].payload == b"first"
        for number in range(ITEMS):
            await channel.put(b"%d" % number)
        assert (await take(items, 1))[0].payload == b"%d" % (ITEMS - 1)
        assert items.skipped == ITEMS - 1
        late = await channel.put(b"late", time=st.now() - 30_000 * MS)
        last = await channel.put(b"last")
        assert (await take(items, 1))[0] == last._replace(end=None)
        assert (items.skipped, items.dropped) == (ITEMS, 0)
        assert late.seq == last.seq - 1


async def test_a_newest_subscription_sends_no_item_before_the_reader_asks(surface: Surface) -> None:
    channel = await surface.channel(max_items=4)
    async with channel.subscribe() as items:
        await channel.put(b"first")
        assert (await take(items, 1))[0].payload == b"first"
        for number in range(ITEMS):
            await channel.put(b"%d" % number)
        found = await take(items, 4)
        assert [item.payload for item in found] == [b"%d" % number for number in range(ITEMS - 4, ITEMS)]
        assert (items.dropped, items.skipped) == (ITEMS - 4, 0)


async def test_the_unread_items_of_a_stopped_reader_are_bounded(surface: Surface) -> None:
    channel = await surface.channel(max_items=4)
    size = 2**16
    async with channel.subscribe() as items:
        for _ in range(ITEMS):  # a fast reader, for which the host sends ahead
            await channel.put(b"quick" + bytes(size))
            await take(items, 1)
        for number in range(ITEMS):
            await channel.put(number.to_bytes(1, "big") + bytes(size))
        found = await take(items, 1)
        while found[-1].payload[0] != ITEMS - 1:
            found += await take(items, 1)
        before_gap = [item.payload[0] for item in found[:-4]]
        assert before_gap == sorted({*before_gap}), "each item comes once, in order, even if the host is busy"
        assert len(before_gap) * size <= WINDOW_BYTES_MAX
        assert items.dropped == ITEMS - len(found)


async def test_a_run_of_many_items_is_sent_one_by_one_to_a_reader_that_takes_one_by_one(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s", max_items=8)
    async with channel.subscribe(mode="all") as items:
        async with channel.producer() as producer:
            for number in range(200):
                await producer.put(b"%d" % number)
            await producer.flush()
        found = await take(items, 8)
        assert [item.payload for item in found] == [b"%d" % number for number in range(192, 200)]
        assert items.dropped == 192


@pytest.mark.parametrize("surface", ["aio", "sync"], indirect=True)
async def test_a_slow_function_is_called_with_the_newest_item(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    gate, calls = threading.Event(), []
    opened = asyncio.Event()

    async def awaited(item: Any) -> None:
        calls.append(item)
        await opened.wait()

    def blocking(item: Any) -> None:
        calls.append(item)
        assert gate.wait(10)

    is_async = inspect.iscoroutinefunction(channel.put) and not hasattr(channel, "_pool")
    handle = await channel.on_item(awaited if is_async else blocking, mode="newest")
    await channel.put(b"first")
    await until(lambda: len(calls) == 1, channel)
    for number in range(ITEMS):
        await channel.put(b"%d" % number)
    gate.set()
    opened.set()
    await until(lambda: len(calls) == 2, channel)
    assert [item.payload for item in calls] == [b"first", b"%d" % (ITEMS - 1)]
    assert handle.skipped == ITEMS - 1
    handle.cancel()


async def until(condition: Any, channel: Any) -> None:
    async with asyncio.timeout(45):
        while not condition():
            await channel.stats()
            await pause()


async def in_step(surface: Surface, hosts_used: int = 2, **policy: Any) -> tuple[Any, Any, Any]:
    """Return two channels, by default at two hosts, and their group."""
    hosts = await surface.connection.hosts()
    places = [hosts[0].name, hosts[hosts_used - 1].name]
    left, right = [await surface.channel(host=place, **({"max_age": "60s"} | policy)) for place in places]
    return left, right, await surface.group(f"slow/{next(_names)}-{st.now()}", [left, right])


async def begin(left: Any, right: Any, start: int) -> None:
    """Put items so that the group shows the first item of the left channel, and no others."""
    await left.put(b"first", time=start)
    await left.put(b"second", time=start + MS)
    await right.put(b"second", time=start + MS)


async def fill(left: Any, right: Any, group: Any, start: int) -> None:
    """Put ITEMS more items into both channels, and a last item that stays hidden. Wait until all hosts show the other
    items.
    """
    for number in range(ITEMS + 1):
        await left.put(b"%d" % number, time=start + number * MS)
        await right.put(b"%d" % number, time=start + number * MS)
    for channel in (left, right):
        while (newest := await group[channel].newest(timeout=10)) is None or newest.time < start + (ITEMS - 1) * MS:
            await pause()


async def test_a_descriptor_yields_the_newest_visible_item_at_the_moment_of_the_request(pair: Surface) -> None:
    left, right, group = await in_step(pair)
    t = st.now() - 10_000 * MS
    async with group[left].subscribe(mode="newest") as items:
        await begin(left, right, t)
        assert (await take(items, 1))[0].payload == b"first"
        await fill(left, right, group, t + 2 * MS)
        assert (await take(items, 1))[0].payload == b"%d" % (ITEMS - 1)
        assert (items.skipped, items.dropped) == (ITEMS, 0)


async def test_cut_events_are_merged_for_a_reader_that_asks_late(pair: Surface) -> None:
    left, right, group = await in_step(pair)
    t = st.now() - 10_000 * MS
    async with group.subscribe() as cuts:
        await begin(left, right, t)
        assert [item.payload for item in (await take(cuts, 1))[0][left]] == [b"first"]
        await fill(left, right, group, t + 2 * MS)
        (cut,) = await take(cuts, 1)
        assert cut.time == t + (2 + ITEMS) * MS
        merged = [b"second", *(b"%d" % number for number in range(ITEMS))]
        for channel in (left, right):
            assert [item.payload for item in cut[channel.name]] == merged


async def test_a_slow_reader_of_matches_leaves_the_items_in_the_channel(pair: Surface) -> None:
    left, right, group = await in_step(pair, hosts_used=1, max_items=5)
    t = st.now() - 10_000 * MS
    async with group.match(left, "0.1ms") as matches:
        for number in (0, 1):
            await left.put(b"first", time=t + number * MS)
            await right.put(b"first", time=t + number * MS)
        assert (await take(matches, 1))[0].time == t
        await fill(left, right, group, t + 2 * MS)
        (matched,) = await take(matches, 1)
        assert matched[left].payload == b"%d" % (ITEMS - 4)
        assert matches.dropped == 1 + ITEMS - 4
