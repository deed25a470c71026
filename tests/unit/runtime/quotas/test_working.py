"""The work of streams, when it is the turn of their callers."""

from __future__ import annotations

import asyncio

from stampede_rt_runtime.quotas.accounts import Accounts, unlimited
from stampede_rt_runtime.quotas.limits import DEFAULTS, Quota, QuotaSetting, QuotaTable
from stampede_rt_runtime.quotas.working import CallerWork, loop_turns


async def test_much_work_of_one_caller_lets_the_work_of_another_one_pass() -> None:
    accounts = Accounts({**DEFAULTS, Quota.CPU_PERCENT: 1}, turns=loop_turns())
    heavy, light = accounts.of("heavy"), accounts.of("light")
    order: list[str] = []

    async def work(name: str, one: CallerWork, steps: int) -> None:
        for _ in range(steps):
            if one.must_wait:
                await one.turn()
            one.begin()
            order.append(name)
            one.end()
            await asyncio.sleep(0)

    CallerWork(light).count_call()
    tasks = [asyncio.create_task(work("heavy", CallerWork(heavy), 50)) for _ in range(20)]
    await asyncio.sleep(0)
    await work("light", CallerWork(light), 3)
    assert order.count("heavy") < 100  # of 1000
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


async def test_a_caller_that_leaves_its_line_does_not_hold_up_those_behind_it() -> None:
    accounts = Accounts({**DEFAULTS, Quota.CPU_PERCENT: 50}, turns=loop_turns())
    heavy, light = accounts.of("heavy"), accounts.of("light")
    CallerWork(light).count_call()
    CallerWork(heavy).count_call()
    CallerWork(heavy).count_call()
    CallerWork(light).count_call()
    waiting = [asyncio.create_task(CallerWork(heavy).turn()) for _ in range(3)]
    await asyncio.sleep(0)
    waiting[0].cancel()
    async with asyncio.timeout(10):
        await asyncio.gather(*waiting[1:])


async def test_what_nobody_is_bound_by_never_waits() -> None:
    work = CallerWork(unlimited())
    work.begin()
    work.end()
    work.count_call()
    assert not work.must_wait


async def test_a_change_of_the_share_is_heeded_at_once() -> None:
    accounts = Accounts(turns=loop_turns())
    heavy, light = accounts.of("heavy"), accounts.of("light")
    accounts.tell(QuotaTable([QuotaSetting("heavy", Quota.CPU_PERCENT, 2**62)]))
    CallerWork(light).count_call()
    for _ in range(20):
        CallerWork(heavy).count_call()
    assert not CallerWork(heavy).must_wait
    accounts.tell(QuotaTable())
    for _ in range(20):
        CallerWork(heavy).count_call()
    assert CallerWork(heavy).must_wait
