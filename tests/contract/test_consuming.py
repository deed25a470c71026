"""Items that leave after consumption, and the window that follows the slowest consumer, on every surface."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import AsyncExitStack
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt_local.cluster import LocalCluster
from tests.contract.memory import MemoryChannel, MemoryConnection
from tests.contract.surfaces import Surface
from tests.support.cluster import find_secret_of
from tests.support.waiting import pause


class Team:
    """Three consumers, each with its own connection."""

    def __init__(self, surfaces: list[Surface], close: str) -> None:
        self._surfaces = surfaces
        self._close = close

    async def open(self, **policy: Any) -> list[Any]:
        """Open one channel; return each consumer's handle of it."""
        first = await self._surfaces[0].channel(**policy)
        return [first, *[await one.channel(first.name) for one in self._surfaces[1:]]]

    async def leaves(self, which: int) -> None:
        await getattr(self._surfaces[which].connection, self._close)()


@pytest.fixture(params=["memory", "aio", "sync"])
async def team(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> AsyncIterator[Team]:
    if request.param == "memory":
        home = MemoryConnection()
        yield Team([Surface(home), *[Surface(MemoryConnection(joins=home)) for _ in range(2)]], "aclose")
        return
    cluster: LocalCluster = request.getfixturevalue("cluster")
    find_secret_of(cluster, monkeypatch)
    address = cluster.address
    async with AsyncExitStack() as stack:
        if request.param == "aio":
            yield Team([Surface(await stack.enter_async_context(aio.connect(address))) for _ in range(3)], "aclose")
            return
        pool = stack.enter_context(ThreadPoolExecutor(16))
        yield Team([Surface(stack.enter_context(st.connect(address)), pool) for _ in range(3)], "close")


async def held(channel: Any) -> list[bytes]:
    return [item.payload for item in await channel.get(st.OLDEST, st.NEWEST)]


async def put_three(channel: Any) -> st.Items:
    for payload in (b"1", b"2", b"3"):
        await channel.put(payload)
    items: st.Items = await channel.get(st.OLDEST, st.NEWEST)
    return items


async def waiting_puts(channel: Any, count: int) -> None:
    async with asyncio.timeout(45):
        while (await channel.stats()).waiting_puts != count:
            await pause()


async def test_an_item_is_collected_when_all_consumers_have_consumed_it_and_is_visible_until_then(team: Team) -> None:
    ann, bob, cyd = await team.open(consumers=2)
    items = await put_three(ann)
    assert await ann.consume(items) == 3
    assert await held(cyd) == [b"1", b"2", b"3"], "the second place was never taken"
    assert await bob.consume(items[:2]) == 2
    assert await held(ann) == await held(cyd) == [b"3"]
    stats = await cyd.stats()
    assert (stats.accepted, stats.held, stats.collected["consumption"]) == (3, 1, 2)
    assert sorted(place.waiting for place in stats.consumers) == [0, 1]


async def test_consuming_an_item_again_changes_nothing(team: Team) -> None:
    ann, _, _ = await team.open(consumers=2)
    first, *_ = await put_three(ann)
    assert [await ann.consume(first), await ann.consume(first), await ann.consume([])] == [1, 0, 0]
    assert len((await ann.stats()).consumers) == 1


async def test_all_handles_of_a_connection_are_one_consumer(team: Team) -> None:
    ann, _, _ = await team.open(consumers=1)
    reopened = await team._surfaces[0].channel(ann.name)
    items = await put_three(ann)
    assert [await ann.consume(items[0]), await reopened.consume(items[0])] == [1, 0]


async def test_a_consumer_above_the_limit_is_refused_until_another_one_leaves(team: Team) -> None:
    ann, bob, cyd = await team.open(consumers=2)
    items = await put_three(ann)
    await ann.consume(items[0])
    await bob.consume([])
    with pytest.raises(st.ChannelFull, match="counts 2 consumers"):
        await cyd.consume(items)
    await team.leaves(1)
    assert await held(ann) == [b"2", b"3"], "a consumer that has left holds nothing back"
    assert await cyd.consume(items) == 1
    assert await ann.consume(items) == 2
    assert await held(ann) == []


async def test_a_channel_without_consumers_refuses_consume(team: Team) -> None:
    ann, _, _ = await team.open(max_items=9)
    with pytest.raises(st.InvalidArgument, match="counts no consumption"):
        await ann.consume(await put_three(ann))


async def test_an_item_of_another_channel_is_refused_as_a_position(team: Team) -> None:
    (channel, *_), (other, *_) = await team.open(consumers=1), await team.open(consumers=1)
    await other.put(b"x")
    item = await other.newest()
    with pytest.raises(st.IncarnationLost, match="another channel's items"):
        await channel.consume(item)
    with pytest.raises(st.IncarnationLost, match="another channel's"):
        await channel.newest(after=item)


@pytest.mark.parametrize("change", [
    {"seq": -1}, {"seq": 2**64}, {"time": 2**63}, {"incarnation": -1}, {"seq": "1"}, {"time": None},
])  # fmt: skip
async def test_an_item_with_impossible_fields_is_refused_as_a_position(change: dict[str, Any], team: Team) -> None:
    channel = (await team.open(consumers=1))[0]
    await channel.put(b"x")
    if isinstance(channel, MemoryChannel):
        return
    wrong = (await channel.newest())._replace(**change)
    for read in (channel.consume, lambda item: channel.newest(after=item), subscribed(channel)):
        with pytest.raises(st.InvalidArgument, match=f"the item's {next(iter(change))} is "):
            await read(wrong)


def subscribed(channel: Any) -> Any:
    """Subscribe after an item, with either client."""

    async def subscribe(item: st.Item) -> None:
        async with channel.subscribe(after=item):
            raise AssertionError("the subscription is refused")

    return subscribe


async def test_consume_takes_only_items(team: Team) -> None:
    ann, _, _ = await team.open(consumers=1)
    with pytest.raises(st.InvalidArgument):
        await ann.consume([b"payload"])


async def test_a_producer_waits_until_consumption_makes_room(team: Team) -> None:
    ann, bob, _ = await team.open(consumers=1, max_items=3, on_full="block")
    items = await put_three(ann)
    await bob.consume([])
    put = asyncio.ensure_future(ann.put(b"4", timeout=10))
    await waiting_puts(bob, 1)
    assert not put.done()
    await bob.consume(items[1])
    await waiting_puts(bob, 1)
    await bob.consume(items[0])
    assert (await put).seq == 4
    assert await held(ann) == [b"3", b"4"]


async def test_a_producer_that_waits_for_consumers_gives_up_after_its_timeout(team: Team) -> None:
    ann, _, _ = await team.open(consumers=1, max_items=3, on_full="block")
    await put_three(ann)
    with pytest.raises(st.ChannelFull):
        await ann.put(b"4", timeout=0.01)


async def test_the_limit_that_is_reached_first_applies(team: Team) -> None:
    ann, bob, _ = await team.open(consumers=1, max_items=2)
    await put_three(ann)
    assert await held(bob) == [b"2", b"3"]
    refusing, _, _ = await team.open(consumers=1, max_items=3, on_full="reject")
    items = await put_three(refusing)
    with pytest.raises(st.ChannelFull, match="consumed"):
        await refusing.put(b"4")
    await refusing.consume(items[0])
    assert (await refusing.put(b"4")).seq == 4


async def test_consumed_items_do_not_make_a_late_item_too_old(team: Team) -> None:
    ann, _, _ = await team.open(consumers=1)
    base = st.now() - 10**9
    await ann.put(b"later", time=base)
    await ann.consume(await ann.get(base, base))
    await ann.put(b"late", time=base - 10**6)
    assert await held(ann) == [b"late"]


async def test_the_number_of_consumers_changes_while_puts_wait(team: Team) -> None:
    ann, bob, _ = await team.open(consumers=2, max_items=3, on_full="block")
    items = await put_three(ann)
    await bob.consume(items)
    put = asyncio.ensure_future(ann.put(b"4", timeout=10))
    await waiting_puts(ann, 1)
    assert (await ann.configure(consumers=3)).consumers == 3
    await waiting_puts(ann, 1)
    assert (await ann.configure(consumers=1)).consumers == 1
    assert (await put).seq == 4
    assert await held(ann) == [b"4"]


@pytest.mark.parametrize("change", [{"max_items": 4}, {"max_age": "1ms"}, {"on_full": "drop_oldest"}])
async def test_a_larger_limit_admits_as_many_waiting_puts_as_fit(team: Team, change: dict[str, Any]) -> None:
    ann, _, _ = await team.open(consumers=1, max_items=3, on_full="block")
    await put_three(ann)
    put = asyncio.ensure_future(ann.put(b"4", timeout=10))
    await waiting_puts(ann, 1)
    await ann.configure(max_items=3, max_bytes=2**20)
    await waiting_puts(ann, 1)
    await ann.configure(**change)
    assert (await put).seq == 4


async def test_the_window_follows_the_slowest_live_consumer(team: Team) -> None:
    ann, bob, cyd = await team.open(max_age="1us", max_age_unconsumed="1h")
    await ann.consume([])
    items = await put_three(cyd)
    assert len(items) == 3, "one consumer lags"
    await bob.consume(items[:2])
    await ann.consume(items[:1])
    assert await held(cyd) == [b"2", b"3"]
    await team.leaves(0)
    assert await held(cyd) == [b"3"]
    assert (await cyd.stats()).collected["age"] == 2


async def test_a_producer_learns_how_far_its_clock_is_off(team: Team) -> None:
    ann, _, _ = await team.open()
    offset = (await ann.stats()).clock_offset_nanos
    assert offset is not None
    assert abs(offset) < 10 * 10**9
    with pytest.raises(st.InFuture) as refused:
        await ann.put(b"ahead", time=st.now() + 3600 * 10**9)
    assert 3500 * 10**9 < int(refused.value.metadata["offset_nanos"]) <= 3600 * 10**9
