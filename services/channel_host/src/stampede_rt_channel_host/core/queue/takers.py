"""A taker, as its queue sees it. Pure."""

from __future__ import annotations

from stampede_rt_channel_host.core.queue.values import Batch


class TakerState:
    """One stream of a taker. `credit` is the number of messages it may still get.

    It waits for messages while it has credit and is neither busy nor silent. `lease_nanos` None: the queue's lease.
    `name` is for people. `unsent`: deliveries that were dealt to it and are not being sent yet. `heard_at`: the time of
    its last request. `is_silent`: it gets nothing before its next request.
    """

    __slots__ = ("credit", "heard_at", "is_busy", "is_silent", "lease_nanos", "name", "taker_id", "unsent")

    def __init__(self, taker_id: int, lease_nanos: int | None = None, name: str = "") -> None:
        self.taker_id = taker_id
        self.lease_nanos = lease_nanos
        self.name = name
        self.credit = 0
        self.heard_at = 0
        self.is_busy = False  # from the dealing of a batch until it is sent
        self.is_silent = False
        self.unsent: Batch | None = None
