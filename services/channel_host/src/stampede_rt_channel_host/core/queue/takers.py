"""A taker, as its queue sees it. Pure."""

from __future__ import annotations

from stampede_rt_channel_host.core.queue.values import Batch


class TakerState:
    """One stream of a taker. `credit` is the number of messages that the taker may still get.

    The taker waits for messages while it has credit and is neither busy nor silent. `lease_nanos` is the lease that it
    asks for, or None for the queue's own lease. `name` is for people. `unsent` is a batch for the taker that the host
    has not begun to send. `last_request_at` is the time of its last request. `is_silent`: it gets nothing before its
    next request.
    """

    __slots__ = ("credit", "is_busy", "is_silent", "last_request_at", "lease_nanos", "name", "taker_id", "unsent")

    def __init__(self, taker_id: int, lease_nanos: int | None = None, name: str = "") -> None:
        self.taker_id = taker_id
        self.lease_nanos = lease_nanos
        self.name = name
        self.credit = 0
        self.last_request_at = 0
        self.is_busy = False  # True from the moment at which the taker gets a batch until the host has sent the batch
        self.is_silent = False
        self.unsent: Batch | None = None
