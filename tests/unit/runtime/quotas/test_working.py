"""The work of streams, when it is the turn of their callers."""

from __future__ import annotations

import asyncio
import inspect
import os
from collections.abc import Callable, Coroutine
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import grpc.aio
import pytest

from stampede_rt_runtime.quotas import working
from stampede_rt_runtime.quotas.accounts import Account, Accounts, unlimited
from stampede_rt_runtime.quotas.limits import DEFAULTS, Quota, QuotaSetting, QuotaTable
from stampede_rt_runtime.quotas.loop_shares import LoopShares
from stampede_rt_runtime.quotas.working import (
    CALL_NANOS,
    GRPC_COSTS,
    LONG_BYTES,
    SOCKET_COSTS,
    CallerWork,
    TransportCosts,
    charged,
    loop_shares,
    usable_time,
)
from tests.support.forking.forked_children import in_a_forked_child

MS = 1_000_000


async def test_a_caller_with_much_work_does_not_block_another_caller() -> None:
    accounts = Accounts({**DEFAULTS, Quota.CPU_PERCENT: 1}, loop_shares=loop_shares())
    heavy, light = accounts.of("heavy"), accounts.of("light")
    order: list[str] = []

    async def work(name: str, one: CallerWork, steps: int) -> None:
        for _ in range(steps):
            if one.must_wait:
                await one.turn()
            one.spend(CALL_NANOS)
            order.append(name)
            await asyncio.sleep(0)

    CallerWork(light).spend(CALL_NANOS)
    tasks = [asyncio.create_task(work("heavy", CallerWork(heavy), 50)) for _ in range(20)]
    await asyncio.sleep(0)
    await work("light", CallerWork(light), 3)
    assert order.count("heavy") < 100  # there are 1000 steps
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def test_a_caller_that_leaves_its_line_does_not_delay_later_callers() -> None:
    accounts = Accounts({**DEFAULTS, Quota.CPU_PERCENT: 50}, loop_shares=loop_shares())
    heavy, light = accounts.of("heavy"), accounts.of("light")
    CallerWork(light).spend(CALL_NANOS)
    CallerWork(heavy).spend(CALL_NANOS)
    CallerWork(heavy).spend(CALL_NANOS)
    CallerWork(light).spend(CALL_NANOS)
    waiting = [asyncio.create_task(CallerWork(heavy).turn()) for _ in range(3)]
    await asyncio.sleep(0)
    waiting[0].cancel()
    async with asyncio.timeout(45):
        await asyncio.gather(*waiting[1:])


class Spent:
    """A share that keeps the spent time."""

    def __init__(self) -> None:
        self.nanos: list[int] = []

    def spend(self, nanos: int) -> None:
        self.nanos.append(nanos)


