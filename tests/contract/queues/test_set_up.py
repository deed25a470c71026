"""Queues, on both clients: creation, changes, lists, deletion, and wrong arguments."""

from __future__ import annotations

import asyncio

import pytest

import stampede_rt as st
from tests.contract.queues.rig import Rig, until


async def test_an_argument_that_differs_from_the_policy_of_the_queue_is_refused(rig: Rig) -> None:
    queue = await rig.queue(max_items=3, lease="10s")
    assert await rig.queue(queue.name) == queue
    assert await rig.queue(queue.name, lease="10s") == queue
    with pytest.raises(st.QueueExists, match=queue.name):
        await rig.queue(queue.name, max_items=4)


async def test_a_missing_queue_is_not_created_if_the_caller_says_create_false(rig: Rig) -> None:
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


async def test_waiting_takers_and_holders_of_messages_learn_that_their_queue_was_deleted(rig: Rig) -> None:
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
async def test_the_error_names_the_wrong_argument(rig: Rig, argument: str, value: object) -> None:
    with pytest.raises(st.InvalidArgument, match=argument):
        await rig.queue(**{argument: value})


async def test_the_client_checks_arguments_before_it_sends_them(rig: Rig) -> None:
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


async def test_a_queue_without_enough_replicas_acknowledges_no_put_and_delivers_nothing(rig: Rig) -> None:
    """The cluster of these tests has one host, so no replica can be in sync."""
    queue = await rig.queue(replicas=1, ack="replica")
    assert (queue.info.policy.replicas, queue.info.policy.ack) == (1, "replica")
    with pytest.raises(st.NotReplicated, match="min_replicas is 1") as caught:
        await queue.put(b"1", timeout=0)
    assert (caught.value.metadata["seq"], caught.value.metadata["copies"]) == ("1", "1")
    assert await queue.get(timeout=0) is None
    await queue.configure(min_replicas=0)
    message = await queue.get(timeout=40)
    assert (message.payload, message.deliveries) == (b"1", 1)
    await message.ack()
    put = await queue.put(b"2")
    assert (put.seq, put.copies) == (2, 1)
    stats = await until(queue, lambda stats: stats.consumed == 1)
    assert stats.replicas == ()


async def test_a_queue_stops_waiting_for_replicas_when_its_policy_no_longer_requires_them(rig: Rig) -> None:
    queue = await rig.queue(replicas=1, ack="replica")
    waiting = asyncio.ensure_future(queue.put(b"1"))
    await until(queue, lambda stats: stats.held == 1)
    await queue.configure(replicas=0, ack="host")
    assert (await waiting).copies == 1
    async with await queue.get(timeout=40) as message:
        assert message.payload == b"1"
    await queue.configure(replicas=1, ack="replica", min_replicas=0)
    assert (await queue.put(b"2")).seq == 2
    async with await queue.get(timeout=40) as message:
        assert message.payload == b"2"


async def test_replicas_without_their_ack_are_refused_and_change_nothing(rig: Rig) -> None:
    queue = await rig.queue()
    for wrong in ({"replicas": 1}, {"ack": "replica"}, {"ack": "disk"}, {"replicas": 5, "ack": "replica"}):
        with pytest.raises(st.InvalidArgument):
            await queue.configure(**wrong)
    with pytest.raises(st.InvalidArgument):
        await rig.queue(replicas=1, ack="replica", min_replicas=2)
    assert (await queue.stats()).policy == queue.info.policy


async def test_the_mailbox_of_a_peer_waits_for_replicas_if_its_policy_requires_them(rig: Rig) -> None:
    rt = await rig.connect(name=rig.name().replace("/", "-"))
    mailbox = rt.mailbox
    policy = await mailbox.configure(replicas=1, ack="replica", min_replicas=0)
    assert (policy.replicas, policy.ack, policy.min_replicas) == (1, "replica", 0)
    await rig.rt.send(mailbox.name, b"hello")
    async with await mailbox.get(timeout=40) as message:
        assert message.payload == b"hello"
