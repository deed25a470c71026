"""The blocks of an archive: item runs as they were stored, after a head with their place and checksums. Pure.

A segment is a file of blocks, one after the other. A block is never changed. Each block has a checksum of its head, and
one of its content. So a flipped bit costs one block, and a reader finds the next block by its head.
"""

from __future__ import annotations

import struct
from collections.abc import Callable, Sequence
from typing import NamedTuple

from stampede_rt.values.seq_starts import given_between
from stampede_rt.values.timeline import MIN_INSTANT
from stampede_rt_channel_host.core.channel.acceptances import AcceptedRows
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, LAST_KEY, ItemKey
from stampede_rt_channel_host.core.channel.run import Body, ReferencedBody, Run, make_run

try:
    from isal.isal_zlib import crc32
except ImportError:  # isal has wheels for the usual processors only; both functions return the same checksums
    from zlib import crc32

MAGIC = b"SRTA"
ITEMS, GAP, OPENING, ADVANCES = 1, 2, 3, 4
"""The kinds of blocks: item runs; seqs whose items were never archived; the facts about a segment and its channel; the
advances of the channel."""

_SUM = struct.Struct("<4sI")  # the magic number, and the checksum of the rest of the head
_HEAD = struct.Struct("<IIIIIQQqQqQqq")
_ROW = struct.Struct("<qIqq")  # for each run: when it was accepted, the length of its body, its least and greatest time
_ADVANCE = struct.Struct("<qq")  # for each advance: when the host accepted it, and its instant
HEAD_BYTES, ROW_BYTES, ADVANCE_BYTES = _SUM.size + _HEAD.size, _ROW.size, _ADVANCE.size
PACKED_HEAD_BYTES = _HEAD.size
COUNT_MAX = 2**32 - 1  # the greatest number of items in a head

JOINED_BELOW_BYTES = 4096  # shorter bodies are joined, because each piece costs a checksum and a buffer


CutRun = Callable[[bytes, int, int], bytes]
"""Cuts some items out of a run's body: takes the body and two positions, the second exclusive. Returns the new body."""


class BlockHead(NamedTuple):
    """The facts about one block.

    `first_seq` up to `end_seq`, exclusive, are its seqs. `low` and `high` are the least and the greatest key (time,
    seq) of its items. Its items were accepted from `first_accepted` until `last_accepted`, by the host's clock. A gap
    has no keys: `low` and `high` repeat the keys of the block before it.
    """

    kind: int
    content_crc: int
    content_bytes: int
    runs: int
    items: int
    first_seq: int
    end_seq: int
    low: ItemKey
    high: ItemKey
    first_accepted: int
    last_accepted: int

    @property
    def length(self) -> int:
        """The bytes of the whole block."""
        return HEAD_BYTES + self.content_bytes


class TimeRange(NamedTuple):
    """The times of a read, from `start` to `end`. `overlap` is the overlap of the channel in nanoseconds."""

    start: int
    end: int
    overlap: int


class ArchivedRun(NamedTuple):
    """A run to archive, and the host's clock when its items were accepted.

    `rows`: the instants of the puts, if one run has the items of several puts; otherwise None. A host that moves a
    channel makes such runs, and so does a host that starts. `begin`: with `rows`, the first seq to archive.
    """

    accepted: int
    run: Run
    rows: AcceptedRows | None = None
    begin: int = 0

    def below(self, end_seq: int, cut: CutRun) -> ArchivedRun:
        """The run without its items from `end_seq` on. At least one item is below."""
        run, items = self.run, end_seq - self.run.first_seq
        if len(run) <= items:
            return self
        durations = None if run.durations is None else run.durations[:items]
        body = cut(bytes(run.body), 0, items)
        return self._replace(run=make_run(run.first_seq, run.times[:items], durations, run.lengths[:items], body))


def encode_items(runs: Sequence[ArchivedRun]) -> tuple[BlockHead, list[bytes]]:
    """A block of runs, in seq order: its head, and its parts, which the caller writes one after the other."""
    lows, highs = [lowest(one.run) for one in runs], [highest(one.run) for one in runs]
    rows = zip(runs, lows, highs, strict=True)
    table = b"".join(_ROW.pack(one.accepted, len(one.run.body), low[0], high[0]) for one, low, high in rows)
    parts = [table, *(piece for one in runs for piece in pieces_of(one.run.body))]
    head = BlockHead(
        kind=ITEMS,
        content_crc=_crc(parts),
        content_bytes=sum(map(len, parts)),
        runs=len(runs),
        items=sum(len(one.run) for one in runs),
        first_seq=runs[0].run.first_seq,
        end_seq=runs[-1].run.first_seq + len(runs[-1].run),
        low=min(lows),
        high=max(highs),
        first_accepted=min(one.accepted for one in runs),
        last_accepted=max(one.accepted for one in runs),
    )
    return head, [encode_head(head), *parts]


def pieces_of(body: Body) -> Sequence[bytes]:
    """The bytes of a body, in pieces. A long payload that a program of this process put is not copied."""
    is_long = isinstance(body, ReferencedBody) and len(body) >= JOINED_BELOW_BYTES
    return body.parts if isinstance(body, ReferencedBody) and is_long else (bytes(body),)


