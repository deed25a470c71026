"""Queues, on both clients: order, leases, acknowledgements, copies, dead letters, what is full, what is stated."""

from __future__ import annotations

import asyncio
import itertools
import os
from collections.abc import AsyncIterator, Callable
from concurrent.futures import ThreadPoolExecutor
from functools import partial
from typing import Any

import pytest

import stampede_rt as st
from stampede_rt import aio
from stampede_rt._async import queue as async_queue
from stampede_rt._sync import queue as sync_queue
from tests.contract.lifting import lifted

_names = itertools.count()


class Rig:
    """Connections of one kind to the cluster, and queues of names that no other test has."""

    def __init__(self, address: str, pool: ThreadPoolExecutor | None) -> None:
        self.address = address
        self.pool = pool
        self.connections: list[Any] = []
        self.rt: Any = None

    async def connect(self, **named: Any) -> Any:
        if self.pool is None:
            made = await aio.connect(self.address, **named)
        else:
            made = lifted(await asyncio.to_thread(st.connect, self.address, **named), self.pool)
        self.connections.append(made)
        return made

    def name(self) -> str:
        return f"contract/q{next(_names)}-{st.now()}"

    async def queue(self, name: str | None = None, **stated: Any) -> Any:
        return await self.rt.queue(name or self.name(), **stated)


@pytest.fixture(params=["aio", "sync"])
async def rig(request: pytest.FixtureRequest, cluster: Any) -> AsyncIterator[Rig]:
    with ThreadPoolExecutor(16) as pool:
        made = Rig(cluster.address, pool if request.param == "sync" else None)
        made.rt = await made.connect()
        yield made
        for connection in made.connections:
            await connection.aclose()


async def until(queue: Any, condition: Callable[[st.QueueStats], bool]) -> st.QueueStats:
    """The first counters for which `condition` holds, within 10 s."""
    async with asyncio.timeout(10):
        while not condition(stats := await queue.stats()):
            adds_up(stats)
        return adds_up(stats)


def adds_up(stats: st.QueueStats) -> st.QueueStats:
    gone = stats.consumed + stats.dropped + stats.dead_lettered + stats.expelled
    assert stats.accepted == stats.held + gone
    return stats


async def lease_from_now_on(queue: Any, lease: str) -> None:
    """Of deliveries to come, so that only those before have leases that end soon."""
    await queue.configure(lease=lease)
    await until(queue, lambda stats: stats.policy.lease_nanos == int(lease[:-1]) * 10**9)


async def test_items_come_in_the_order_of_their_acceptance_each_once(rig: Rig) -> None:
    queue = await rig.queue()
    seqs = [(await queue.put(str(number).encode())).seq for number in range(5)]
    assert seqs == list(range(seqs[0], seqs[0] + 5))
    messages = [await queue.get(timeout=10) for _ in range(5)]
    assert [(message.seq, message.payload) for message in messages] == [
        (seq, str(number).encode()) for number, seq in enumerate(seqs)
    ]
    assert await queue.get(timeout=0) is None
    for message in messages:
        await message.ack()
    stats = adds_up(await queue.stats())
    assert (stats.consumed, stats.held, stats.delivered) == (5, 0, 5)


async def test_a_get_without_an_item_gives_none_when_its_time_is_over(rig: Rig) -> None:
    queue = await rig.queue()
    assert await queue.get(timeout=0) is None
    assert await queue.get(timeout=0.05) is None
    assert (await until(queue, lambda stats: not stats.waiting_gets)).delivered == 0


async def test_what_is_there_is_taken_without_waiting(rig: Rig) -> None:
    queue = await rig.queue()
    await queue.put(b"x")
    message = await queue.get(timeout=0)
    assert (message.payload, message.deliveries) == (b"x", 1)


async def test_a_get_waits_for_an_item(rig: Rig) -> None:
    queue = await rig.queue()
    get = asyncio.ensure_future(queue.get())
    await until(queue, lambda stats: stats.waiting_gets == 1)
    await queue.put(b"x")
    assert (await get).payload == b"x"


async def test_a_message_brings_what_was_put(rig: Rig) -> None:
    queue = await rig.queue(codec="json")
    began = st.now()
    await queue.put({"goal": [1, 2]}, attributes={"from": "planner"})
    message = await queue.get(timeout=10)
    assert (message.value, message.attributes) == ({"goal": [1, 2]}, {"from": "planner"})
    assert message.content_type == "application/json"
    assert abs(message.time - began) < 60 * 10**9


