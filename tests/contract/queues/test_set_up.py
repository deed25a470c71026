"""Queues, on both clients: creation, changes, lists, deletion, and wrong arguments."""

from __future__ import annotations

import asyncio

import pytest

import stampede_rt as st
from tests.contract.queues.rig import Rig, until


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


async def test_a_queue_cannot_be_its_own_dead_letter_queue(rig: Rig) -> None:
    name = rig.name()
    with pytest.raises(st.InvalidArgument, match=f"dead_letter is queue '{name}' itself"):
        await rig.queue(name, dead_letter=name)  # also before the queue exists
    queue = await rig.queue(name)
    for own in (name, queue):
        with pytest.raises(st.InvalidArgument, match=f"dead_letter is queue '{name}' itself"):
            await queue.configure(dead_letter=own)


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
