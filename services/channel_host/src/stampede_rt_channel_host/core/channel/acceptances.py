"""The instants at which the owners of a recorded channel accepted its items. Pure.

The archive writes these instants beside the items. They move to another host together with the items.
"""

from __future__ import annotations

from array import array
from bisect import bisect_left, bisect_right
from itertools import islice
from typing import NamedTuple

from stampede_rt_channel_host.core.channel.holdings import Holdings

ROWS_PER_CHUNK = 512
CHUNKS_PER_LOOK = 2  # more than one, so that at most half of the rows belong to no held item
SLICES_PER_CHUNK = 4 * ROWS_PER_CHUNK  # a look at this many takes about 1 ms
ROW_BYTES, CHUNK_BYTES = 16, 256


class AcceptedRows(NamedTuple):
    """Rows of seqs and instants. An owner accepted the items from `ends[i - 1]` up to `ends[i]`, exclusive, at
    `instants[i]`. Both columns ascend.
    """

    ends: tuple[int, ...]
    instants: tuple[int, ...]


class AcceptedAdvance(NamedTuple):
    """The highest advance of a channel, and the instant of its acceptance."""

    accepted: int
    instant: int


class _Chunk:
    """Some rows, see `AcceptedRows`."""

    __slots__ = ("ends", "instants")

    def __init__(self) -> None:
        self.ends, self.instants = array("Q"), array("q")


class Acceptances:
    """The instants of the items that memory holds. A later seq never has an earlier instant.

    If the instant of an item is not known, the item has the instant of the next item whose instant is known.

    Takes 16 bytes for each held put, and at most twice as many after items have left memory.
    """

    __slots__ = ("_chunks", "_place", "_rows", "advance", "end_seq", "latest")

    def __init__(self) -> None:
        self.advance: AcceptedAdvance | None = None
        self.end_seq = 0
        """The seq after the last item with a known instant; 0: there is none."""
        self.latest: int | None = None
        """The latest instant."""
        self._chunks = [_Chunk()]  # only the last one may be empty
        self._rows = 0
        self._place = 0  # the chunk that `_thin` looks at next

    @property
    def footprint_bytes(self) -> int:
        """The memory of the instants."""
        return self._rows * ROW_BYTES + len(self._chunks) * CHUNK_BYTES

    def note(self, end_seq: int, instant: int, held: Holdings) -> None:
        """Note that all items below `end_seq` without a known instant were accepted at `instant`.

        `held`: the items that memory holds.
        """
        if end_seq <= self.end_seq:
            return
        chunk, is_later = self._chunks[-1], self.latest is None or instant > self.latest
        self.end_seq = end_seq
        if not is_later and chunk.ends:
            chunk.ends[-1] = end_seq
            return
        self.latest = instant if self.latest is None else max(self.latest, instant)
        chunk.ends.append(end_seq)
        chunk.instants.append(self.latest)
        self._rows += 1
        if len(chunk.ends) >= ROWS_PER_CHUNK:
            self._chunks.append(_Chunk())
            for _ in range(min(CHUNKS_PER_LOOK, len(self._chunks) - 1)):
                self._thin(held)

    def take(self, rows: AcceptedRows, now: int, held: Holdings) -> None:
        """Take over the rows of another host. The clock of that host may be ahead of this host's clock, which shows
        `now`. Instants after `now` therefore become `now`.
        """
        for end_seq, instant in zip(*rows, strict=True):
            self.note(end_seq, min(instant, now), held)

    def at(self, seq: int) -> int | None:
        """The instant at which the item `seq` was accepted; None: it is not known."""
        if seq >= self.end_seq:
            return None
        chunk = self._chunk_of(seq)
        return self.latest if chunk is None else chunk.instants[bisect_right(chunk.ends, seq)]

    def between(self, first_seq: int, end_seq: int) -> AcceptedRows:
        """The rows of the items with these seqs, the second one exclusive."""
        ends: list[int] = []
        instants: list[int] = []
        end_seq = min(end_seq, self.end_seq)
        while first_seq < end_seq and (chunk := self._chunk_of(first_seq)) is not None:
            begin = bisect_right(chunk.ends, first_seq)
            end = min(len(chunk.ends), bisect_left(chunk.ends, end_seq) + 1)
            ends += chunk.ends[begin:end]
            instants += chunk.instants[begin:end]
            first_seq = ends[-1]
        if ends:
            ends[-1] = min(ends[-1], end_seq)
        return AcceptedRows((*ends,), (*instants,))

    def _chunk_of(self, seq: int) -> _Chunk | None:
        """The chunk with the row of the item `seq`; None: the row was dropped, or there is none."""
        whole = len(self._chunks) if self._chunks[-1].ends else len(self._chunks) - 1
        at = bisect_right(self._chunks, seq, 0, whole, key=_end_of)
        return self._chunks[at] if at < whole else None

    def _thin(self, held: Holdings) -> None:
        """Drop the rows of items that memory no longer holds from the next full chunk."""
        at = self._place if self._place < len(self._chunks) - 1 else 0
        chunk, before = self._chunks[at], self._chunks[at - 1] if at else None
        kept = _held_rows(chunk, 0 if before is None else before.ends[-1], held)
        self._rows -= len(chunk.ends) - len(kept)
        self._place = at + 1
        ends, instants = (array(one.typecode, map(one.__getitem__, kept)) for one in (chunk.ends, chunk.instants))
        if before is not None and len(before.ends) + len(kept) <= ROWS_PER_CHUNK:
            before.ends += ends
            before.instants += instants
            ends = ends[:0]
        if ends:
            chunk.ends, chunk.instants = ends, instants
        else:
            del self._chunks[at]
            self._place = at


def _held_rows(chunk: _Chunk, first_seq: int, held: Holdings) -> list[int]:
    """The positions of the rows with held items in a chunk. The first row begins with `first_seq`."""
    kept: list[int] = []
    looked = 0
    for part in islice(held.slices_by_seq(first_seq, chunk.ends[-1]), SLICES_PER_CHUNK):
        looked += 1
        begin, last = bisect_right(chunk.ends, part.first_seq), bisect_left(chunk.ends, part.end_seq)
        kept += range(max(begin, kept[-1] + 1 if kept else 0), min(last, len(chunk.ends) - 1) + 1)
    return kept if looked < SLICES_PER_CHUNK else [*range(len(chunk.ends))]


def _end_of(chunk: _Chunk) -> int:
    return chunk.ends[-1]
