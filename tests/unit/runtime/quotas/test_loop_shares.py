"""The turns of callers at one event loop."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt_runtime.quotas.loop_shares import BURST_NANOS, CONTENDED_NANOS, LoopShare, LoopShares

MS = 1_000_000


class Loop:
    """An event loop whose clock the test sets. Each step takes the stated time, and timers fire in order."""

    def __init__(self) -> None:
        self.now = 10**9
        self._timers: list[tuple[int, Callable[[], None]]] = []
        self.loop_shares = LoopShares(
            lambda: self.now, lambda delay_s, call: self._timers.append((self.now + round(delay_s * 1e9), call))
        )

    def caller(self, percent: int = 50) -> LoopShare:
        return LoopShare(self.loop_shares, percent)

    def works(self, loop_share: LoopShare, nanos: int) -> None:
        self.now += nanos
        loop_share.spend(nanos)

    def run_until(self, end: int) -> None:
        """Fire the timers that are due at or before `end`."""
        while due := [one for one in self._timers if one[0] <= end]:
            timer = min(due, key=lambda one: one[0])
            self._timers.remove(timer)
            self.now = max(self.now, timer[0])
            timer[1]()
        self.now = max(self.now, end)

    def fire_due(self) -> int:
        """Fire the timers that are due now, but no timer that a fired timer sets. Returns their number."""
        due = [one for one in self._timers if one[0] <= self.now]
        for timer in due:
            self._timers.remove(timer)
            timer[1]()
        return len(due)

    @property
    def is_quiet(self) -> bool:
        return not self._timers


def test_a_single_caller_never_waits_and_schedules_nothing() -> None:
    loop = Loop()
    alone = loop.caller()
    for _ in range(100):
        loop.works(alone, 5 * MS)
        assert not alone.must_wait
    assert loop.is_quiet


def test_the_caller_that_has_used_more_than_its_share_waits_and_the_other_does_not() -> None:
    loop = Loop()
    heavy, light = loop.caller(), loop.caller()
    loop.works(heavy, MS)
    loop.works(light, MS // 10)
    loop.works(heavy, 4 * MS)
    assert heavy.must_wait
    assert not light.must_wait


def test_a_caller_beyond_its_share_gets_its_percentage_of_the_time_in_order() -> None:
    loop = Loop()
    heavy, light = loop.caller(percent=25), loop.caller()
    loop.works(light, MS // 10)
    loop.works(heavy, 4 * MS)
    served: list[int] = []

    def step(number: int) -> Callable[[], None]:
        def woken() -> None:
            served.append(number)
            loop.works(heavy, MS)

        return woken

    for number in range(1000):
        heavy.enqueue(step(number))
    end = loop.now + 1000 * MS
    while loop.now < end:
        loop.works(light, MS // 10)
        loop.run_until(loop.now + 10 * MS)
    assert served == list(range(len(served)))
    assert 190 <= len(served) <= 260  # 25 % of a second, in steps of 1 ms


def test_a_waiting_caller_continues_immediately_when_the_other_callers_become_idle() -> None:
    loop = Loop()
    heavy, light = loop.caller(), loop.caller()
    loop.works(light, MS)
    loop.works(heavy, 50 * MS)
    served: list[int] = []
    for number in range(20):
        heavy.enqueue(lambda number=number: served.append(number))  # type: ignore[misc]
    loop.now += CONTENDED_NANOS
    loop.run_until(loop.now)
    loop.run_until(loop.now + 50 * MS)
    assert served == list(range(20))
    assert not heavy.has_line
    assert loop.is_quiet


def test_a_line_of_callers_takes_one_step_in_each_turn_of_the_loop_after_a_long_pause() -> None:
    loop = Loop()
    heavy, light = loop.caller(), loop.caller()
    loop.works(light, MS // 10)
    loop.works(heavy, 10 * MS)
    served: list[int] = []

    def step() -> None:
        served.append(loop.now)
        loop.works(heavy, MS // 10)

    for _ in range(100):
        heavy.enqueue(step)
    loop.now += 500 * MS  # the process had no processor, or another step took long
    loop.works(light, MS // 10)
    ticks = loop.fire_due()
    assert 1 <= len(served) <= ticks


def test_a_long_wait_of_one_caller_does_not_delay_another() -> None:
    loop = Loop()
    heavy, light, third = loop.caller(percent=1), loop.caller(), loop.caller()
    loop.works(light, MS)
    loop.works(heavy, 100 * MS)  # with a share of 1 % it gets 100 ms in 10 s
    heavy.enqueue(lambda: None)
    loop.works(light, 5 * MS)
    served: list[int] = []
    light.enqueue(lambda: served.append(loop.now))
    began = loop.now
    loop.works(third, MS // 10)
    loop.run_until(loop.now + 20 * MS)
    assert [at - began <= 15 * MS for at in served] == [True]


def test_a_caller_with_a_long_debt_waits_little_after_other_callers_are_idle() -> None:
    loop = Loop()
    heavy, light = loop.caller(percent=1), loop.caller()
    loop.works(light, MS)
    loop.works(heavy, 100 * MS)
    served: list[int] = []
    heavy.enqueue(lambda: served.append(loop.now))
    loop.run_until(loop.now + 2 * CONTENDED_NANOS)
    assert len(served) == 1
    assert loop.is_quiet


def test_a_caller_with_a_waiting_step_waits_even_if_the_loop_has_been_idle() -> None:
    loop = Loop()
    heavy, light = loop.caller(), loop.caller()
    loop.works(light, MS)
    loop.works(heavy, 20 * MS)
    heavy.enqueue(lambda: None)
    loop.now += 2 * CONTENDED_NANOS
    assert heavy.must_wait


def test_a_caller_with_a_few_messages_in_a_row_does_not_wait() -> None:
    loop = Loop()
    one, other = loop.caller(), loop.caller()
    loop.works(other, MS)
    loop.works(one, BURST_NANOS // 4)
    assert not one.must_wait


def test_a_step_of_a_caller_within_its_share_reads_the_clock_once() -> None:
    """Reading the clock takes a quarter of a microsecond. In an earlier version, a put read the clock five times."""
    loop, looks = Loop(), [0]
    busy, light = loop.caller(), loop.caller()
    loop.works(busy, MS)
    loop.works(light, MS)
    now, loop.loop_shares.now = loop.loop_shares.now, lambda: (looks.append(1), now())[1]  # type: ignore[func-returns-value]
    assert not light.must_wait
    light.spend_later(1000)
    light.spend_later(1000)
    light.spend(2000)
    assert sum(looks) == 1


def test_the_debt_of_a_step_counts_at_the_end_of_the_step() -> None:
    loop = Loop()
    busy, light = loop.caller(), loop.caller()
    loop.works(light, 1)
    busy.spend_later(BURST_NANOS)
    assert not busy.must_wait
    loop.works(busy, 1)
    assert busy.must_wait
    loop.works(busy, 1)
    loop.now += 2 * BURST_NANOS
    assert not busy.must_wait, "the debt was counted twice"


def test_a_caller_with_an_unlimited_share_never_waits() -> None:
    loop = Loop()
    one, other = loop.caller(percent=2**62), loop.caller()
    for _ in range(10):
        loop.works(other, MS)
        loop.works(one, 50 * MS)
        assert not one.must_wait


def test_a_share_reports_the_cpu_time_of_its_caller_in_the_last_second() -> None:
    loop = Loop()
    one = loop.caller()
    loop.works(one, 300 * MS)
    assert one.used_percent() == 0  # the second is not over
    loop.now += 10**9
    assert one.used_percent() == 30
    loop.now += 10**9
    assert one.used_percent() == 0
