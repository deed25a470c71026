"""Finds, a part at a time, the items that the shared archive lacks after a channel has moved here."""

from __future__ import annotations

from itertools import islice

from stampede_rt_channel_host.core.archive import Segment
from stampede_rt_channel_host.core.channel import ChannelCore

SLICES_PER_LOOK = 2048  # a look at this many takes about 1 ms


class MovedItems:
    """The items that came into memory with the move of a channel, and the last hole before or among them.

    Memory has lost the items of a hole. So the former owner has archived these items, and all items of lower seqs.
    """

    def __init__(self, channel: ChannelCore) -> None:
        self._channel = channel
        self._end = channel.next_seq
        self._looked_to = 0
        self.lacks_from = 0
        """The seq after the last hole, as far as the looks have come; 0 before the first look."""
        self.is_known = False
        """Whether the looks have come to the end."""

    def look(self) -> None:
        """Look at the next SLICES_PER_LOOK slices at most."""
        looked = 0
        for one in islice(self._channel.accepted_from(self._looked_to), SLICES_PER_LOOK):
            run = one.run  # the archive writes whole runs
            if run.first_seq > self._looked_to:
                self.lacks_from = min(run.first_seq, self._end)
            self._looked_to, looked = max(self._looked_to, run.first_seq + len(run)), looked + 1
        if looked < SLICES_PER_LOOK or self._looked_to >= self._end:
            self.is_known = True
            self._note_ends()

    def _note_ends(self) -> None:
        """Note a hole after the last item, and items that memory has lost since this object looked at them."""
        if self._looked_to < self._end:
            self.lacks_from = self._end
        first = next(self._channel.accepted_from(self.lacks_from), None)
        if first is not None:
            self.lacks_from = max(self.lacks_from, min(first.run.first_seq, self._end))


def lacks_from(channel: ChannelCore, segments: tuple[Segment, ...]) -> int:
    """The first seq that the archive lacks, by its segments: the seq after its last item, or without segments the first
    held seq. In a shared archive, `MovedItems` may then find a later one.
    """
    held = next(iter(channel.accepted_from(0)), None)
    first = channel.next_seq if held is None else held.first_seq
    return max((one.end_seq for one in segments), default=first)
