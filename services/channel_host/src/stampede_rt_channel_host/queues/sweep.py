"""Looks after queues that nobody uses at the moment: leases end there, too."""

from __future__ import annotations

import asyncio
from typing import NoReturn

from stampede_rt_channel_host.queues.queue_store import QueueStore

ROUND_SECONDS = 0.5
QUEUES_PER_STEP_MAX = 256


async def sweep_queues_forever(store: QueueStore) -> NoReturn:
    """Look at every queue twice a second, a bounded number of them in one go.

    Each queue has a timer of its own for what is due; but the host's clock may run ahead of the loop's.
    """
    while True:  # paced
        await asyncio.sleep(ROUND_SECONDS)
        for place, hosted in enumerate(store.all()):
            if place % QUEUES_PER_STEP_MAX == QUEUES_PER_STEP_MAX - 1:
                await asyncio.sleep(0)
            due = hosted.queue.next_deadline()
            if due is not None and due <= store.now():
                hosted.tick()