NO_KEY: ItemKey = (0, 0)
NOTHING_LOST = MIN_INSTANT
"""A gap without seqs, and with this acceptance instant, withdraws an earlier gap."""


def encode_gap(first_seq: int, end_seq: int, near: ItemKey, accepted: int) -> tuple[BlockHead, list[bytes]]:
    """A block that says that the items of these seqs were never archived. `near`: the key of the item before them."""
    items = min(given_between(first_seq, end_seq), COUNT_MAX)
    head = BlockHead(GAP, 0, 0, 0, items, first_seq, end_seq, near, near, accepted, accepted)
    return head, [encode_head(head)]


class ArchivedAdvance(NamedTuple):
    """The highest advance of a channel from an instant of the host's clock on."""

    accepted: int
    instant: int


def encode_advances(advances: Sequence[ArchivedAdvance], seq: int, near: ItemKey) -> tuple[BlockHead, list[bytes]]:
    """A block of advances, in the order of their acceptance. `seq`: the next item's. `near`: see `BlockHead`."""
    content = b"".join(_ADVANCE.pack(*one) for one in advances)
    first, last = advances[0].accepted, advances[-1].accepted
    head = BlockHead(ADVANCES, crc32(content), len(content), 0, 0, seq, seq, near, near, first, last)
    return head, [encode_head(head), content]


def decode_advances(content: bytes) -> list[ArchivedAdvance]:
    """The advances of a block whose content is whole."""
    return [ArchivedAdvance._make(one) for one in _ADVANCE.iter_unpack(content)]


def encode_opening(facts: bytes, first_seq: int, key: ItemKey = NO_KEY) -> list[bytes]:
    """The first block of a segment. `facts`: the shell's own facts, which the shell finds there again. `key`: the
    greatest key of the items before this segment; NO_KEY: it is not known.
    """
    head = BlockHead(OPENING, crc32(facts), len(facts), 0, 0, first_seq, first_seq, key, key, 0, 0)
    return [encode_head(head), facts]


def encode_head(head: BlockHead) -> bytes:
    """The bytes of a head, HEAD_BYTES long."""
    rest = pack_head(head)
    return _SUM.pack(MAGIC, crc32(rest)) + rest


def pack_head(head: BlockHead) -> bytes:
    """The facts of a head in PACKED_HEAD_BYTES, without a checksum."""
    *plain, low, high, first_accepted, last_accepted = head
    return _HEAD.pack(*plain, *low, *high, first_accepted, last_accepted)


def unpack_head(raw: bytes, at: int = 0) -> BlockHead:
    """The head that `pack_head` has packed, from position `at` on."""
    *plain, low_time, low_seq, high_time, high_seq, first_accepted, last_accepted = _HEAD.unpack_from(raw, at)
    return BlockHead._make((*plain, (low_time, low_seq), (high_time, high_seq), first_accepted, last_accepted))


def decode_head(raw: bytes) -> BlockHead | None:
    """The head at the beginning of these bytes, or None if they do not begin with a whole, undamaged head."""
    if len(raw) < HEAD_BYTES:
        return None
    magic, checksum = _SUM.unpack_from(raw)
    rest = raw[_SUM.size : HEAD_BYTES]
    if magic != MAGIC or crc32(rest) != checksum:
        return None
    return unpack_head(rest)


def is_whole(head: BlockHead, content: bytes | memoryview) -> bool:
    """Whether the content is undamaged: it has the checksum that the head states."""
    return len(content) == head.content_bytes and crc32(content) == head.content_crc


def decode_items(
    head: BlockHead, content: bytes, decode: Callable[[bytes], Run], within: TimeRange | None = None
) -> list[ArchivedRun]:
    """The runs below the head's `end_seq`. The content is whole. `decode` makes a run of its stored body.

    `within`: leaves out runs that a read of these times does not need.
    """
    at, runs = head.runs * _ROW.size, []
    rows = [row for row in _ROW.iter_unpack(content[:at]) if row[0] <= head.last_accepted]
    low, high = _needed(rows, within) if within is not None else (FIRST_KEY[0], LAST_KEY[0])
    for accepted, length, least, greatest in rows:
        begin, at = at, at + length
        if least > high or greatest < low:
            continue
        run = decode(content[begin:at])
        if run.first_seq >= head.end_seq:
            break
        runs.append(ArchivedRun(accepted, run))
    return runs


def _needed(rows: Sequence[tuple[int, int, int, int]], within: TimeRange) -> tuple[int, int]:
    """The times between which a read needs items: also the bucket before the range, and the bucket after it."""
    start, end = within.start, within.end
    before = (row[3] if row[3] < start else row[2] for row in rows if row[2] < start)
    after = (row[2] if row[2] > end else row[3] for row in rows if row[3] > end)
    low = min(max(before, default=start), start - within.overlap)
    return low, min(after, default=end)


def lowest(run: Run) -> ItemKey:
    """The least key of a run's items."""
    times = run.times
    time = min(times)
    return time, run.first_seq + times.index(time)


def highest(run: Run) -> ItemKey:
    """The greatest key of a run's items."""
    times = run.times
    time, at = max(times), len(times) - 1
    while times[at] != time:
        at -= 1
    return time, run.first_seq + at


def _crc(parts: Sequence[bytes]) -> int:
    checksum = 0
    for part in parts:
        checksum = crc32(part, checksum)
    return checksum
