"""The changes that a call makes to a queue, so that copies of the queue can repeat them. Pure."""

from __future__ import annotations

from stampede_rt_channel_host.core.dedup import KeptRun
from stampede_rt_channel_host.core.queue.acknowledged import Acknowledged
from stampede_rt_channel_host.core.queue.items import QueuedRun, TrackedItem
from stampede_rt_channel_host.core.queue.message_ids import KnownMessage


class QueueChanges:
    """The changes since the last `clear`. Times are instants of the host's clock.

    `runs`: the accepted runs. `items`: the tracked messages that have changed and that the queue still holds, by seq.
    `removed`: the seqs of the messages that have left. The other lists have what the queue has noted, in order.
    """

    __slots__ = ("acknowledged", "items", "message_ids", "producers", "removed", "runs")

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all changes."""
        self.runs: list[QueuedRun] = []
        self.items: dict[int, TrackedItem] = {}
        self.removed: list[int] = []
        self.acknowledged: list[Acknowledged] = []
        self.producers: list[KeptRun] = []
        self.message_ids: list[KnownMessage] = []

    def remove(self, seq: int) -> None:
        """Note that a message has left the queue."""
        self.items.pop(seq, None)
        self.removed.append(seq)

    def __bool__(self) -> bool:
        lists = (self.runs, self.removed, self.acknowledged, self.producers, self.message_ids)
        return bool(self.items) or any(lists)
