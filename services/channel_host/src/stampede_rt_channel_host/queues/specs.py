"""A queue's set-up as the directory tells it, in the core's terms."""

from __future__ import annotations

from typing import Any

from stampede_rt.v1 import queue_pb2
from stampede_rt_channel_host.core.queue import BLOCK, DROP_OLDEST, REJECT, QueueLimits

_ON_FULL = {
    queue_pb2.QUEUE_ON_FULL_UNSPECIFIED: BLOCK,
    queue_pb2.QUEUE_ON_FULL_BLOCK: BLOCK,
    queue_pb2.QUEUE_ON_FULL_REJECT: REJECT,
    queue_pb2.QUEUE_ON_FULL_DROP_OLDEST: DROP_OLDEST,
}
_NUMBERS = ("max_items", "max_bytes", "max_item_bytes", "copies", "lease_nanos", "max_deliveries")


def limits_of(record: queue_pb2.QueueRecord) -> QueueLimits:
    """The limits of a queue; what was never stated has its default. Raises InvalidArgument."""
    spec = record.spec
    stated: dict[str, Any] = {name: getattr(spec, name) for name in _NUMBERS if spec.HasField(name)}
    return QueueLimits(
        on_full=_ON_FULL.get(spec.on_full, BLOCK), dead_letters=spec.HasField("dead_letter_queue_id"), **stated
    )
