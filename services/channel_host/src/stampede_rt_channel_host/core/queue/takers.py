"""One who takes from a queue, as the queue knows it. Pure."""

from __future__ import annotations

from stampede_rt_channel_host.core.queue.values import Batch


class TakerState:
    """One stream that takes. `credit` is what it may still be sent; it waits whenever that is left and it is not busy.

    `lease_nanos` None: the queue's. `name` is for people. `unsent` was dealt to it, and nobody has begun to send it.
    `heard_at`: when it last said something. `is_silent`: it is not dealt anything before it says something.
    """

    __slots__ = ("credit", "heard_at", "is_busy", "is_silent", "lease_nanos", "name", "taker_id", "unsent")

    def __init__(self, taker_id: int, lease_nanos: int | None = None, name: str = "") -> None:
        self.taker_id = taker_id
        self.lease_nanos = lease_nanos
        self.name = name
        self.credit = 0
        self.heard_at = 0
        self.is_busy = False  # from being dealt a batch until that is sent
        self.is_silent = False
        self.unsent: Batch | None = None
