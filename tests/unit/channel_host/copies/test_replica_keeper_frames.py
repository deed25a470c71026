"""The tasks of a keeper of replicas leave no frames behind, because these keep a whole queue or channel in memory."""

from __future__ import annotations

import asyncio
import gc
import weakref

from stampede_rt_channel_host.copies.replica_keeper import _log_defect


class Feed:
    """A feed of a replica, whose tasks run until it is cancelled."""

    async def run(self) -> None:
        """Run the tasks."""
        async with asyncio.TaskGroup() as sides:
            sides.create_task(asyncio.Event().wait())


async def test_a_cancelled_feed_is_freed_without_the_collector() -> None:
    """In an earlier version, each move of a queue with replicas left the queue in memory for ten minutes: the task of a
    feed kept the frame of the feed, and a task group in this frame kept the task.
    """
    feed = Feed()
    kept = weakref.ref(feed)
    task = asyncio.create_task(feed.run())
    task.add_done_callback(_log_defect)
    await asyncio.sleep(0)
    gc.disable()
    try:
        task.cancel()
        await asyncio.wait({task})
        del feed, task
        await asyncio.sleep(0)
        assert kept() is None
    finally:
        gc.enable()
