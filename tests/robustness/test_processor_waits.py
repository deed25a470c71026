"""The verdict about a lost lease: whether the machine kept the services from a processor."""

from __future__ import annotations

import os

from tests.robustness.processor_waits import LOOKS, PERIOD_SECONDS, ProcessorWaits, waited_nanos

S = 10**9


def looked(shares: list[float]) -> ProcessorWaits:
    """Looks at one thread, which waits for a share of the time between two looks. A second thread never waits."""
    waits, waited, now_s = ProcessorWaits(list), 0.0, 0.0
    waits.look(now_s, {"a": 0, "b": 0})
    for share in shares:
        now_s += PERIOD_SECONDS
        waited += share * PERIOD_SECONDS
        waits.look(now_s, {"a": int(waited * S), "b": 0})
    return waits


def test_a_service_that_waits_for_a_processor_most_of_the_time_may_lose_its_lease_then_and_no_later() -> None:
    waits = looked([0.1] * 4 * LOOKS + [0.9] * LOOKS + [0.1] * 8 * LOOKS)
    starved_s = 5 * LOOKS * PERIOD_SECONDS
    assert waits.starved_at(starved_s)
    assert waits.starved_at(starved_s + 3)
    assert not waits.starved_at(4)
    assert not waits.starved_at(starved_s + 7)


def test_a_short_wait_and_waits_of_a_busy_but_not_overloaded_machine_excuse_nothing() -> None:
    waits = looked([0.5] * 3 * LOOKS + [1.0] + [0.4] * 3 * LOOKS)
    assert 0.5 <= waits.most_share < 0.6
    assert not any(waits.starved_at(moment) for moment in range(20))


def test_a_thread_that_comes_later_counts_from_then_on() -> None:
    waits = looked([0.0] * 2 * LOOKS)
    waits.look(100.0, {"new": 50 * S})
    assert not waits.starved_at(100.0)


def test_the_kernel_counts_the_waits_of_this_process() -> None:
    before = waited_nanos([os.getpid()])
    assert f"/proc/{os.getpid()}/task/{os.getpid()}/schedstat" in before
    assert all(nanos >= before.get(thread, 0) for thread, nanos in waited_nanos([os.getpid()]).items())
    assert waited_nanos([2**22 + 1]) == {}
