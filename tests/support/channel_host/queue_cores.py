"""A queue's core, with takers that a test controls."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from stampede_rt_channel_host.core.queue import (
    Acknowledge,
    Enqueue,
    Extend,
    GiveBack,
    QueueCore,
    QueueLimits,
    Settlement,
    TakerState,
    Terminate,
)


class Core:
    """One queue and its clock, which the test sets with `now`."""

    def __init__(self, **limits: Any) -> None:
        self.queue = QueueCore(QueueLimits(**limits), incarnation=1, name="q")
        self.now = 1000

    def put(self, *lengths: int, **fields: Any) -> Enqueue:
        def seal(first_seq: int, positions: Sequence[int], stamped_time: int | None) -> bytes:
            return bytes(20 + sum(lengths[position] for position in positions))

        run = Enqueue(lengths, seal, **fields)
        self.queue.enqueue(run, self.now)
        return run

    def taker(self, taker_id: int = 1, credit: int = 0, lease_nanos: int | None = None) -> TakerState:
        taker = TakerState(taker_id, lease_nanos)
        self.queue.grant(taker, credit, self.now)
        return taker

    def dispatched(self) -> dict[int, list[int]]:
        """Return the seqs of all messages in new batches by taker id. They then count as sent."""
        found: dict[int, list[int]] = {}
        while batches := self.queue.take_batches():
            for taker, batch in batches:
                self.queue.sending(taker)
                found.setdefault(taker.taker_id, []).extend(
                    one.run.first_seq + position for one in batch.slices for position in range(one.lo, one.hi)
                )
                self.queue.note_sent(taker, self.now)
        return found

    def ack(self, taker_id: int, *delivery_ids: int) -> list[str]:
        return self._settle(taker_id, *(Settlement(one, Acknowledge()) for one in delivery_ids))

    def nack(self, taker_id: int, delivery_id: int, delay_nanos: int = 0) -> list[str]:
        return self._settle(taker_id, Settlement(delivery_id, GiveBack(delay_nanos)))

    def extend(self, taker_id: int, delivery_id: int, lease_nanos: int) -> list[str]:
        return self._settle(taker_id, Settlement(delivery_id, Extend(lease_nanos)))

    def term(self, taker_id: int, delivery_id: int, reason: str = "") -> list[str]:
        return self._settle(taker_id, Settlement(delivery_id, Terminate(reason)))

    def _settle(self, taker_id: int, *settlements: Settlement) -> list[str]:
        """Return the reason of each refusal; an empty text for a success."""
        results = self.queue.settle(taker_id, settlements, self.now)
        return [one.error.reason if one.error else "" for one in results]

    def counted(self, *names: str) -> tuple[int, ...]:
        counters = self.queue.counters(self.now)
        return tuple(getattr(counters, name) for name in names)
