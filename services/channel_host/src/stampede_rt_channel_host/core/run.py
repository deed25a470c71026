"""Runs of accepted items, the unit of the store, and the slices of them that readers are given. Pure.

A run is a producer's batch in columns: encoded once, never looked into again (paper, section 4.1). A run of one item is
laid out flat, since a channel may hold millions of them.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

ABSENT = -1
"""Stands for "no duration" in a column of durations."""

ITEM_OVERHEAD_BYTES = 64
"""What an item is charged against max_bytes beside its payload."""

_PACKED_ITEMS_MIN = 4  # below it a tuple is smaller than an array


class Run:
    """Accepted items in acceptance order; immutable. `first_seq` is the first item's seq, the others follow by one.

    `times` in nanoseconds since the epoch, in any order; `durations` in nanoseconds, -1 for none, or None if no item
    has one; `lengths` are payload bytes; `body` is what the shell's seal made of the items.
    """

    __slots__ = ("body", "first_seq")

    first_seq: int
    body: bytes

    @property
    def times(self) -> Sequence[int]:
        """Each item's time."""
        raise NotImplementedError

    @property
    def durations(self) -> Sequence[int] | None:
        """Each item's duration, -1 for none; None if no item has one."""
        raise NotImplementedError

    @property
    def lengths(self) -> Sequence[int]:
        """Each item's payload length."""
        raise NotImplementedError

    def __len__(self) -> int:
        return len(self.lengths)


class Slice(NamedTuple):
    """The items of a run from place `lo` up to, not including, `hi`; a value of its own, safe to keep and send later.

    In answers and deliveries the items of one slice ascend in (time, seq).
    """

    run: Run
    lo: int
    hi: int

    @property
    def is_whole(self) -> bool:
        """The run's body can be sent as it is."""
        return self.hi - self.lo == len(self.run)

    @property
    def first_seq(self) -> int:
        """The seq of the first item."""
        return self.run.first_seq + self.lo

    @property
    def items(self) -> int:
        """How many items it holds."""
        return self.hi - self.lo

    @property
    def payload_bytes(self) -> int:
        """The payload bytes of its items."""
        return sum(self.run.lengths[self.lo : self.hi])
