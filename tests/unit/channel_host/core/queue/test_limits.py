"""The set-up of a queue, with its defaults."""

from __future__ import annotations

from stampede_rt.v1 import queue_pb2
from stampede_rt.wire.queues import queue_policy_from_spec
from stampede_rt_channel_host.core.queue import QueueLimits


def test_a_setting_that_was_never_stated_of_a_queue_has_its_default() -> None:
    limits = QueueLimits.of(queue_policy_from_spec(queue_pb2.QueueSpec()))
    assert (limits.max_items, limits.max_bytes, limits.copies) == (None, 256 * 2**20, 1)
    assert (limits.lease_nanos, limits.on_full, limits.max_deliveries) == (30 * 10**9, "block", None)
    spec = queue_pb2.QueueSpec(max_items=5, on_full=queue_pb2.QUEUE_ON_FULL_REJECT, dead_letter_queue_id=b"x" * 16)
    stated = QueueLimits.of(queue_policy_from_spec(spec))
    assert (stated.max_items, stated.on_full, stated.dead_letters) == (5, "reject", True)
