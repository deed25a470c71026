"""The counts of readers, and their refusals."""

from __future__ import annotations

import time
from multiprocessing import get_context

import pytest

from stampede_rt_bench.workloads.payloads import SENT
from stampede_rt_bench.workloads.receiving import AnswerReceiver, CountingReceiver, OperationTimer, TimingReceiver
from stampede_rt_bench.workloads.run_counters import RunCounters

NEVER = float("inf")


@pytest.fixture
def progress() -> RunCounters:
    return RunCounters(get_context("forkserver"), readers=1)


def test_a_reader_refuses_an_item_of_another_size(progress: RunCounters) -> None:
    receiver = CountingReceiver(progress, 0, 64, NEVER)
    receiver.take(1, 2, bytes(64))
    assert progress.received_by_all() == 1
    with pytest.raises(ValueError, match="63 bytes came instead of 64"):
        receiver.take(1, 2, bytes(63))


def test_the_way_of_an_item_counts_only_while_the_run_is_measured(progress: RunCounters) -> None:
    receiver = TimingReceiver(progress, 0, 64, NEVER)
    item = SENT.pack(time.monotonic_ns() - 5_000) + bytes(56)
    receiver.take(1, 2, item)
    progress.measure(True)
    receiver.take(1, 3, item)
    assert len(receiver.latencies_nanos) == 1
    assert receiver.latencies_nanos[0] >= 5_000


def test_an_operation_that_reads_too_few_items_is_refused(progress: RunCounters) -> None:
    answers = AnswerReceiver(progress, 0, 64, NEVER)
    turns = OperationTimer(progress, answers, items=2).repeat(2)
    next(turns)
    answers.take(1, 2, bytes(64))
    with pytest.raises(ValueError, match="1 items came in 1 gets of 2"):
        next(turns)


def test_operations_are_counted_and_end_with_the_run(progress: RunCounters) -> None:
    operations = OperationTimer(progress, AnswerReceiver(progress, 0, 64, NEVER), items=0)
    progress.measure(True)
    turns = operations.repeat(b"x")
    for _ in range(3):
        next(turns)
    progress.end()
    assert list(turns) == []
    assert len(operations.durations_nanos) == 3 == progress.received_by_all()
