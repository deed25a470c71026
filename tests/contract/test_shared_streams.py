"""Several callers step through one iterator at the same time: each item or event goes to one of them."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Any

import pytest

import stampede_rt as st
from tests.contract.surfaces import AwaitableObject, BlockingIterator, Surface

MS = 1_000_000
CALLERS = 3
pytestmark = pytest.mark.parametrize("surface", ["aio", "sync"], indirect=True)


async def shared(stream: AsyncIterator[Any], produce: Callable[[int], Awaitable[object]]) -> list[Any]:
    """Let several callers wait for the next element of `stream` at the same time, and return one element for each.

    `produce` makes the next element. It gets the number of the element.
    """
    steps = [asyncio.ensure_future(anext(stream)) for _ in range(CALLERS)]
    async with asyncio.timeout(45):
        for number in range(CALLERS):
            await asyncio.sleep(0)  # the callers begin to wait
            await produce(number)
            while sum(step.done() for step in steps) <= number:
                await asyncio.wait([step for step in steps if not step.done()], return_when=asyncio.FIRST_COMPLETED)
        return [await step for step in steps]


async def test_callers_that_share_a_subscription_get_different_items(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    async with channel.subscribe() as items:
        found = await shared(items, lambda number: channel.put(b"%d" % number))
    assert {item.payload for item in found} == {b"0", b"1", b"2"}


async def test_callers_that_share_a_stream_of_cut_events_or_matches_get_different_events(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    group = await surface.group(f"shared/{st.now()}", [channel])
    base = st.now() - 10_000 * MS

    def produce(first: int) -> Callable[[int], Awaitable[object]]:
        async def put(number: int) -> None:
            await channel.put(b"", time=base + (first + number) * MS)

        return put

    await produce(0)(0)
    async with group.subscribe() as cuts:
        events = await shared(cuts, produce(1))
    assert {item.time for cut in events for item in cut[channel.name]} == {base + n * MS for n in range(CALLERS)}
    async with group.match(channel, "1ms") as matches:
        found = await shared(matches, produce(1 + CALLERS))
    assert len({matched.time for matched in found}) == CALLERS


async def test_callers_that_share_a_watch_get_different_changes(surface: Surface) -> None:
    name, connection = f"shared-watch/{st.now()}", surface.connection
    if isinstance(connection, AwaitableObject):
        watch: Any = BlockingIterator(lambda: connection._wrapped.watch(f"{name}/*"), connection._pool)
    else:
        watch = connection.watch(f"{name}/*")
    async with watch as changes:
        found = await shared(changes, lambda number: surface.channel(f"{name}/{number}"))
    assert {change.subject.name for change in found} == {f"{name}/{number}" for number in range(CALLERS)}


async def test_the_end_of_a_subscription_ends_the_waits_of_all_callers(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    async with channel.subscribe() as items:
        steps = [asyncio.ensure_future(anext(items)) for _ in range(CALLERS)]
        await asyncio.sleep(0)
        items.close()
        async with asyncio.timeout(45):
            ended = await asyncio.gather(*steps, return_exceptions=True)
    assert [type(one) for one in ended] == [StopAsyncIteration] * CALLERS
