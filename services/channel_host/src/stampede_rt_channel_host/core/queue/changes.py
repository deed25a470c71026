"""The changes that a call makes to a queue, so that copies of the queue can repeat them. Pure."""

from __future__ import annotations

from stampede_rt_channel_host.core.dedup import KeptRun
from stampede_rt_channel_host.core.queue.acknowledged_deliveries import AcknowledgedDelivery
from stampede_rt_channel_host.core.queue.items import QueuedRun, TrackedItem
from stampede_rt_channel_host.core.queue.message_ids import KnownMessage

WHOLE_LEASES_MAX = 32
"""If a message has more leases than this, copies get only its changes. Otherwise each change would send all its leases.
"""


class ItemChange:
    """The changes of one message.

    `acknowledged_before`: the number of its acknowledgements before the changes. `deliveries`: the ids of the
    deliveries whose leases have begun, changed or ended.
    """

    __slots__ = ("acknowledged_before", "deliveries")

    def __init__(self, acknowledged_before: int) -> None:
        self.acknowledged_before = acknowledged_before
        self.deliveries: dict[int, None] = {}


class QueueChanges:
    """The changes since the last `clear`. Times are instants of the host's clock.

    `runs`: the accepted runs. `items`: the tracked messages that have changed and that the queue still holds, by seq.
    `item_changes`: their changes; None for a message that is copied whole. `removed`: the seqs of the messages that
    have left. `acknowledged`, `producers` and `message_ids`: the new entries of the lists that the queue keeps to
    recognise repeated calls, in order.
    """

    __slots__ = ("acknowledged", "item_changes", "items", "message_ids", "producers", "removed", "runs")

    def __init__(self) -> None:
        self.clear()

    def clear(self) -> None:
        """Forget all changes."""
        self.runs: list[QueuedRun] = []
        self.items: dict[int, TrackedItem] = {}
        self.item_changes: dict[int, ItemChange | None] = {}
        self.removed: list[int] = []
        self.acknowledged: list[AcknowledgedDelivery] = []
        self.producers: list[KeptRun] = []
        self.message_ids: list[KnownMessage] = []

    def note(self, item: TrackedItem, delivery_id: int | None) -> None:
        """Note a change of a message, and the delivery whose lease has begun, changed or ended."""
        seq = item.seq
        if seq not in self.items:
            self.items[seq] = item
            is_whole = len(item.leases) <= WHOLE_LEASES_MAX
            self.item_changes[seq] = None if is_whole else ItemChange(len(item.acknowledged))
        change = self.item_changes[seq]
        if change is not None and delivery_id is not None:
            change.deliveries[delivery_id] = None

    def remove(self, seq: int) -> None:
        """Note that a message has left the queue."""
        self.items.pop(seq, None)
        self.item_changes.pop(seq, None)
        self.removed.append(seq)

    def __bool__(self) -> bool:
        lists = (self.runs, self.removed, self.acknowledged, self.producers, self.message_ids)
        return bool(self.items) or any(lists)
