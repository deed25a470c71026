"""Queues, on both clients: which taker gets which message, in which order, and prefetched messages."""

from __future__ import annotations

import asyncio
from functools import partial

import pytest

import stampede_rt as st
from tests.contract.queues.rig import Rig, adds_up, until


async def test_messages_are_delivered_once_each_in_the_order_of_their_acceptance(rig: Rig) -> None:
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


async def test_a_get_from_an_empty_queue_returns_none_after_its_timeout(rig: Rig) -> None:
    queue = await rig.queue()
    assert await queue.get(timeout=0) is None
    assert await queue.get(timeout=0.05) is None
    assert (await until(queue, lambda stats: not stats.waiting_gets)).delivered == 0


async def test_a_message_in_the_queue_is_taken_without_waiting(rig: Rig) -> None:
    queue = await rig.queue()
    await queue.put(b"x")
    message = await queue.get(timeout=0)
    assert (message.payload, message.deliveries) == (b"x", 1)


async def test_a_get_waits_for_a_message(rig: Rig) -> None:
    queue = await rig.queue()
    get = asyncio.ensure_future(queue.get())
    await until(queue, lambda stats: stats.waiting_gets == 1)
    await queue.put(b"x")
    assert (await get).payload == b"x"


async def test_a_taken_message_equals_the_put_message(rig: Rig) -> None:
    queue = await rig.queue(codec="json")
    began = st.now()
    await queue.put({"goal": [1, 2]}, attributes={"from": "planner"})
    message = await queue.get(timeout=10)
    assert (message.value, message.attributes) == ({"goal": [1, 2]}, {"from": "planner"})
    assert message.content_type == "application/json"
    assert abs(message.time - began) < 60 * 10**9


async def test_a_payload_that_does_not_decode_names_the_queue_and_the_message(rig: Rig) -> None:
    plain = await rig.queue()
    seq = (await plain.put(b"{")).seq
    queue = await rig.queue(plain.name, codec="json")
    message = await queue.get(timeout=10)
    with pytest.raises(st.CodecError, match=f"queue '{plain.name}': message #{seq}"):
        _ = message.value


async def test_iteration_takes_one_message_after_the_other_until_the_handle_is_closed(rig: Rig) -> None:
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
    await asyncio.wait_for(working, 45)
    assert found == [b"0", b"1", b"2"]
    with pytest.raises(st.InvalidArgument, match="closed"):
        await queue.get(timeout=0)


async def test_a_message_with_copies_is_delivered_to_that_many_takers(rig: Rig) -> None:
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


async def test_the_taker_that_waits_longest_is_served_first(rig: Rig) -> None:
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


async def test_by_default_no_message_is_taken_before_a_caller_waits_for_one(rig: Rig) -> None:
    queue = await rig.queue()
    for number in range(3):
        await queue.put(str(number).encode())
    await queue.get(timeout=10)
    assert (await queue.stats()).leased == 1


async def test_prefetched_messages_go_back_when_the_handle_is_closed(rig: Rig) -> None:
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


def _has_leased(messages: int, stats: st.QueueStats) -> bool:
    return stats.leased == messages


async def test_a_message_that_no_caller_received_does_not_count_as_delivered(rig: Rig) -> None:
    """Without this rule, takers that prefetch and leave use up deliveries of messages that no caller has seen."""
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


async def test_closing_the_connection_nacks_prefetched_messages(rig: Rig) -> None:
    queue = await rig.queue()
    leaving = await rig.connect()
    greedy = await leaving.queue(queue.name, prefetch=4)
    for _ in range(3):
        await queue.put(b"x")
    await greedy.get(timeout=10)
    await until(queue, lambda stats: stats.leased == 3)
    await leaving.aclose()
    assert (await until(queue, lambda stats: stats.leased == 1)).given_back == 2
