"""The sweep handles due queues a few at a time."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from stampede_rt_channel_host.core.deadlines import Deadlines
from stampede_rt_channel_host.queues.sweep import QUEUES_PER_STEP_MAX, sweep_queues

NOW = 1000


class BusyQueue:
    """A queue with much work that is due. Each tick does a piece of it."""

    due: int | None = None
    order = 1

    def __init__(self, deadlines: Deadlines[Any], pieces: int) -> None:
        self._deadlines = deadlines
        self.pieces = pieces
        deadlines.set_due(self, NOW)

    def tick(self) -> None:
        self.pieces -= 1
        if self.pieces:
            self._deadlines.set_due(self, NOW)


def test_a_step_does_a_few_pieces_of_the_work_of_a_queue() -> None:
    deadlines: Deadlines[Any] = Deadlines()
    store: Any = SimpleNamespace(deadlines=deadlines, now=lambda: NOW)
    queue = BusyQueue(deadlines, 2 * QUEUES_PER_STEP_MAX + 1)
    left = []
    while sweep_queues(store):
        left.append(queue.pieces)
    assert left == [QUEUES_PER_STEP_MAX + 1, 1, 0]
    assert QUEUES_PER_STEP_MAX <= 4, "a piece takes a millisecond"
