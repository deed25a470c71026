"""Runs of queued items, and what is known of an item once somebody was given it. Pure.

An item that nobody has been given yet costs nothing beside its run; a queue may hold a million of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from stampede_rt_channel_host.core.channel.run import Slicer


class QueuedRun:
    """Items that were accepted together; their seqs follow each other. `held`: how many have not left the queue.

    `body` is what the shell's seal made of them, `slicer` what it knows of that once it has cut a part of it; `lengths`
    are payload bytes; `accepted_at` is the host's clock.
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
        """The seq behind the last item."""
        return self.first_seq + len(self.lengths)

    @property
    def label_bytes(self) -> int:
        """The most bytes that a part of the run takes on the wire beside its payloads: columns, type, attributes."""
        return len(self.body) - sum(self.lengths)


LEASE_EXPIRED, GIVEN_BACK, TERMINATED = "lease_expired", "given_back", "terminated"
"""How a delivery can be in vain."""


class FailedDelivery(NamedTuple):
    """A delivery that ended without an acknowledgement: which of its copy it was, to whom, and how it ended."""

    number: int
    taker_id: int
    taker_name: str
    ended: str
    reason: str = ""


class TouchedItem:
    """An item that was given to a taker, or held back, at least once.

    `returned` has the number of deliveries of each copy that was given out and that nobody has, ascending. `leases`
    maps takers to delivery ids, `acknowledged` lists takers that are done. `due`: held back until then. `last`: its
    last delivery in vain.
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
        """The item's seq."""
        return self.run.first_seq + self.position

    @property
    def order(self) -> int:
        """Of two that are due together, the older first."""
        return self.seq

    @property
    def length(self) -> int:
        """Payload bytes."""
        return self.run.lengths[self.position]

    def free_copies(self, copies: int) -> int:
        """How many more takers may be given it."""
        return copies - len(self.leases) - len(self.acknowledged)

    def may_go_to(self, taker_id: int) -> bool:
        """The taker neither has it nor is done with it: copies go to distinct takers."""
        return taker_id not in self.leases and taker_id not in self.acknowledged
