"""Commands about queues, and their results (paper, section 3.5). Pure, immutable values; see `core.commands`."""

from __future__ import annotations

from dataclasses import dataclass, field

from stampede_rt_supernode.core.commands import Creation, Operation, Success
from stampede_rt_supernode.core.records import HostRecord, QueueRecord, QueueSpec


@dataclass(frozen=True, kw_only=True, slots=True)
class OpenQueue(Creation):
    """Get or create a queue. `host_name`: the host that shall own it; empty if the caller does not care.

    A new queue gets `new_queue_id` and `new_incarnation`. If the owner of an existing queue is not alive, the queue
    gets a new owner and `new_incarnation`.
    """

    name: str
    spec: QueueSpec = field(default_factory=QueueSpec)
    create: bool = True
    host_name: str = ""
    new_queue_id: bytes
    new_incarnation: int


@dataclass(frozen=True, kw_only=True, slots=True)
class UpdateQueue(Operation):
    """Change the stated fields of a queue's policy. `epoch`: the present epoch, as the caller knows it."""

    queue_id: bytes
    epoch: int
    spec: QueueSpec


@dataclass(frozen=True, kw_only=True, slots=True)
class DeleteQueue(Operation):
    """Delete a queue."""

    queue_id: bytes


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueOpened(Success):
    """The queue and its owner. `created`: this command created it."""

    queue: QueueRecord
    host: HostRecord
    created: bool


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueUpdated(Success):
    """The queue after the change."""

    queue: QueueRecord


@dataclass(frozen=True, kw_only=True, slots=True)
class QueueDeleted(Success):
    """The queue as it was before its deletion."""

    queue: QueueRecord
