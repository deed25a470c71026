"""Keeps the places of the blocks that reads have found, for later reads of all channels of a host."""

from __future__ import annotations

from collections import OrderedDict
from threading import Lock
from typing import NamedTuple

from stampede_rt_channel_host.core.archive import BLOCK_INDEX_BYTES, SegmentBlocks

KEPT_BYTES_MAX = 64 * 2**20
_ENTRY_BYTES = 1024  # the memory of a segment without blocks


class FoundBlocks(NamedTuple):
    """The blocks of a segment up to the offset `length`.

    `cut_at`: None, or the seq from which on the items are left out, because the next segment has them.
    """

    length: int
    blocks: SegmentBlocks
    cut_at: int | None = None

    def has_left_out(self, end_seq: int) -> bool:
        """Whether items below `end_seq` are left out."""
        return self.cut_at is not None and self.cut_at < end_seq


class KeptBlocks:
    """The blocks of the segments that reads used last, in at most `bytes_max`. Any threads may use it.

    A key is a channel's files and the number of a segment.
    """

    def __init__(self, bytes_max: int = KEPT_BYTES_MAX) -> None:
        self.bytes = 0
        self._bytes_max = bytes_max
        self._lock = Lock()
        self._kept: OrderedDict[tuple[object, int], FoundBlocks] = OrderedDict()

    def get(self, files: object, number: int) -> FoundBlocks:
        """The kept blocks of a segment; perhaps none."""
        with self._lock:
            found = self._kept.get((files, number))
            if found is None:
                return FoundBlocks(0, SegmentBlocks())
            self._kept.move_to_end((files, number))
            return found

    def keep(self, files: object, number: int, found: FoundBlocks) -> None:
        """Keep these blocks of a segment in place of its former blocks. Drops the least recently used segments."""
        with self._lock:
            before = self._kept.pop((files, number), None)
            self._kept[files, number] = found
            self.bytes += _bytes_of(found) - (0 if before is None else _bytes_of(before))
            while self.bytes > self._bytes_max:
                self.bytes -= _bytes_of(self._kept.popitem(last=False)[1])


def _bytes_of(found: FoundBlocks) -> int:
    return _ENTRY_BYTES + len(found.blocks) * BLOCK_INDEX_BYTES
