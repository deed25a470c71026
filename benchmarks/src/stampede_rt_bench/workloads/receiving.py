"""Receivers: they read time, seq and payload of each item, count the items, and note how long each item took."""

from __future__ import annotations

import time
from array import array
from collections.abc import Iterator
from typing import TypeVar

from stampede_rt_bench.workloads.interface import Block
from stampede_rt_bench.workloads.payloads import SENT
from stampede_rt_bench.workloads.run_counters import RunCounters

LATENCIES_MAX = 1 << 20
T = TypeVar("T")


class CountingReceiver:
    """Counts items. It also reads each item and adds up the values, so that the reading is part of the measurement."""

    def __init__(self, progress: RunCounters, reader: int, item_bytes: int, deadline_s: float) -> None:
        self._progress, self._reader, self._item_bytes, self._deadline_s = progress, reader, item_bytes, deadline_s
        self.count = 0
        self.touched = 0

    def ready(self) -> None:
        """Note that the subscription is open."""
        self._progress.set_ready(self._reader)

    def take(self, time_nanos: int, seq: int, payload: bytes) -> None:
        """Take one item. Raises ValueError if it has another size than the sent items."""
        if len(payload) != self._item_bytes:
            raise ValueError(f"an item of {len(payload)} bytes came instead of {self._item_bytes}")
        self.touched += time_nanos + seq + payload[0] + payload[-1]
        self.count += 1
        self._progress.set_received(self._reader, self.count)

    def take_block(self, items: int, payload: Block) -> None:
        """Take `items` items in one payload."""
        self.touched += payload[0] + payload[-1]
        self.count += items
        self._progress.set_received(self._reader, self.count)

    def ended(self) -> bool:
        """Whether the run has ended."""
        return self._progress.has_ended(self._deadline_s)


class TimingReceiver(CountingReceiver):
    """Also notes how long each item was under way, for at most LATENCIES_MAX items."""

    def __init__(self, progress: RunCounters, reader: int, item_bytes: int, deadline_s: float) -> None:
        super().__init__(progress, reader, item_bytes, deadline_s)
        self.latencies_nanos = array("Q")

    def take(self, time_nanos: int, seq: int, payload: bytes) -> None:
        """Take one item. Its payload begins with the time at which it was sent."""
        now = time.monotonic_ns()
        super().take(time_nanos, seq, payload)
        if self._progress.measured() and len(self.latencies_nanos) < LATENCIES_MAX:
            self.latencies_nanos.append(now - SENT.unpack_from(payload)[0])

    def take_block(self, items: int, payload: Block) -> None:
        """Take one item in a measurement of the limits of the machine."""
        self.take(0, 0, bytes(payload))


class AnswerReceiver(CountingReceiver):
    """Takes the items that operations read. `OperationTimer` counts the operations."""

    def take(self, time_nanos: int, seq: int, payload: bytes) -> None:
        """Take one item of an answer."""
        self.touched += time_nanos + seq + payload[0] + payload[-1]
        self.count += 1

    def take_block(self, items: int, payload: Block) -> None:
        """Take all items of an answer in one payload."""
        self.touched += payload[0] + payload[-1]
        self.count += items

    def ended(self) -> bool:
        """Whether the run has ended."""
        return self._progress.has_stopped(self._deadline_s)


class OperationTimer:
    """Counts the repetitions of one operation, and notes their durations, at most LATENCIES_MAX."""

    def __init__(self, progress: RunCounters, answers: AnswerReceiver, items: int) -> None:
        self._progress, self._answers, self._items = progress, answers, items
        self.durations_nanos = array("Q")

    def repeat(self, value: T) -> Iterator[T]:
        """Yield `value` again and again, until the run has ended.

        An operation lasts until the client asks for the next value. Raises ValueError if an operation has not read
        `items` items.
        """
        count, durations, progress, answers = 0, self.durations_nanos, self._progress, self._answers
        while not answers.ended():
            begun_nanos = time.perf_counter_ns()
            yield value
            taken_nanos = time.perf_counter_ns() - begun_nanos
            count += 1
            if self._items and answers.count != count * self._items:
                raise ValueError(f"{answers.count} items came in {count} gets of {self._items}")
            if progress.measured() and len(durations) < LATENCIES_MAX:
                durations.append(taken_nanos)
            progress.set_received(0, count)
