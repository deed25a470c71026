"""Periods and sampling by a clock that a test moves."""

from __future__ import annotations

import asyncio
from typing import Any, cast

import pytest

import stampede_rt as st
from stampede_rt._async.sampler import Sampler
from stampede_rt._async.session import Session
from stampede_rt.pacing.periods import Periods
from stampede_rt.transports.concurrency_async import Signal


def test_due_times_are_counted_from_the_start() -> None:
    periods = Periods(100, 10)
    waits = []
    for now in (100, 113, 129, 130):
        waits.append(periods.wait_nanos(now))
        periods.begin(now + waits[-1])
    assert (waits, periods.missed) == ([0, 0, 0, 0], 0)
    assert periods.wait_nanos(131) == 9


def test_a_period_that_has_passed_completely_counts_as_missed() -> None:
    periods = Periods(0, 10)
    periods.begin(0)
    assert periods.wait_nanos(45) == 0
    periods.begin(45)
    assert (periods.missed, periods.wait_nanos(45)) == (3, 5)


def test_a_late_sample_is_still_taken() -> None:
    periods = Periods(0, 10)
    periods.begin(0)
    periods.begin(19)
    assert (periods.missed, periods.wait_nanos(19)) == (0, 1)


class TestClock:
    """A clock that moves only while a caller waits, or when the sampled function moves it."""

    __test__ = False

    def __init__(self) -> None:
        self.now = 1_000

    def nanos(self) -> int:
        return self.now

    async def wait(self, stop: Signal, timeout_nanos: int) -> bool:
        self.now += timeout_nanos
        return await stop.wait(0)


class SessionParts:
    """The parts of a session that a sampler uses."""

    closed = False

    def check_process(self) -> None:
        return

    def check_thread(self) -> None:
        return

    def __init__(self) -> None:
        self.attached: list[Any] = []

    def attach(self, one: Any) -> None:
        self.attached.append(one)

    def detach(self, one: Any) -> None:
        self.attached.remove(one)


def sampler(clock: TestClock, session: SessionParts, function: Any, put: Any) -> Sampler:
    return Sampler(cast(Session, session), "channel 'x'", put, function, 10, clock)


async def test_samples_do_not_drift_and_missed_samples_are_counted() -> None:
    clock, session, times = TestClock(), SessionParts(), []
    lasts = {0: 3, 1: 7, 2: 38, 3: 0}  # the time that each call takes; a period is 10

    def sample() -> int:
        times.append(clock.now - 1_000)
        clock.now += lasts.get(len(times) - 1, 0)
        if len(times) == 6:
            made.cancel()
        return clock.now

    async def put(value: int, timeout_s: float) -> None:
        assert timeout_s == 10 / 1e9

    made = sampler(clock, session, sample, put)
    assert await made.join(10)
    assert times == [0, 10, 20, 58, 60, 70]
    assert (made.samples, made.missed, made.active, session.attached) == (6, 2, False, [])


async def test_a_coroutine_function_can_be_sampled() -> None:
    clock, session, put_values = TestClock(), SessionParts(), []

    async def sample() -> int:
        await asyncio.sleep(0)
        return 5

    async def put(value: int, timeout_s: float) -> None:
        put_values.append(value)
        made.cancel()

    made = sampler(clock, session, sample, put)
    assert await made is made
    assert await made.join(10)
    assert put_values == [5]


async def test_a_cancelled_sampled_function_has_failed() -> None:
    clock, session = TestClock(), SessionParts()

    async def sample() -> None:
        if made.failures:
            made.cancel()
            return
        task = asyncio.ensure_future(asyncio.Event().wait())
        task.cancel()
        await task

    async def put(value: int, timeout_s: float) -> None:
        raise AssertionError("the sampler must put nothing")

    made = sampler(clock, session, sample, put)
    assert await made.join(10)
    assert (made.failures, made.samples) == (1, 0)


def test_a_coroutine_function_is_refused_in_the_blocking_client() -> None:
    from stampede_rt.transports.concurrency_sync import check_callback

    async def fn() -> None: ...

    with pytest.raises(st.InvalidArgument, match="aio"):
        check_callback(fn)
