"""Does the work that is due in queues without calls, such as ending leases."""

from __future__ import annotations

import asyncio
from typing import NoReturn

from stampede_rt_channel_host.queues.queue_store import QueueStore

ROUND_SECONDS = 0.5
QUEUES_PER_STEP_MAX = 4  # a queue with much work is due several times, each time for about a millisecond


async def sweep_queues_forever(store: QueueStore) -> NoReturn:
    """Twice a second, handle all queues in which something is due, a bounded number at a time.

    Each queue also has a timer of its own. But the timer fires too late if the host's clock is faster than the event
    loop's. And a queue sets no timer for the time at which it may forget silent producers.
    """
    while True:  # paced by the sleep
        await asyncio.sleep(ROUND_SECONDS)
        while sweep_queues(store):
            await _let_others_run()


def sweep_queues(store: QueueStore) -> int:
    """Handle up to QUEUES_PER_STEP_MAX due queues, or pieces of their work. Returns their number; 0 if none is due."""
    for at in range(QUEUES_PER_STEP_MAX):
        hosted = store.deadlines.pop(store.now())
        if hosted is None:
            return at
        hosted.tick()
    return QUEUES_PER_STEP_MAX


async def _let_others_run() -> None:
    await asyncio.sleep(0)
