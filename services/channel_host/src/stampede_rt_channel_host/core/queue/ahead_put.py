"""A put of one message, which the owner of a queue sends to the replicas before the queue stores it. Pure."""

from __future__ import annotations

from typing import NamedTuple

from stampede_rt_channel_host.core.dedup import KeptRun
from stampede_rt_channel_host.core.queue.handoff import QueueHandoff
from stampede_rt_channel_host.core.queue.items import QueuedRun
from stampede_rt_channel_host.core.queue.queue_items import QueueTally
from stampede_rt_channel_host.core.run_outcome import RunOutcome, RunPart


class AheadPut(NamedTuple):
    """A step of a queue, with its number, that puts only one message. The producer has an id, and the message has none.

    `stamped_time`: the time that the owner gave the message, or None if the producer gave its time. `caller_name`: see
    `RetryWindow.record`. `body`: the stored run.
    """

    number: int
    seq: int
    producer_id: int
    first_number: int
    length: int
    stamped_time: int | None
    caller_name: str
    body: bytes

    def changes(self, tally: QueueTally, next_delivery_id: int) -> QueueHandoff:
        """The changes of the step. `tally` and `next_delivery_id` are those of the queue before the step."""
        outcome = RunOutcome(1, 1, (RunPart(0, self.seq, 1, self.stamped_time),), (), 0)
        return QueueHandoff(
            next_seq=self.seq + 1,
            next_delivery_id=next_delivery_id,
            tally=tally.after_put(self.length),
            runs=[QueuedRun(self.seq, (self.length,), 0, self.body)],
            held=(),
            items=[],
            acknowledged=[],
            producers=[KeptRun(self.producer_id, self.first_number, outcome, self.caller_name)],
            message_ids=[],
        )
