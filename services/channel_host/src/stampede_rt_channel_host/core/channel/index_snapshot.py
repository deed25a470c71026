"""The items of a channel at one moment. A reader scans them in pieces while the channel changes. Pure."""

from __future__ import annotations

from bisect import bisect_left, bisect_right
from collections.abc import Iterator

from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, SEQ_END, ItemKey
from stampede_rt_channel_host.core.channel.run import Slice


class IndexSnapshot:
    """The items at or above `floor` with seqs below `end_seq`.

    The snapshot copies nothing. From `hold` to `close` the channel keeps the snapshot's entries in the index. `shows`
    decides by the seqs which items came later. A scan continues at a key, so the channel may add and split entries
    between two pieces.
    """

    __slots__ = (
        "_copies",
        "_copy_ends",
        "_end_seq",
        "_following",
        "_holders",
        "_index",
        "floor",
        "is_held",
        "kept_from",
    )

    def __init__(self, index: ChannelIndex, floor: ItemKey, end_seq: int, holders: dict[IndexSnapshot, None]) -> None:
        """`holders` are the channel's held snapshots. The channel does not free their items at or above `kept_from`."""
        self.floor = self.kept_from = floor
        # Copies of the items below `kept_from`, in ascending order. Each one ends at the key at the same position.
        self._copies: list[ChannelIndex] = []
        self._copy_ends: list[ItemKey] = []
        self.is_held = False
        self._index = index
        self._end_seq = end_seq
        self._following: int | None = None  # see `begin_with`
        self._holders = holders

    def hold(self) -> None:
        """Keep the entries in the index.

        Call it before the channel changes, if the scan continues afterwards. Idempotent.
        """
        if not self.is_held:
            self.is_held = True
            self._holders[self] = None

    def copy(self) -> IndexSnapshot:
        """Another snapshot of the same items, already held."""
        copy = IndexSnapshot(self._index, self.floor, self._end_seq, self._holders)
        copy.kept_from, copy._copies, copy._copy_ends = self.kept_from, [*self._copies], [*self._copy_ends]
        copy.hold()
        return copy

    def close(self) -> None:
        """Stop keeping the entries. Idempotent."""
        self._holders.pop(self, None)

    def detach(self, end: ItemKey) -> None:
        """Scan copies of the entries below `end` from now on, because the channel is about to free these entries.

        The channel keeps the entries from `end` on. Copies in one step the entries that no earlier call has copied.
        """
        if self.kept_from < end:
            self._copies.append(self._index.copy_of(self.kept_from, end))
            self._copy_ends.append(end)
            self.kept_from = end

    def begin_with(self, earlier: ChannelIndex, end: ItemKey, following: int | None) -> None:
        """Also show the items of `earlier`, which lie below `end`: below all items that the snapshot has shown so far.

        `following` is the time of a bucket that the snapshot does not show, or None. The caller keeps `earlier`
        unchanged.
        """
        self._following = following
        self._copies.insert(0, earlier)
        self._copy_ends.insert(0, end)
        self.floor = FIRST_KEY
        self.kept_from = max(self.kept_from, end)

    def shows(self, part: Slice) -> bool:
        """Whether the slice was in the channel at the moment of the snapshot."""
        return part.run.first_seq < self._end_seq

    def slices(self, low: ItemKey, high: ItemKey) -> Iterator[Slice]:
        """The items at or above `low` and below `high`, in ascending order.

        Returns also items that were accepted after the snapshot; use `shows` to leave them out. The channel must not
        change during the iteration.
        """
        low = max(low, self.floor)
        for at in range(bisect_right(self._copy_ends, low), len(self._copies)):
            yield from self._copies[at].slices(low, high)
        yield from self._index.slices(max(low, self.kept_from), high)

    def slices_down(self, low: ItemKey, high: ItemKey) -> Iterator[Slice]:
        """Like `slices`, but the last slice first."""
        low = max(low, self.floor)
        yield from self._index.slices_down(max(low, self.kept_from), high)
        for at in range(min(bisect_left(self._copy_ends, high), len(self._copies) - 1), -1, -1):
            if self._copy_ends[at] <= low:
                return
            yield from self._copies[at].slices_down(low, high)

    def next_time(self, time: int, high: ItemKey) -> int | None:
        """The time of the first bucket of the snapshot after `time` that begins below `high`, or None."""
        parts = self.slices((time, SEQ_END), high)
        shown = next((part.first_time for part in parts if self.shows(part)), None)
        if self._following is None or self._following <= time:
            return shown
        return self._following if shown is None else min(shown, self._following)
