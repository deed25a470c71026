"""The client resumes broken streams by itself: no old item comes as new, and none is missed or counted twice."""

from __future__ import annotations

from typing import Any

import pytest

import stampede_rt as st
from stampede_rt.v1 import channel_service_pb2
from tests.contract.surfaces import Surface, take

MS = 1_000_000
pytestmark = pytest.mark.parametrize("surface", ["aio", "sync"], indirect=True)


def cut_off(items: Any) -> None:
    """End the stream of a subscription, or its ring, as a lost connection would."""
    if getattr(items, "_follower", None) is not None:
        items._follower.mapping.close()
    else:
        items._stream.cancel()


async def test_a_resumed_newest_subscription_does_not_repeat_an_item(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    await channel.put(b"held")
    async with channel.subscribe(mode="newest") as items:
        cut_off(items)
        await channel.put(b"new")
        assert (await take(items, 1))[0].payload == b"new"
        cut_off(items)
        await channel.put(b"late", time=st.now() - 20_000 * MS)
        await channel.put(b"newer")
        assert (await take(items, 1))[0].payload == b"newer"
        assert items.skipped == 1


async def test_a_resumed_newest_subscription_yields_the_first_item_of_the_channel(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    async with channel.subscribe(mode="newest") as items:
        cut_off(items)
        await channel.put(b"one")
        await channel.put(b"two")
        assert (await take(items, 1))[0].payload == b"two"
        assert items.skipped == 1


async def test_skipped_items_are_counted_once_however_often_the_stream_breaks(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 10_000 * MS
    async with channel.subscribe(mode="newest") as items:
        for step in range(5):
            await channel.put(b"skipped", time=base + 10 * step * MS)
            await channel.put(b"taken", time=base + (10 * step + 5) * MS)
            await channel.put(b"late", time=base + (10 * step + 1) * MS)
            cut_off(items)
            assert (await take(items, 1))[0].payload == b"taken"
        assert (items.skipped, items.dropped) == (10, 0)


async def test_a_resumed_subscription_keeps_its_start(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 10_000 * MS
    for offset in (30, 5, 10, 7, 20, 9):
        await channel.put(b"%d" % offset, time=base + offset * MS)
    async with channel.subscribe(start=base + 10 * MS) as items:
        assert [item.payload for item in await take(items, 1)] == [b"30"]
        cut_off(items)
        assert [item.payload for item in await take(items, 1)] == [b"10"]
        await channel.put(b"late", time=base)
        cut_off(items)
        assert [item.payload for item in await take(items, 2)] == [b"20", b"late"]
        assert (items.skipped, items.dropped) == (0, 0)


async def test_a_resumed_subscription_keeps_a_start_that_was_relative_to_the_newest_item(surface: Surface) -> None:
    channel = await surface.channel(max_age="60s")
    base = st.now() - 10_000 * MS
    for offset in (20, 10, 15):
        await channel.put(b"%d" % offset, time=base + offset * MS)
    async with channel.subscribe(start=st.NEWEST) as items:
        await channel.put(b"40", time=base + 40 * MS)
        cut_off(items)
        assert [item.payload for item in await take(items, 2)] == [b"20", b"40"]


async def test_items_that_retention_removes_while_the_stream_is_broken_are_reported(surface: Surface) -> None:
    channel = await surface.channel(max_items=3)
    for number in range(3):
        await channel.put(b"%d" % number)
    async with channel.subscribe(start=st.OLDEST) as items:
        assert (await take(items, 1))[0].payload == b"0"
        cut_off(items)
        for number in range(3, 8):
            await channel.put(b"%d" % number)
        assert [item.payload for item in await take(items, 3)] == [b"5", b"6", b"7"]
        assert items.dropped == 4


@pytest.mark.parametrize("mode", ["all", "newest"])
async def test_a_subscription_that_meets_another_incarnation_as_it_is_resumed_raises_and_ends(
    surface: Surface, mode: str
) -> None:
    channel = await surface.channel(max_age="60s")
    async with channel.subscribe(mode=mode) as items:
        await channel.put(b"before")
        await take(items, 1)
        made: channel_service_pb2.SubscriptionCursor = items._cursor if items._stream else items._follower.cursor
        made.incarnation += 1  # as though it had begun before the loss of the host
        cut_off(items)
        await channel.put(b"of the new incarnation")
        with pytest.raises(st.IncarnationLost, match=f"{channel.name}.*may be missing"):
            await take(items, 1)
        with pytest.raises(StopAsyncIteration):
            await anext(items)


async def test_a_resumed_newest_subscription_of_a_descriptor_does_not_repeat_an_item(surface: Surface) -> None:
    left, right = await surface.channel(max_age="60s"), await surface.channel(max_age="60s")
    group = await surface.group(f"resumed/{st.now()}", [left, right])
    base = st.now() - 10_000 * MS
    await left.put(b"held", time=base)
    await right.put(b"", time=base + 10 * MS)
    await left.put(b"hides", time=base + 20 * MS)
    assert (await group[left].newest(timeout=10)).payload == b"held"
    async with group[left].subscribe(mode="newest") as items:
        cut_off(items)
        await left.put(b"late", time=base + 5 * MS)  # visible immediately, and later than the earlier item
        assert (await take(items, 1))[0].payload == b"late"
        cut_off(items)
        await left.put(b"later", time=base + 8 * MS)
        await left.put(b"too late", time=base + 2 * MS)
        assert (await take(items, 1))[0].payload == b"later"
        cut_off(items)
        await right.put(b"", time=base + 21 * MS)
        await left.put(b"", time=base + 30 * MS)
        assert (await take(items, 1))[0].payload == b"hides"
        assert items.skipped == 1


async def test_resumed_matches_and_cut_events_continue_at_their_position(surface: Surface) -> None:
    left, right = await surface.channel(max_age="60s"), await surface.channel(max_age="60s")
    group = await surface.group(f"resumed/{st.now()}", [left, right])
    base = st.now() - 10_000 * MS
    async with group.match(left, "1ms") as matches, group.subscribe() as cuts:
        taken, seen = [], []
        for number in range(6):
            for channel in (left, right):
                await channel.put(b"%d" % number, time=base + 10 * number * MS)
            if number % 2:
                cut_off(matches)
            if number:
                taken += [matched.time for matched in await take(matches, 1)]
                seen += [item.time for cut in await take(cuts, 1) for item in cut[left.name]]
                cuts._cancel_streams()
        assert taken == [base + 10 * number * MS for number in range(5)]
        assert seen == taken
        assert (matches.dropped, matches.unmatched, matches.losses) == (0, 0, 0)
