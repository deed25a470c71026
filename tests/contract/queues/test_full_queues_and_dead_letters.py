"""Queues, on both clients: full queues, and messages that no taker can process."""

from __future__ import annotations

import asyncio
import os

import pytest

import stampede_rt as st
from tests.contract.queues.rig import Rig, adds_up, until


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


async def test_a_full_queue_that_rejects_refuses_a_put_immediately(rig: Rig) -> None:
    queue = await rig.queue(max_items=1, on_full="reject")
    await queue.put(b"1")
    with pytest.raises(st.QueueFull):
        await queue.put(b"2")
    assert adds_up(await queue.stats()).rejected["full"] == 1


async def test_a_full_queue_that_drops_its_oldest_messages_counts_them(rig: Rig) -> None:
    queue = await rig.queue(max_items=2, on_full="drop_oldest")
    for number in range(5):
        await queue.put(str(number).encode())
    assert (await queue.get(timeout=10)).payload == b"3"
    assert adds_up(await queue.stats()).dropped == 3


async def test_a_queue_whose_messages_are_all_leased_drops_none_and_is_full(rig: Rig) -> None:
    queue = await rig.queue(max_items=1, on_full="drop_oldest")
    await queue.put(b"1")
    message = await queue.get(timeout=10)
    with pytest.raises(st.QueueFull, match="1 of them leased") as caught:
        await queue.put(b"2")
    assert isinstance(caught.value, st.Full)
    assert not isinstance(caught.value, st.ChannelFull)
    await message.ack()
    await queue.put(b"2")


async def test_a_lowered_max_deliveries_applies_immediately(rig: Rig) -> None:
    dead = await rig.queue()
    queue = await rig.queue(max_deliveries=9, dead_letter=dead.name)
    await queue.put(b"poison")
    for _ in range(3):
        await (await queue.get(timeout=10)).nack()
    await queue.configure(max_deliveries=2)
    assert (await dead.get(timeout=10)).payload == b"poison"
    assert (await until(queue, lambda stats: not stats.held)).delivered == 3


async def test_a_message_delivered_too_often_goes_to_the_dead_letter_queue(rig: Rig) -> None:
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


async def test_a_dead_letter_names_its_first_queue_and_the_reason_why_it_left(rig: Rig) -> None:
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


async def test_a_terminated_message_becomes_a_dead_letter_with_its_reason(rig: Rig) -> None:
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


async def test_a_terminated_message_is_expelled_if_its_queue_has_no_dead_letter_queue(rig: Rig) -> None:
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


async def test_a_message_delivered_too_often_is_expelled_and_counted_without_a_dead_letter_queue(rig: Rig) -> None:
    queue = await rig.queue(max_deliveries=1)
    await queue.put(b"poison")
    await (await queue.get(timeout=10)).nack()
    assert adds_up(await queue.stats()).expelled == 1
    assert await queue.get(timeout=0) is None
