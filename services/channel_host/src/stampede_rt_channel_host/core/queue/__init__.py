"""The core of queues and mailboxes (paper, section 3.5). Pure."""

from stampede_rt_channel_host.core.queue.acknowledged_deliveries import AcknowledgedDelivery
from stampede_rt_channel_host.core.queue.ahead_put import AheadPut
from stampede_rt_channel_host.core.queue.dispatcher import BATCH_BYTES_MAX
from stampede_rt_channel_host.core.queue.enqueue import Enqueue
from stampede_rt_channel_host.core.queue.handoff import ItemState, LeaseState, QueueHandoff, SeqRange
from stampede_rt_channel_host.core.queue.items import GIVEN_BACK, LEASE_EXPIRED, TERMINATED, FailedDelivery, QueuedRun
from stampede_rt_channel_host.core.queue.journal import JOURNAL_BYTES_MAX, QueueJournal, QueueStep
from stampede_rt_channel_host.core.queue.limits import (
    BLOCK,
    DROP_OLDEST,
    ITEM_OVERHEAD_BYTES,
    LEASE_NANOS_MAX,
    REJECT,
    QueueLimits,
)
from stampede_rt_channel_host.core.queue.message_ids import KnownMessage
from stampede_rt_channel_host.core.queue.queue import QueueCore
from stampede_rt_channel_host.core.queue.queue_items import QueueTally
from stampede_rt_channel_host.core.queue.takers import TakerState
from stampede_rt_channel_host.core.queue.values import (
    Acknowledge,
    Batch,
    DeadLetter,
    Extend,
    GiveBack,
    LeasedSlice,
    PendingDelivery,
    QueueCounters,
    SealRun,
    Settlement,
    SettlementResult,
    Terminate,
)

__all__ = [
    "BATCH_BYTES_MAX",
    "BLOCK",
    "DROP_OLDEST",
    "GIVEN_BACK",
    "ITEM_OVERHEAD_BYTES",
    "JOURNAL_BYTES_MAX",
    "LEASE_EXPIRED",
    "LEASE_NANOS_MAX",
    "REJECT",
    "TERMINATED",
    "Acknowledge",
    "AcknowledgedDelivery",
    "AheadPut",
    "Batch",
    "DeadLetter",
    "Enqueue",
    "Extend",
    "FailedDelivery",
    "GiveBack",
    "ItemState",
    "KnownMessage",
    "LeaseState",
    "LeasedSlice",
    "PendingDelivery",
    "QueueCore",
    "QueueCounters",
    "QueueHandoff",
    "QueueJournal",
    "QueueLimits",
    "QueueStep",
    "QueueTally",
    "QueuedRun",
    "SealRun",
    "SeqRange",
    "Settlement",
    "SettlementResult",
    "TakerState",
    "Terminate",
]
