"""Queues, on both clients: the list of leased messages, and messages that are put twice."""

from __future__ import annotations

import os

import pytest

import stampede_rt as st
from stampede_rt._async import queue as async_queue
from stampede_rt._sync import queue as sync_queue
from tests.contract.queues.rig import Rig, adds_up, numbers


async def test_the_pending_list_names_each_leased_message_and_its_taker(rig: Rig) -> None:
    named = await rig.connect(name=f"taker{next(numbers)}")
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


async def test_a_long_pending_list_is_read_page_by_page(rig: Rig, monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (async_queue, sync_queue):
        monkeypatch.setattr(module, "PENDING_PAGE_MAX", 2)
    queue = await rig.queue()
    seqs = [(await queue.put(b"x")).seq for _ in range(5)]
    for _ in seqs:
        await queue.get(timeout=10)
    assert [one.seq for one in await queue.pending()] == seqs
    assert [one.seq for one in await queue.pending(limit=3)] == seqs[:3]


async def test_a_second_put_of_a_message_id_is_acknowledged_and_not_stored(rig: Rig) -> None:
    queue = await rig.queue()
    other = await rig.queue(queue.name)
    first = await queue.put(b"charge 5", message_id="order-1")
    repeated = await other.put(b"charge 5", message_id="order-1")
    assert (first.duplicate, repeated.duplicate) == (False, True)
    assert (repeated.seq, repeated.incarnation) == (first.seq, first.incarnation)
    assert not (await queue.put(b"charge 5", message_id="Order-1")).duplicate
    assert not (await queue.put(b"charge 5")).duplicate
    await (await queue.get(timeout=10)).ack()
    # The queue knows the id also after a taker has acknowledged the message.
    assert (await queue.put(b"charge 5", message_id="order-1")).duplicate
    stats = adds_up(await queue.stats())
    assert (stats.accepted, stats.duplicates) == (3, 2)


async def test_a_refused_put_does_not_use_up_its_message_id(rig: Rig) -> None:
    queue = await rig.queue(max_items=1, on_full="reject")
    await queue.put(b"1", message_id="one")
    with pytest.raises(st.QueueFull):
        await queue.put(b"2", message_id="two")
    assert (await queue.put(b"1", message_id="one")).duplicate  # although the queue is full
    await (await queue.get(timeout=10)).ack()
    assert not (await queue.put(b"2", message_id="two")).duplicate


@pytest.mark.parametrize("message_id", ["", "x" * 129, 7])
async def test_a_value_that_is_no_message_id_is_refused(rig: Rig, message_id: object) -> None:
    queue = await rig.queue()
    with pytest.raises(st.InvalidArgument, match="message_id"):
        await queue.put(b"x", message_id=message_id)


async def test_a_mailbox_knows_message_ids_and_lists_pending_messages(rig: Rig) -> None:
    peer = await rig.connect(name=f"peer{next(numbers)}")
    first = await rig.rt.send(peer.name, b"x", message_id="one")
    repeated = await rig.rt.send(peer.name, b"x", message_id="one")
    assert (repeated.seq, repeated.duplicate) == (first.seq, True)
    mailbox = peer.mailbox
    message = await mailbox.get(timeout=10)
    (pending,) = await mailbox.pending()
    assert (pending.seq, pending.taker) == (message.seq, peer.name)
    assert await rig.rt.mailbox_pending(peer.name) == [pending]
    await message.term()
    assert await mailbox.pending() == []
    assert (await rig.rt.mailbox_stats(peer.name)).terminated == 1
