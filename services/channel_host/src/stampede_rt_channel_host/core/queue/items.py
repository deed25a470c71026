"""Runs of queued messages, and the state of messages that were delivered at least once. Pure.

A message that was never delivered has no object of its own: it is a position in its run. A queue may hold a million
such messages.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from stampede_rt_channel_host.core.channel.run import Slicer


class QueuedRun:
    """Messages that were accepted together. Their seqs are consecutive. `held` of them have not left the queue.

    `body` holds the bytes that the `SealRun` returned. `slicer` cuts parts out of the body; it is None until a part is
    needed. `lengths` are in bytes of payload. `accepted_at` is the time of acceptance by the host's clock.
    """

    __slots__ = ("accepted_at", "body", "first_seq", "held", "lengths", "slicer")

    def __init__(self, first_seq: int, lengths: Sequence[int], accepted_at: int, body: bytes = b"") -> None:
        self.first_seq = first_seq
        self.lengths = lengths
        self.accepted_at = accepted_at
        self.held = len(lengths)
        self.body = body
        self.slicer: Slicer | None = None

    @property
    def end_seq(self) -> int:
        """The seq after the last message's seq."""
        return self.first_seq + len(self.lengths)

    @property
    def label_bytes(self) -> int:
        """The most bytes that a part of the run takes on the wire without its payloads: columns, type, attributes."""
        return len(self.body) - sum(self.lengths)


LEASE_EXPIRED, GIVEN_BACK, TERMINATED = "lease_expired", "given_back", "terminated"
"""The ways in which a delivery can fail."""


class FailedDelivery(NamedTuple):
    """A delivery that ended without an acknowledgement. `number` counts the deliveries of the message's copy, from 1.

    `ended` is one of LEASE_EXPIRED, GIVEN_BACK and TERMINATED.
    """

    number: int
    taker_id: int
    taker_name: str
    ended: str
    reason: str = ""


class TrackedItem:
    """A message that was delivered at least once.

    `returned` has a number for each copy that was delivered and has no taker now: the number of the copy's deliveries.
    The numbers ascend. `leases` maps the ids of takers to delivery ids. `acknowledged` has the ids of the takers that
    acknowledged a copy. `due` is the time until which the queue holds the message back, or None. `last` is its last
    failed delivery. `is_available`, `is_unleased`, `is_leaving` and `return_number` belong to `QueueItems`.
    """

    __slots__ = (
        "acknowledged", "due", "is_available", "is_leaving", "is_unleased", "last", "leases", "position",
        "return_number", "returned", "run",
    )  # fmt: skip

    def __init__(self, run: QueuedRun, position: int) -> None:
        self.run = run
        self.position = position
        self.returned: list[int] = []
        self.leases: dict[int, int] = {}
        self.acknowledged: tuple[int, ...] = ()
        self.due: int | None = None
        self.last: FailedDelivery | None = None
        self.return_number = 0
        self.is_available = self.is_unleased = self.is_leaving = False

    @property
    def seq(self) -> int:
        """The message's seq."""
        return self.run.first_seq + self.position

    @property
    def order(self) -> int:
        """The sort key of messages that are due at the same time: the older message comes first."""
        return self.seq

    @property
    def length(self) -> int:
        """The payload bytes."""
        return self.run.lengths[self.position]

    def free_copies(self, copies: int) -> int:
        """The number of takers that may still get the message."""
        return copies - len(self.leases) - len(self.acknowledged)

    def may_go_to(self, taker_id: int) -> bool:
        """Whether the taker may get the message: it has no copy now, and has not acknowledged one.

        Each copy of a message goes to another taker.
        """
        return taker_id not in self.leases and taker_id not in self.acknowledged
