"""The payloads of publishers, and their times."""

from __future__ import annotations

import time
from multiprocessing import get_context

from stampede_rt_bench.workloads.payloads import PAUSE_SECONDS, SENT, at_full_speed, at_rate, needs_of, window_items
from stampede_rt_bench.workloads.run_counters import RunCounters

NEVER = float("inf")


def progress() -> RunCounters:
    return RunCounters(get_context("forkserver"), readers=1)


def test_a_publisher_at_full_speed_pauses_while_a_window_of_its_items_is_unread() -> None:
    shared, needs = progress(), needs_of(300_000)
    steps = at_full_speed(shared, needs, NEVER)
    sent = 0
    while not isinstance(step := next(steps), float):
        sent += len(step)
    assert step == PAUSE_SECONDS
    assert sent == window_items(300_000) == shared.published()
    shared.set_received(0, sent)
    assert next(steps), "read items make room"


def test_a_publisher_ends_with_the_run() -> None:
    shared = progress()
    shared.stop_publishing()
    assert list(at_full_speed(shared, needs_of(64), NEVER)) == []
    assert list(at_rate(shared, 64, 30, NEVER)) == []


def test_a_publisher_with_a_rate_computes_the_wait_until_the_next_item() -> None:
    steps = at_rate(progress(), 64, 0.001, NEVER)
    before = time.monotonic_ns()
    first = next(steps)
    assert isinstance(first, list)
    assert len(first[0]) == 64
    assert before <= SENT.unpack_from(first[0])[0] <= time.monotonic_ns()
    wait = next(steps)
    assert isinstance(wait, float)
    assert 0 < wait <= 1000


def test_queues_have_room_for_more_than_the_messages_under_way() -> None:
    for size in (64, 18_000, 300_000):
        needs = needs_of(size)
        assert needs.items_max >= 2 * (window_items(size) + needs.batch_items)