async def test_a_payload_that_does_not_decode_names_the_queue_and_the_item(rig: Rig) -> None:
    plain = await rig.queue()
    seq = (await plain.put(b"{")).seq
    queue = await rig.queue(plain.name, codec="json")
    message = await queue.get(timeout=10)
    with pytest.raises(st.CodecError, match=f"queue '{plain.name}': item #{seq}"):
        _ = message.value


async def test_a_message_given_back_comes_again_at_its_place(rig: Rig) -> None:
    queue = await rig.queue()
    for payload in (b"1", b"2"):
        await queue.put(payload)
    await (await queue.get(timeout=10)).nack()
    again = await queue.get(timeout=10)
    assert (again.payload, again.deliveries) == (b"1", 2)


async def test_a_delayed_give_back_holds_up_no_other(rig: Rig) -> None:
    queue = await rig.queue()
    for payload in (b"1", b"2"):
        await queue.put(payload)
    await (await queue.get(timeout=10)).nack(delay="300ms")
    assert (await queue.get(timeout=10)).payload == b"2"
    assert (await queue.get(timeout=10)).payload == b"1"


async def test_a_lease_that_ends_gives_the_item_to_the_next(rig: Rig) -> None:
    queue = await rig.queue(lease="200ms")
    await queue.put(b"x")
    late = await queue.get(timeout=10)
    await lease_from_now_on(queue, "60s")
    again = await queue.get(timeout=10)
    assert again.deliveries == 2
    assert late.lease_left < 0.1  # counted from when it came here
    with pytest.raises(st.LeaseExpired, match=queue.name):
        await late.ack()
    await again.ack()
    assert adds_up(await queue.stats()).leases_expired == 1


async def test_an_extension_counts_from_now_and_may_shorten_a_lease(rig: Rig) -> None:
    queue = await rig.queue(lease="5s")
    await queue.put(b"x")
    message = await queue.get(timeout=10)
    assert 0 < message.lease_left <= 5
    await message.extend("60s")
    assert message.lease_left > 30
    await message.extend("1ms")
    assert (await queue.get(timeout=10)).deliveries == 2


async def test_an_acknowledgement_may_be_repeated_but_not_revoked(rig: Rig) -> None:
    queue = await rig.queue()
    await queue.put(b"x")
    message = await queue.get(timeout=10)
    await message.ack()
    await message.ack()
    with pytest.raises(st.LeaseExpired):
        await message.nack()


async def test_a_block_that_ends_well_acknowledges_and_one_that_raises_gives_back(rig: Rig) -> None:
    queue = await rig.queue()
    await queue.put(b"x")
    with pytest.raises(ZeroDivisionError):
        async with await queue.get(timeout=10):
            raise ZeroDivisionError
    async with await queue.get(timeout=10) as message:
        assert message.deliveries == 2
    stats = await queue.stats()
    assert (stats.consumed, stats.given_back) == (1, 1)


async def test_a_message_settled_in_its_block_is_left_alone(rig: Rig) -> None:
    queue = await rig.queue()
    await queue.put(b"x")
    async with await queue.get(timeout=10) as message:
        await message.nack()
    assert (await queue.stats()).consumed == 0


async def test_what_a_block_raised_is_told_even_if_its_lease_has_ended(rig: Rig) -> None:
    queue = await rig.queue(lease="100ms")
    await queue.put(b"x")

    async def work() -> None:
        async with await queue.get(timeout=10):
            await lease_from_now_on(queue, "60s")
            await (await queue.get(timeout=10)).ack()
            raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError) as caught:
        await work()
    assert "comes again when its lease ends" in caught.value.__notes__[0]


async def test_iteration_takes_one_after_the_other_until_the_handle_is_closed(rig: Rig) -> None:
    queue = await rig.queue()
    for number in range(3):
        await queue.put(str(number).encode())
    found = []

    async def work() -> None:
        async for message in queue:
            found.append(message.payload)
            await message.ack()

    working = asyncio.ensure_future(work())
    other = await rig.queue(queue.name)
    await until(other, lambda stats: stats.consumed == 3 and stats.waiting_gets == 1)
    await queue.aclose()
    await asyncio.wait_for(working, 10)
    assert found == [b"0", b"1", b"2"]
    with pytest.raises(st.InvalidArgument, match="closed"):
        await queue.get(timeout=0)


