"""The core of queues and mailboxes (paper, section 3.5). Pure."""

from stampede_rt_channel_host.core.queue.dealing import BATCH_BYTES_MAX, Taker
from stampede_rt_channel_host.core.queue.enqueuing import Enqueue
from stampede_rt_channel_host.core.queue.handoff import ItemState, LeaseState, QueueState, SeqRange
from stampede_rt_channel_host.core.queue.items import QueuedRun
from stampede_rt_channel_host.core.queue.limits import (
    BLOCK,
    DROP_OLDEST,
    ITEM_OVERHEAD_BYTES,
    LEASE_NANOS_MAX,
    REJECT,
    QueueLimits,
)
from stampede_rt_channel_host.core.queue.queue import Queue
from stampede_rt_channel_host.core.queue.values import (
    Acknowledge,
    Batch,
    Departure,
    Extend,
    GiveBack,
    LeasedSlice,
    QueueCounters,
    Settlement,
    SettlementResult,
)

__all__ = [
    "BATCH_BYTES_MAX",
    "BLOCK",
    "DROP_OLDEST",
    "ITEM_OVERHEAD_BYTES",
    "LEASE_NANOS_MAX",
    "REJECT",
    "Acknowledge",
    "Batch",
    "Departure",
    "Enqueue",
    "Extend",
    "GiveBack",
    "ItemState",
    "LeaseState",
    "LeasedSlice",
    "Queue",
    "QueueCounters",
    "QueueLimits",
    "QueueState",
    "QueuedRun",
    "SeqRange",
    "Settlement",
    "SettlementResult",
    "Taker",
]
