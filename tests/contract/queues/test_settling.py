"""Queues, on both clients: takers acknowledge messages, give them back, or let their leases end."""

from __future__ import annotations

import asyncio

import pytest

import stampede_rt as st
from tests.contract.queues.rig import Rig, adds_up, lease_from_now_on, until


async def test_a_nacked_message_is_delivered_again_before_later_messages(rig: Rig) -> None:
    queue = await rig.queue()
    for payload in (b"1", b"2"):
        await queue.put(payload)
    await (await queue.get(timeout=10)).nack()
    redelivered = await queue.get(timeout=10)
    assert (redelivered.payload, redelivered.deliveries) == (b"1", 2)


async def test_a_nack_with_a_delay_does_not_delay_other_messages(rig: Rig) -> None:
    queue = await rig.queue()
    for payload in (b"1", b"2"):
        await queue.put(payload)
    await (await queue.get(timeout=10)).nack(delay="60s")
    assert (await queue.get(timeout=10)).payload == b"2"


async def test_a_message_nacked_with_a_delay_is_delivered_again_after_the_delay(rig: Rig) -> None:
    queue = await rig.queue()
    await queue.put(b"1")
    await (await queue.get(timeout=10)).nack(delay="100ms")
    assert (await queue.get(timeout=10)).deliveries == 2


async def test_a_message_goes_to_the_next_taker_when_its_lease_ends(rig: Rig) -> None:
    queue = await rig.queue(lease="200ms")
    await queue.put(b"x")
    late = await queue.get(timeout=10)
    await lease_from_now_on(queue, "60s")
    redelivered = await queue.get(timeout=10)
    assert redelivered.deliveries == 2
    assert late.lease_left < 10  # the lease counts from the arrival of the message
    with pytest.raises(st.LeaseExpired, match=queue.name):
        await late.ack()
    await redelivered.ack()
    assert adds_up(await queue.stats()).leases_expired == 1


async def test_an_extension_counts_from_now_and_may_shorten_a_lease(rig: Rig) -> None:
    queue = await rig.queue(lease="20s")
    await queue.put(b"x")
    message = await queue.get(timeout=10)
    assert 0 < message.lease_left <= 20
    await message.extend("60s")
    assert message.lease_left > 30
    await message.extend("1ms")
    assert (await queue.get(timeout=10)).deliveries == 2


async def test_a_message_can_be_acknowledged_twice_but_not_nacked_afterwards(rig: Rig) -> None:
    queue = await rig.queue()
    await queue.put(b"x")
    message = await queue.get(timeout=10)
    await message.ack()
    await message.ack()
    with pytest.raises(st.LeaseExpired):
        await message.nack()


async def test_a_with_block_acknowledges_its_message_and_nacks_it_if_the_block_raises(rig: Rig) -> None:
    queue = await rig.queue()
    await queue.put(b"x")
    with pytest.raises(ZeroDivisionError):
        async with await queue.get(timeout=10):
            raise ZeroDivisionError
    async with await queue.get(timeout=10) as message:
        assert message.deliveries == 2
    stats = await queue.stats()
    assert (stats.consumed, stats.given_back) == (1, 1)


async def test_a_with_block_does_not_settle_a_message_that_is_settled_already(rig: Rig) -> None:
    queue = await rig.queue()
    await queue.put(b"x")
    async with await queue.get(timeout=10) as message:
        await message.nack()
    assert (await queue.stats()).consumed == 0


async def test_the_error_of_a_block_is_raised_even_if_the_lease_has_ended(rig: Rig) -> None:
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


async def test_a_live_taker_whose_lease_ended_gets_further_messages(rig: Rig) -> None:
    """Before the host skips a taker, it checks whether the taker is still alive."""
    queue = await rig.queue(lease="100ms")
    gets = [asyncio.ensure_future(queue.get(timeout=20)) for _ in range(3)]
    await until(queue, lambda stats: stats.waiting_gets == 1)
    await queue.put(b"x")
    done, _ = await asyncio.wait(gets, return_when=asyncio.FIRST_COMPLETED)
    assert len(done) == 1
    assert [message.payload for message in await asyncio.gather(*gets)] == [b"x"] * 3
