"""Callers of one channel: puts, producers, reads, subscriptions."""

from __future__ import annotations

import asyncio
from typing import Any

import stampede_rt as st
from tests.robustness.fuzz.calling import ENDED, FAILED, INTERRUPTED, CallingClient
from tests.robustness.fuzz.ledger import Ledger

SIZES = (0, 10, 1000, 70_000)
STEP_S_MAX = 600.0
LAST = b"the last"


def payload_of(calling: CallingClient, who: str, number: int) -> bytes:
    """A payload that no other put has."""
    return f"{who} {number} ".encode() + bytes(calling.rng.choice(SIZES))


async def put_items(calling: CallingClient, channel: Any, ledger: Ledger, who: str, over: asyncio.Event) -> None:
    """Put items one after the other."""
    number = 0
    while not over.is_set():
        payload = payload_of(calling, who, number := number + 1)
        call = calling.plain(channel.put, payload, timeout=1)
        outcome = await calling.outcome("put", call, 1)
        (ledger.open if outcome in (INTERRUPTED, FAILED) else ledger.accepted).add(payload)


async def put_by_producer(calling: CallingClient, channel: Any, ledger: Ledger, who: str, over: asyncio.Event) -> None:
    """Put without waiting for acks, and flush now and then. At the end the host has all items of the producer."""
    producer = channel.producer()
    handed: set[bytes] = set()
    number = 0
    while not over.is_set():
        payload = payload_of(calling, who, number := number + 1)
        outcome = await calling.outcome("put of a producer", calling.plain(producer.put, payload))
        if outcome not in (INTERRUPTED, FAILED):
            handed.add(payload)
        if calling.rng.random() < 0.1:
            await calling.outcome("flush", calling.plain(producer.flush, 2), 2)
        await asyncio.sleep(0)
    await calling.plain(producer.flush, 60)
    assert (producer.accepted, producer.rejections) == (len(handed), 0)
    await calling.plain(producer.aclose if calling.is_async else producer.close)
    ledger.accepted |= handed


async def read(calling: CallingClient, channel: Any, over: asyncio.Event) -> None:
    """Reads of all kinds."""
    while not over.is_set():
        kind = calling.rng.randrange(4)
        if kind == 0:
            call = calling.plain(channel.newest, timeout=0.05)
        elif kind == 1:
            call = calling.plain(channel.get, st.OLDEST, st.NEWEST, limit=5, payloads=False)
        elif kind == 2:
            call = calling.plain(channel.get, st.now(), st.now() + 10**9, timeout=0.2, complete=True)
        else:
            call = calling.plain(channel.stats)
        await calling.outcome(f"read {kind}", call, 1)


async def subscribe(calling: CallingClient, channel: Any) -> list[st.Item]:
    """Get all items up to LAST, one by one or in batches. Some steps are cancelled."""
    subscription = await subscribed(calling, channel)
    batches = subscription.batches()
    items: list[st.Item] = []
    while not items or items[-1].payload != LAST:
        in_batch = calling.rng.random() < 0.3
        step = asyncio.ensure_future(calling.step(batches if in_batch else subscription))
        if calling.is_async and calling.rng.random() < 0.2:
            await calling.interrupt(step)
        item = await calling.ended("step of a subscription", step, STEP_S_MAX)
        assert item not in (FAILED, ENDED)
        if item is not INTERRUPTED:
            items += item if in_batch else [item]
    subscription.close()
    return items


async def subscribed(calling: CallingClient, channel: Any) -> Any:
    """Subscribe from the oldest item on, and try again after a failure. The blocking client opens the stream here."""
    while True:
        made = await calling.outcome("subscribe", calling.plain(channel.subscribe, st.OLDEST), 0)
        if made not in (FAILED, INTERRUPTED):
            return made
