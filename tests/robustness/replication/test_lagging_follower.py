"""A follower behind a narrow link catches up under load; `tests.benchmarks.lagging_follower` measures this with more
writes.
"""

from __future__ import annotations

import asyncio
import signal
from pathlib import Path

from tests.benchmarks.lagging_follower import Load, lag, leader_of, narrow_cluster, open_channels
from tests.support.supernode.processes import attempts

BYTES_PER_SECOND = 100_000.0
CHANNELS, WRITES_PER_SECOND, MISSED_WRITES = 300, 100.0, 200


async def test_a_follower_behind_a_narrow_link_catches_up_while_writes_go_on(tmp_path: Path) -> None:
    async with narrow_cluster(tmp_path, BYTES_PER_SECOND) as supernodes:
        leader, follower = await leader_of(supernodes[:2]), supernodes[2]
        opened = await open_channels(supernodes[:2], CHANNELS)
        load = Load([one.stub for one in supernodes[:2]], opened, WRITES_PER_SECOND)
        writing = asyncio.create_task(load.run())
        try:
            await follower.end(signal.SIGKILL)
            before = load.done
            async for _ in attempts():
                if load.done > before + MISSED_WRITES:
                    break
            await follower.start()
            async for _ in attempts():
                if await lag(leader, follower) < WRITES_PER_SECOND / 2:
                    break
        finally:
            writing.cancel()
            await asyncio.gather(writing, return_exceptions=True)
        assert load.failed == 0
