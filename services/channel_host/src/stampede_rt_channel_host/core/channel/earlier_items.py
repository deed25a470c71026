"""Reports to a channel's first consumers which items the channel had collected before it had consumers. Pure."""

from __future__ import annotations

from stampede_rt_channel_host.core.channel.consumption import Consumers
from stampede_rt_channel_host.core.channel.held_items import HeldItems

ENTRIES_PER_LOOK = 8
"""The most index entries or ranges of seqs that one step looks at."""


class EarlierItems:
    """The seqs below `end_seq`. `report_to` reports, in several calls, the seqs of collected items among them."""

    __slots__ = ("_end_seq", "_held", "_seq")

    def __init__(self, held: HeldItems, end_seq: int) -> None:
        self._held = held
        self._seq, self._end_seq = 1, end_seq

    def report_to(self, consumers: Consumers, steps: int) -> bool:
        """Report some collected seqs to the consumers, in `steps` steps at most. Returns True if more are left."""
        seq, end = self._seq, self._end_seq
        for _ in range(steps if seq < end else 0):
            first = self._held.seq_from(seq, end, ENTRIES_PER_LOOK)
            seq = consumers.note_some_collected(seq, first, ENTRIES_PER_LOOK)
            if seq == first:
                seq = self._held.held_up_to(first, end, ENTRIES_PER_LOOK)
            if seq >= end:
                break
        self._seq = seq
        return seq < end