async def test_each_item_goes_to_as_many_takers_as_it_has_copies(rig: Rig) -> None:
    queue = await rig.queue(copies=2)
    other = await rig.queue(queue.name)
    await queue.put(b"x")
    first, second = await queue.get(timeout=10), await other.get(timeout=10)
    assert (first.payload, second.payload) == (b"x", b"x")
    assert await queue.get(timeout=0) is None
    await first.ack()
    assert (await queue.stats()).held == 1
    await second.ack()
    assert adds_up(await queue.stats()).consumed == 1


async def test_who_waits_longest_is_served_first_among_all_takers(rig: Rig) -> None:
    queue = await rig.queue()
    takers = [await rig.queue(queue.name) for _ in range(3)]
    gets = []
    for taker in takers:
        gets.append(asyncio.ensure_future(taker.get(timeout=10)))
        await until(queue, lambda stats: stats.waiting_gets == len(gets))
    for payload in (b"1", b"2", b"3"):
        await queue.put(payload)
    assert [message.payload for message in await asyncio.gather(*gets)] == [b"1", b"2", b"3"]


async def test_several_waits_on_one_handle_share_its_stream(rig: Rig) -> None:
    queue = await rig.queue()
    gets = [asyncio.ensure_future(queue.get(timeout=10)) for _ in range(5)]
    await until(queue, lambda stats: stats.waiting_gets == 1)
    for number in range(5):
        await queue.put(str(number).encode())
    assert {message.payload for message in await asyncio.gather(*gets)} == {b"0", b"1", b"2", b"3", b"4"}


async def test_by_default_nothing_is_taken_before_somebody_waits_for_it(rig: Rig) -> None:
    queue = await rig.queue()
    for number in range(3):
        await queue.put(str(number).encode())
    await queue.get(timeout=10)
    assert (await queue.stats()).leased == 1


async def test_what_was_prefetched_and_not_handed_out_goes_back_when_the_handle_is_closed(rig: Rig) -> None:
    queue = await rig.queue()
    greedy = await rig.queue(queue.name, prefetch=10)
    for number in range(5):
        await queue.put(str(number).encode())
    first = await greedy.get(timeout=10)
    await until(queue, lambda stats: stats.leased == 5)
    await greedy.aclose()
    stats = await until(queue, lambda stats: stats.leased == 1)
    assert (stats.held, stats.given_back) == (5, 4)
    await first.ack()
    assert (await queue.get(timeout=10)).payload == b"1"


def _has_leased(items: int, stats: st.QueueStats) -> bool:
    return stats.leased == items


async def test_what_nobody_was_handed_does_not_count_as_delivered(rig: Rig) -> None:
    """Takers that took ahead and left used up the deliveries of items that nobody had seen, and they were expelled."""
    queue = await rig.queue(max_deliveries=2)
    for number in range(3):
        await queue.put(str(number).encode())
    for held in (3, 2, 1):
        greedy = await rig.queue(queue.name, prefetch=10)
        first = await greedy.get(timeout=10)
        await until(queue, partial(_has_leased, held))
        await greedy.aclose()
        await until(queue, lambda stats: stats.leased == 1)
        assert first.deliveries == 1
        await first.ack()
    assert adds_up(await queue.stats()).consumed == 3


async def test_closing_the_connection_gives_back_too(rig: Rig) -> None:
    queue = await rig.queue()
    leaving = await rig.connect()
    greedy = await leaving.queue(queue.name, prefetch=4)
    for _ in range(3):
        await queue.put(b"x")
    await greedy.get(timeout=10)
    await until(queue, lambda stats: stats.leased == 3)
    await leaving.aclose()
    assert (await until(queue, lambda stats: stats.leased == 1)).given_back == 2


async def test_a_full_queue_makes_a_put_wait_or_refuses_it(rig: Rig) -> None:
    queue = await rig.queue(max_items=1)
    await queue.put(b"1")
    with pytest.raises(st.QueueFull, match=queue.name):
        await queue.put(b"2", timeout=0.05)
    put = asyncio.ensure_future(queue.put(b"2"))
    await until(queue, lambda stats: stats.waiting_puts == 1)
    await (await queue.get(timeout=10)).ack()
    await put
    assert (await queue.get(timeout=10)).payload == b"2"