@pytest.mark.parametrize("form", [bytes, memoryview])  # a long frame of a socket comes as a view
@pytest.mark.parametrize("costs", [GRPC_COSTS, SOCKET_COSTS])
@pytest.mark.parametrize("length_bytes", [0, LONG_BYTES, LONG_BYTES + 1, 2**18])
async def test_the_bytes_of_a_long_message_count_for_its_caller(
    length_bytes: int, costs: TransportCosts, form: Callable[[bytes], Any]
) -> None:
    account: Any = SimpleNamespace(loop_share=Spent())
    CallerWork(account, costs).received(form(bytes(length_bytes)))
    assert account.loop_share.nanos == ([length_bytes * costs.kib_nanos // 1024] if length_bytes > LONG_BYTES else [])
    CallerWork(unlimited()).received(form(bytes(length_bytes)))
    CallerWork(account).received(grpc.aio.EOF)


async def test_a_caller_without_a_limit_never_waits() -> None:
    work = CallerWork(unlimited())
    work.spend(CALL_NANOS)
    assert not work.must_wait


async def test_a_changed_share_takes_effect_immediately() -> None:
    accounts = Accounts(loop_shares=loop_shares())
    heavy, light = accounts.of("heavy"), accounts.of("light")
    accounts.set_table(QuotaTable([QuotaSetting("heavy", Quota.CPU_PERCENT, 2**62)]))
    CallerWork(light).spend(CALL_NANOS)
    for _ in range(20):
        CallerWork(heavy).spend(CALL_NANOS)
    assert not CallerWork(heavy).must_wait
    accounts.set_table(QuotaTable())
    for _ in range(20):
        CallerWork(heavy).spend(CALL_NANOS)
    assert CallerWork(heavy).must_wait


class Clock:
    """The time of the loop. It passes only by calls of `works`."""

    def __init__(self) -> None:
        self.now = 10**9
        self.account = Account("one", DEFAULTS, loop_shares=LoopShares(lambda: self.now, lambda delay_s, call: None))

    def works(self, nanos: int) -> None:
        self.now += nanos

    def charged(self, work: Coroutine[Any, Any, Any]) -> Coroutine[Any, Any, Any]:
        """Charge the work to the one caller of this clock."""
        return charged(self.account, work)

    def used_ms(self) -> int:
        """The used time of the present second, in milliseconds."""
        self.now = (self.now // 10**9 + 1) * 10**9
        assert self.account.loop_share is not None
        return self.account.loop_share.used_percent() * 10


@pytest.fixture
def clock(monkeypatch: pytest.MonkeyPatch) -> Clock:
    one = Clock()
    monkeypatch.setattr("time.thread_time_ns", lambda: one.now)
    return one


async def test_the_steps_of_a_charged_call_count_for_its_caller_but_its_waits_do_not(clock: Clock) -> None:
    async def work() -> str:
        for _ in range(3):
            clock.works(100 * MS)
            await asyncio.sleep(0)
        return "done"

    task = asyncio.create_task(clock.charged(work()))
    while not task.done():
        clock.works(10 * MS)  # as if steps of other callers ran
        await asyncio.sleep(0)
    assert task.result() == "done"
    assert clock.used_ms() == 300


async def test_a_cancelled_charged_call_cleans_up_and_this_work_counts(clock: Clock) -> None:
    async def work() -> None:
        try:
            await asyncio.Event().wait()
        finally:
            clock.works(50 * MS)

    task = asyncio.create_task(clock.charged(work()))
    await asyncio.sleep(0)
    task.cancel()
    await asyncio.wait({task})
    assert task.cancelled()
    assert clock.used_ms() == 50


async def test_the_coroutine_of_a_charged_task_that_is_cancelled_before_it_begins_is_closed(clock: Clock) -> None:
    async def work() -> None:
        await asyncio.Event().wait()

    inner = work()
    task = asyncio.create_task(clock.charged(inner))
    task.cancel()
    await asyncio.wait({task})
    assert inspect.getcoroutinestate(inner) == inspect.CORO_CLOSED


async def test_a_charged_call_may_continue_after_an_error_and_raises_its_last_one(clock: Clock) -> None:
    async def work() -> None:
        try:
            async with asyncio.timeout(0):
                await asyncio.Event().wait()
        except TimeoutError:
            clock.works(10 * MS)
            await asyncio.sleep(0)
            raise KeyError("no") from None

    with pytest.raises(KeyError):
        await clock.charged(work())
    assert clock.used_ms() == 10


async def test_the_work_of_a_caller_without_quotas_is_not_measured() -> None:
    async def work() -> int:
        await asyncio.sleep(0)
        return 1

    measured = work()
    assert charged(unlimited(), measured) is measured
    assert await measured == 1


def test_usable_time_excludes_the_time_for_which_a_thread_waits_for_a_processor() -> None:
    passed, waited = 0, 0
    usable = usable_time(lambda: passed, lambda: waited)
    passed = 50 * MS
    assert usable() == 50 * MS
    passed, waited = 150 * MS, 70 * MS
    assert usable() == 80 * MS


def test_usable_time_never_goes_back() -> None:
    passed, waited = 10**9, 0
    usable = usable_time(lambda: passed, lambda: waited)
    seen = [usable()]
    for _ in range(100):
        passed += 3 * MS
        waited += 2 * MS
        seen.append(usable())
    assert seen == sorted(seen)
    assert seen[-1] - seen[0] <= 110 * MS


def test_usable_time_continues_soon_after_a_failed_read_of_the_statistics() -> None:
    passed, waited = 100_000 * MS, 60_000 * MS
    usable = usable_time(lambda: passed, lambda: waited)
    assert usable() == 40_000 * MS
    passed, waited = 100_020 * MS, 0  # the process had no file descriptor left to read the wait
    assert usable() == 40_020 * MS
    passed, waited = 100_040 * MS, 60_010 * MS
    assert usable() == 40_030 * MS


def test_the_system_reports_how_long_a_thread_has_waited(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    reported = tmp_path / "schedstat"
    reported.write_text(f"1000 {2 * MS} 7\n")  # the time at work, the time without a processor, and the time slices
    monkeypatch.setattr(working, "SCHEDULER_STATISTICS", reported)
    monkeypatch.setattr(working, "_statistics", working._Statistics())
    assert usable_time(lambda: 5 * MS)() == 3 * MS
    monkeypatch.setattr(working, "SCHEDULER_STATISTICS", Path("/nowhere"))
    monkeypatch.setattr(working, "_statistics", working._Statistics())
    assert usable_time(lambda: 5 * MS)() == 5 * MS


def test_the_statistics_of_a_thread_are_opened_once(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, each call opened the statistics if a port had only a few calls per second."""
    opened: list[object] = []
    real_open = os.open

    def noted(path: Any, *arguments: Any) -> int:
        opened.append(path)
        return real_open(path, *arguments)

    monkeypatch.setattr(os, "open", noted)
    monkeypatch.setattr(working, "_statistics", working._Statistics())
    clock = usable_time(iter(range(0, 10**9, working.ASK_NANOS)).__next__)
    for _ in range(5):
        clock()
    assert opened == [working.SCHEDULER_STATISTICS]


def test_a_fork_of_the_importing_process_opens_its_own_statistics(monkeypatch: pytest.MonkeyPatch) -> None:
    """In an earlier version, the import opened the statistics of the importing thread, and the fork then read its
    parent's.
    """
    monkeypatch.setattr(working, "_statistics", working._Statistics())  # as the import makes it

    def in_child() -> tuple[int, str]:
        usable_time()()
        return os.getpid(), os.readlink(f"/proc/self/fd/{working._statistics.file.number}")

    pid, opened = in_a_forked_child(in_child)
    assert pid != os.getpid()
    assert opened == f"/proc/{pid}/task/{pid}/schedstat"
