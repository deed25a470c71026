"""The items of a channel at one moment. A reader walks them in pieces while the channel goes on. Pure."""

from __future__ import annotations

from collections.abc import Iterator

from stampede_rt_channel_host.core.channel.index import SEQ_END, ChannelIndex, ItemKey
from stampede_rt_channel_host.core.channel.run import Slice


class ChannelSnapshot:
    """The items at or above `floor` with seqs below `end_seq`.

    Nothing is copied: from `hold` to `close` their entries stay in the index, and what came since is left out by its
    seq. Keys lead from piece to piece, so that entries may be added and split in between.
    """

    __slots__ = ("_end_seq", "_holders", "_index", "floor", "is_held")

    def __init__(self, index: ChannelIndex, floor: ItemKey, end_seq: int, holders: dict[ChannelSnapshot, None]) -> None:
        """`holders`: the snapshots whose items must not be freed."""
        self.floor = floor
        self.is_held = False
        self._index = index
        self._end_seq = end_seq
        self._holders = holders

    def hold(self) -> None:
        """Call it before the channel changes, if the walk goes on afterwards. Idempotent."""
        if not self.is_held:
            self.is_held = True
            self._holders[self] = None

    def copy(self) -> ChannelSnapshot:
        """Another one of the same items, held already."""
        copy = ChannelSnapshot(self._index, self.floor, self._end_seq, self._holders)
        copy.hold()
        return copy

    def close(self) -> None:
        """It is not walked any more. Idempotent."""
        self._holders.pop(self, None)

    def detach(self) -> None:
        """Copy the index, because the channel frees items of the snapshot. Takes a step for each entry."""
        self._index = self._index.copy_from(self.floor)

    def shows(self, part: Slice) -> bool:
        """The slice was there when the snapshot was taken."""
        return part.run.first_seq < self._end_seq

    def slices(self, low: ItemKey, high: ItemKey) -> Iterator[Slice]:
        """The items at or above `low` and below `high`, ascending, and others that came since, which it does not show.
        The channel must not change while this goes on."""
        return self._index.slices(max(low, self.floor), high)

    def slices_down(self, low: ItemKey, high: ItemKey) -> Iterator[Slice]:
        """The same, the last slice first."""
        return self._index.slices_down(max(low, self.floor), high)

    def next_time(self, time: int, high: ItemKey) -> int | None:
        """The time of the next later bucket below `high`."""
        parts = self.slices((time, SEQ_END), high)
        return next((part.first_time for part in parts if self.shows(part)), None)