async def test_a_queue_that_rejects_says_so_at_once(rig: Rig) -> None:
    queue = await rig.queue(max_items=1, on_full="reject")
    await queue.put(b"1")
    with pytest.raises(st.QueueFull):
        await queue.put(b"2")
    assert adds_up(await queue.stats()).rejected["full"] == 1


async def test_a_queue_that_drops_the_oldest_counts_them(rig: Rig) -> None:
    queue = await rig.queue(max_items=2, on_full="drop_oldest")
    for number in range(5):
        await queue.put(str(number).encode())
    assert (await queue.get(timeout=10)).payload == b"3"
    assert adds_up(await queue.stats()).dropped == 3


async def test_a_queue_whose_items_are_all_leased_drops_none_and_is_full(rig: Rig) -> None:
    queue = await rig.queue(max_items=1, on_full="drop_oldest")
    await queue.put(b"1")
    message = await queue.get(timeout=10)
    with pytest.raises(st.QueueFull, match="1 of them leased") as caught:
        await queue.put(b"2")
    assert isinstance(caught.value, st.Full)
    assert not isinstance(caught.value, st.ChannelFull)
    await message.ack()
    await queue.put(b"2")


async def test_a_lowered_number_of_deliveries_holds_at_once(rig: Rig) -> None:
    dead = await rig.queue()
    queue = await rig.queue(max_deliveries=9, dead_letter=dead.name)
    await queue.put(b"poison")
    for _ in range(3):
        await (await queue.get(timeout=10)).nack()
    await queue.configure(max_deliveries=2)
    assert (await dead.get(timeout=10)).payload == b"poison"
    assert (await until(queue, lambda stats: not stats.held)).delivered == 3


async def test_an_item_delivered_too_often_goes_to_the_dead_letter_queue(rig: Rig) -> None:
    dead = await rig.queue()
    queue = await rig.queue(max_deliveries=2, dead_letter=dead.name)
    same = await rig.queue(queue.name, dead_letter=dead)
    assert same == queue
    await queue.put(b"poison", attributes={"try": "me"})
    for _ in range(2):
        await (await queue.get(timeout=10)).nack()
    letter = await dead.get(timeout=10)
    assert (letter.payload, letter.attributes["try"]) == (b"poison", "me")
    await until(queue, lambda stats: stats.dead_lettered == 1 and stats.held == 0)


async def test_a_dead_letter_tells_where_it_comes_from(rig: Rig) -> None:
    dead = await rig.queue()
    queue = await rig.queue(max_deliveries=2, dead_letter=dead.name)
    before = st.now()
    put = await queue.put(b"poison")
    for _ in range(2):
        await (await queue.get(timeout=10)).nack()
    letter = await dead.get(timeout=10)
    origin = letter.origin
    assert (origin.queue, origin.queue_id) == (queue.name, queue.info.queue_id)
    assert (origin.seq, origin.incarnation) == (put.seq, put.incarnation)
    assert (origin.deliveries, origin.ended, origin.reason) == (2, "given_back", "")
    assert origin.taker.endswith(f":{os.getpid()}")
    assert abs(origin.enqueued - before) < 60 * 10**9
    assert letter.deliveries == 1


async def test_a_terminated_message_leaves_with_its_reason_and_comes_no_more(rig: Rig) -> None:
    dead = await rig.queue()
    queue = await rig.queue(dead_letter=dead.name)
    await queue.put(b"poison")
    message = await queue.get(timeout=10)
    assert message.origin is None
    await message.term("not an image")
    with pytest.raises(st.LeaseExpired):
        await message.ack()
    letter = await dead.get(timeout=10)
    origin = letter.origin
    assert (letter.payload, origin.ended, origin.reason, origin.deliveries) == (
        b"poison",
        "terminated",
        "not an image",
        1,
    )
    stats = await until(queue, lambda stats: stats.dead_lettered == 1)
    assert (stats.terminated, stats.held, stats.given_back) == (1, 0, 0)


async def test_a_terminated_message_is_expelled_where_there_is_no_dead_letter_queue(rig: Rig) -> None:
    queue = await rig.queue(copies=2)
    other = await rig.queue(queue.name)
    await queue.put(b"poison")
    async with await queue.get(timeout=10) as message:
        others = await other.get(timeout=10)
        await message.term()
    with pytest.raises(st.LeaseExpired):
        await others.ack()
    stats = adds_up(await queue.stats())
    assert (stats.expelled, stats.terminated, stats.held) == (1, 1, 0)


