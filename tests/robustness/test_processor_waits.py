"""The verdict about a lost lease: whether the machine kept the services from a processor."""

from __future__ import annotations

import os

from tests.robustness.processor_waits import PERIOD_SECONDS, SAMPLES, ProcessorWaits, waited_nanos

S = 10**9


def sampled(shares: list[float]) -> ProcessorWaits:
    """Samples of two threads. The first waits for the given share of each period, and the second never waits."""
    waits, waited, now_s = ProcessorWaits(list), 0.0, 0.0
    waits.add_sample(now_s, {"a": 0, "b": 0})
    for share in shares:
        now_s += PERIOD_SECONDS
        waited += share * PERIOD_SECONDS
        waits.add_sample(now_s, {"a": int(waited * S), "b": 0})
    return waits


def test_a_lost_lease_is_excused_only_around_the_time_when_a_service_waited_for_a_processor() -> None:
    waits = sampled([0.1] * 4 * SAMPLES + [0.9] * SAMPLES + [0.1] * 8 * SAMPLES)
    starved_s = 5 * SAMPLES * PERIOD_SECONDS
    assert waits.starved_at(starved_s)
    assert waits.starved_at(starved_s + 3)
    assert not waits.starved_at(4)
    assert not waits.starved_at(starved_s + 7)


def test_one_short_wait_and_the_waits_on_a_busy_machine_do_not_excuse_a_lost_lease() -> None:
    waits = sampled([0.5] * 3 * SAMPLES + [1.0] + [0.4] * 3 * SAMPLES)
    assert 0.5 <= waits.most_share < 0.6
    assert not any(waits.starved_at(moment) for moment in range(20))


def test_the_waits_of_a_thread_before_its_first_sample_do_not_count() -> None:
    waits = sampled([0.0] * 2 * SAMPLES)
    waits.add_sample(100.0, {"new": 50 * S})
    assert not waits.starved_at(100.0)


def test_the_kernel_counts_the_waits_of_this_process() -> None:
    before = waited_nanos([os.getpid()])
    assert f"/proc/{os.getpid()}/task/{os.getpid()}/schedstat" in before
    assert all(nanos >= before.get(thread, 0) for thread, nanos in waited_nanos([os.getpid()]).items())
    assert waited_nanos([2**22 + 1]) == {}
