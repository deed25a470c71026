"""Blocking gets, on every surface."""

from __future__ import annotations

import asyncio

import stampede_rt as st
from tests.contract.surfaces import Surface, waits_in_memory
from tests.support.waiting import pause

MS = 1_000_000


async def waiting(channel: object, count: int = 1) -> None:
    """Wait until `count` gets are blocked on the channel, for at most 45 s."""
    async with asyncio.timeout(45):
        while (await channel.stats()).waiting_gets + waits_in_memory(channel) < count:
            await pause()


async def test_a_blocking_get_is_released_by_the_first_matching_item(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    get = asyncio.ensure_future(channel.newest(timeout=10))
    await waiting(channel)
    await channel.put(b"now")
    assert (await get).payload == b"now"


async def test_a_blocking_newest_after_waits_for_a_later_item(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 1_000 * MS
    first = await channel.put(b"first", time=base)
    get = asyncio.ensure_future(channel.newest(after=first, timeout=10))
    await waiting(channel)
    await channel.put(b"late", time=base - MS)
    await channel.put(b"later", time=base + MS)
    assert (await get).payload == b"later"


async def test_a_get_with_a_timeout_returns_the_found_items_and_the_reason(surface: Surface) -> None:
    channel = await surface.channel()
    items = await channel.get(st.OLDEST, st.NEWEST, timeout=0.05)
    assert (len(items), items.reason) == (0, st.Reason.NOT_YET)


async def test_a_complete_get_waits_until_no_further_item_can_be_accepted(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 1_000 * MS
    await channel.put(b"a", time=base)
    get = asyncio.ensure_future(
        channel.get(base, base + 20 * MS, bounds="[)", match="start", complete=True, timeout=10)
    )
    await waiting(channel)
    await channel.put(b"b", time=base + 10 * MS)
    assert not get.done()
    await channel.put(b"c", time=base + 20 * MS)
    items = await get
    assert [item.payload for item in items] == [b"a", b"b"]
    assert items.complete


async def test_an_advance_completes_an_interval_without_an_item(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 1_000 * MS
    await channel.put(b"a", time=base)
    get = asyncio.ensure_future(channel.get(base, base + 20 * MS, bounds="[)", complete=True, timeout=10))
    await waiting(channel)
    await channel.advance(base + 20 * MS)
    assert (await get).complete


async def test_an_answer_states_that_it_is_incomplete(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 1_000 * MS
    await channel.put(b"a", time=base)
    items = await channel.get(base, base + 20 * MS, bounds="[)", complete=True, timeout=0.05)
    assert (len(items), items.complete, items.reason) == (1, False, st.Reason.NOT_YET)


async def test_a_cancelled_get_leaves_no_wait_at_the_host(surface: Surface) -> None:
    channel = await surface.channel()
    get = asyncio.ensure_future(channel.newest(timeout=2.0))
    await waiting(channel)
    get.cancel()
    async with asyncio.timeout(45):
        while (await channel.stats()).waiting_gets:
            await pause()


async def test_many_gets_wait_side_by_side(surface: Surface) -> None:
    channel = await surface.channel()
    gets = [asyncio.ensure_future(channel.newest(timeout=10)) for _ in range(8)]
    await waiting(channel, len(gets))
    await channel.put(b"all")
    assert {item.payload for item in await asyncio.gather(*gets)} == {b"all"}
