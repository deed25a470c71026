"""Cases of queues."""

from __future__ import annotations

import asyncio

from stampede_rt_channel_host.core.queue import Enqueue, QueueCore, QueueLimits, TakerState
from stampede_rt_channel_host.queues.frames import take_response
from tests.benchmarks.longest_pause.watch import Work
from tests.support.channel_host.rig import Rig


async def batches(rig: Rig, messages: int) -> tuple[str, Work]:
    """The core alone. The case calls `tick` as the shell would."""
    queue = QueueCore(QueueLimits(max_items=messages, max_bytes=2**40), incarnation=1)
    takers = [TakerState(taker_id, None) for taker_id in range(1, 101)]
    for _ in range(messages):
        queue.enqueue(Enqueue([1], lambda first_seq, places, stamped: b"x" * 24), rig.now())

    async def work() -> None:
        for taker in takers:
            queue.grant(taker, messages // len(takers), rig.now())
            await asyncio.sleep(0)
        taken = 0
        while taken < messages:
            for taker, batch in queue.take_batches():
                queue.sending(taker)
                take_response(batch, (), rig.now())
                taken += sum(one.hi - one.lo for one in batch.slices)
                await asyncio.sleep(0)
                queue.sent(taker, rig.now())
            queue.tick(rig.now())
            await asyncio.sleep(0)

    return f"{messages:,} single messages are given to 100 takers", work
