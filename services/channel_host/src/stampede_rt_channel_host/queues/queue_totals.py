"""The sums of the counters of all queues of a host."""

from __future__ import annotations

from collections import Counter

from stampede_rt_channel_host.queues.hosted_queue import HostedQueue

GROWING = (
    "accepted", "accepted_bytes", "consumed", "dropped", "dead_lettered", "expelled", "delivered", "given_back",
    "leases_expired", "terminated", "duplicates", "rejected_full", "rejected_too_large", "rejected_malformed",
    "rejected_overloaded",
)  # fmt: skip
"""The counters that only grow, by their names in QueueCounters."""


def add_counts(counts: Counter[str], hosted: HostedQueue) -> None:
    """Add the counters of a queue that only grow."""
    counted = hosted.queue.latest_counters()
    for name in GROWING:
        counts[name] += getattr(counted, name)