async def test_a_reason_that_is_too_long_is_refused(rig: Rig) -> None:
    queue = await rig.queue()
    await queue.put(b"x")
    message = await queue.get(timeout=10)
    with pytest.raises(st.InvalidArgument, match="1024 bytes"):
        await message.term("x" * 1025)
    await message.term("x" * 1024)


async def test_the_pending_list_tells_what_is_leased_to_whom(rig: Rig) -> None:
    named = await rig.connect(name=f"taker{next(_names)}")
    queue, other = await rig.queue(lease="60s"), None
    assert await queue.pending() == []
    for number in range(3):
        await queue.put(str(number).encode())
    mine = await queue.get(timeout=10)
    await mine.nack()
    mine = await queue.get(timeout=10)
    other = await (await named.queue(queue.name)).get(timeout=10)
    first, second = await queue.pending()
    assert (first.seq, first.deliveries, second.seq, second.deliveries) == (mine.seq, 2, other.seq, 1)
    assert first.taker.endswith(f":{os.getpid()}")
    assert second.taker == named.name
    assert first.taker_id != second.taker_id
    assert first.expires - first.leased == 60 * 10**9
    assert await queue.pending(limit=1) == [first]
    await other.ack()
    assert await queue.pending() == [first]
    await mine.extend("120s")
    (extended,) = await queue.pending()
    assert extended.expires > first.expires
    with pytest.raises(st.InvalidArgument, match="limit"):
        await queue.pending(limit=0)


