"""Waiting reads share one read. No caller gets the answer of a read that began before its call."""

from __future__ import annotations

import asyncio

import pytest

from stampede_rt_supernode.replication.interface import LogUnavailable
from stampede_rt_supernode.replication.rules.confirmed_reads import ConfirmedRead
from stampede_rt_supernode.replication.shared_reads import SharedReads
from stampede_rt_supernode.replication.threads.loop_bridge import LoopBridge


class Rig:
    """The reads that were begun. The test answers them in place of the log's thread."""

    def __init__(self, *, waiting_max: int = 100) -> None:
        self.begun: list[ConfirmedRead] = []
        self.shared = SharedReads(self.begun.append, LoopBridge(asyncio.get_running_loop()), waiting_max=waiting_max)

    async def ask(self, timeout: float = 60.0) -> asyncio.Task[int | None]:
        """Ask for a confirmed read, and return when the read waits."""
        task = asyncio.ensure_future(self.shared.confirm(timeout))
        await asyncio.sleep(0)
        return task


async def test_callers_that_arrive_during_a_confirmed_read_share_the_next_one() -> None:
    rig = Rig()
    first = await rig.ask()
    later = [await rig.ask() for _ in range(3)]
    assert len(rig.begun) == 1
    rig.begun[0].done(7)
    assert await first == 7
    assert not any(task.done() for task in later)
    assert len(rig.begun) == 2
    rig.begun[1].done(9)
    assert await asyncio.gather(*later) == [9, 9, 9]
    assert len(rig.begun) == 2


async def test_a_shared_read_lasts_until_the_latest_deadline_of_its_callers() -> None:
    rig = Rig()
    first = await rig.ask()
    short, patient = await rig.ask(0.01), await rig.ask(60.0)
    rig.begun[0].done(1)
    await first
    assert rig.begun[1].deadline - rig.begun[0].deadline < 1.0
    assert await short is None
    rig.begun[1].done(5)
    assert await patient == 5


async def test_a_cancelled_reader_does_not_cancel_the_shared_read_of_others() -> None:
    rig = Rig()
    first, second = await rig.ask(), await rig.ask()
    first.cancel()
    rig.begun[0].done(1)
    with pytest.raises(asyncio.CancelledError):
        await first
    rig.begun[1].done(2)
    assert await second == 2


async def test_a_closed_log_fails_all_waiting_reads_and_begins_no_new_reads() -> None:
    rig = Rig()
    first, second = await rig.ask(), await rig.ask()
    rig.shared.close()
    rig.begun[0].done(None)
    assert await asyncio.gather(first, second) == [None, None]
    assert len(rig.begun) == 1


async def test_the_number_of_waiting_readers_is_limited() -> None:
    rig = Rig(waiting_max=2)
    waiting = [await rig.ask() for _ in range(3)]
    with pytest.raises(LogUnavailable, match="slow down"):
        await rig.shared.confirm(1.0)
    rig.shared.close()
    rig.begun[0].done(3)
    assert await asyncio.gather(*waiting) == [3, None, None]
