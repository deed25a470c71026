"""Looks after queues that nobody uses at the moment: leases end there, too."""

from __future__ import annotations

import asyncio
from typing import NoReturn

from stampede_rt_channel_host.queues.queue_store import QueueStore

ROUND_SECONDS = 0.5
QUEUES_PER_STEP_MAX = 64


async def sweep_queues_forever(store: QueueStore) -> NoReturn:
    """Look twice a second at the queues in which something is due, a bounded number of them in one go.

    Each queue has a timer of its own for what is due; but the host's clock may run ahead of the loop's.
    """
    while True:  # paced
        await asyncio.sleep(ROUND_SECONDS)
        while sweep_queues(store):
            await _give_way()


def sweep_queues(store: QueueStore) -> int:
    """A bounded part; how many were due."""
    for at in range(QUEUES_PER_STEP_MAX):
        hosted = store.deadlines.pop(store.now())
        if hosted is None:
            return at
        hosted.tick()
    return QUEUES_PER_STEP_MAX


async def _give_way() -> None:
    await asyncio.sleep(0)