async def test_a_long_pending_list_comes_page_by_page(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (async_queue, sync_queue):
        monkeypatch.setattr(module, "PENDING_PAGE_MAX", 2)
    queue = await rig.queue()
    seqs = [(await queue.put(b"x")).seq for _ in range(5)]
    for _ in seqs:
        await queue.get(timeout=10)
    assert [one.seq for one in await queue.pending()] == seqs
    assert [one.seq for one in await queue.pending(limit=3)] == seqs[:3]


async def test_a_second_put_of_a_message_id_is_acknowledged_and_not_held(rig: Rig) -> None:
    queue = await rig.queue()
    other = await rig.queue(queue.name)
    first = await queue.put(b"charge 5", message_id="order-1")
    again = await other.put(b"charge 5", message_id="order-1")
    assert (first.duplicate, again.duplicate) == (False, True)
    assert (again.seq, again.incarnation) == (first.seq, first.incarnation)
    assert not (await queue.put(b"charge 5", message_id="Order-1")).duplicate
    assert not (await queue.put(b"charge 5")).duplicate
    await (await queue.get(timeout=10)).ack()
    assert (await queue.put(b"charge 5", message_id="order-1")).duplicate  # also after it was used up
    stats = adds_up(await queue.stats())
    assert (stats.accepted, stats.duplicates) == (3, 2)


async def test_a_message_id_that_was_refused_is_free(rig: Rig) -> None:
    queue = await rig.queue(max_items=1, on_full="reject")
    await queue.put(b"1", message_id="one")
    with pytest.raises(st.QueueFull):
        await queue.put(b"2", message_id="two")
    assert (await queue.put(b"1", message_id="one")).duplicate  # although the queue is full
    await (await queue.get(timeout=10)).ack()
    assert not (await queue.put(b"2", message_id="two")).duplicate


@pytest.mark.parametrize("message_id", ["", "x" * 129, 7])
async def test_a_message_id_that_is_none_is_refused(rig: Rig, message_id: object) -> None:
    queue = await rig.queue()
    with pytest.raises(st.InvalidArgument, match="message_id"):
        await queue.put(b"x", message_id=message_id)


async def test_a_mailbox_knows_message_ids_and_tells_what_is_pending(rig: Rig) -> None:
    peer = await rig.connect(name=f"peer{next(_names)}")
    first = await rig.rt.send(peer.name, b"x", message_id="one")
    again = await rig.rt.send(peer.name, b"x", message_id="one")
    assert (again.seq, again.duplicate) == (first.seq, True)
    mailbox = peer.mailbox
    message = await mailbox.get(timeout=10)
    (pending,) = await mailbox.pending()
    assert (pending.seq, pending.taker) == (message.seq, peer.name)
    assert await rig.rt.mailbox_pending(peer.name) == [pending]
    await message.term()
    assert await mailbox.pending() == []
    assert (await rig.rt.mailbox_stats(peer.name)).terminated == 1


async def test_a_live_taker_that_lets_a_lease_end_goes_on_being_served(rig: Rig) -> None:
    """The host asks whether it lives before it passes it over."""
    queue = await rig.queue(lease="100ms")
    gets = [asyncio.ensure_future(queue.get(timeout=20)) for _ in range(3)]
    await until(queue, lambda stats: stats.waiting_gets == 1)
    await queue.put(b"x")
    done, _ = await asyncio.wait(gets, return_when=asyncio.FIRST_COMPLETED)
    assert len(done) == 1
    assert [message.payload for message in await asyncio.gather(*gets)] == [b"x"] * 3


async def test_without_a_dead_letter_queue_it_is_expelled_and_counted(rig: Rig) -> None:
    queue = await rig.queue(max_deliveries=1)
    await queue.put(b"poison")
    await (await queue.get(timeout=10)).nack()
    assert adds_up(await queue.stats()).expelled == 1
    assert await queue.get(timeout=0) is None


async def test_a_stated_argument_that_contradicts_is_refused(rig: Rig) -> None:
    queue = await rig.queue(max_items=3, lease="10s")
    assert await rig.queue(queue.name) == queue
    assert await rig.queue(queue.name, lease="10s") == queue
    with pytest.raises(st.QueueExists, match=queue.name):
        await rig.queue(queue.name, max_items=4)


async def test_an_absent_queue_is_not_made_when_that_is_not_wanted(rig: Rig) -> None:
    with pytest.raises(st.QueueNotFound):
        await rig.queue(create=False)
    with pytest.raises(st.QueueNotFound):
        await rig.queue(max_deliveries=1, dead_letter="contract/nowhere")


async def test_a_queue_can_be_changed_while_it_runs(rig: Rig) -> None:
    queue = await rig.queue(max_items=1, on_full="reject")
    await queue.put(b"1")
    policy = await queue.configure(max_items=2, lease="5s")
    assert (policy.max_items, policy.lease_nanos, policy.on_full) == (2, 5 * 10**9, "reject")
    await until(queue, lambda stats: stats.policy.max_items == 2)
    await queue.put(b"2")


async def test_a_deleted_queue_is_gone_for_everyone(rig: Rig) -> None:
    queue = await rig.queue()
    other = await rig.queue(queue.name)
    await queue.put(b"x")
    get = asyncio.ensure_future(other.get(timeout=10))
    message = await get
    waiting = asyncio.ensure_future(other.get())
    await until(queue, lambda stats: stats.waiting_gets == 1)
    await queue.delete()
    with pytest.raises(st.QueueNotFound, match=queue.name):
        await waiting
    with pytest.raises(st.QueueNotFound):
        await message.ack()
    assert queue.name not in {info.name for info in await rig.rt.queues("contract/*")}


async def test_queues_are_listed_by_name(rig: Rig) -> None:
    queue = await rig.queue(max_items=7)
    found = await rig.rt.queues(queue.name[:-3] + "*")
    assert [(info.name, info.policy.max_items, info.host_alive) for info in found] == [(queue.name, 7, True)]


@pytest.mark.parametrize(
    ("argument", "value"),
    [
        ("max_items", 0), ("copies", 0), ("on_full", "wait"), ("lease", "2h"), ("lease", "0s"), ("max_deliveries", 1.5),
        ("prefetch", 0), ("prefetch", 2000), ("codec", "yaml"), ("content_type", ""),
    ],
)  # fmt: skip
async def test_a_wrong_argument_is_named(rig: Rig, argument: str, value: object) -> None:
    with pytest.raises(st.InvalidArgument, match=argument):
        await rig.queue(**{argument: value})


async def test_a_put_is_checked_before_it_is_sent(rig: Rig) -> None:
    queue = await rig.queue()
    with pytest.raises(st.InvalidArgument, match="encode"):
        await queue.put("text")
    with pytest.raises(st.InvalidArgument, match="timeout"):
        await queue.get(timeout=-1)
    await queue.put(b"x")
    message = await queue.get(timeout=10)
    with pytest.raises(st.InvalidArgument, match="lease"):
        await message.extend("2h")
    with pytest.raises(st.InvalidArgument, match="delay"):
        await message.nack(delay="-1s")
