"""Finds the records of a file whose index is whole: a damaged head of a record hides no chunk."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Iterator, Mapping

from mcap.opcode import Opcode

from stampede_rt.files.framing import MAGIC, Damage, RecordFile, RecordFrame

_LAST_OPCODES = (Opcode.DATA_END, Opcode.FOOTER)


def indexed_frames(records: RecordFile, ends: Mapping[int, int]) -> Iterator[RecordFrame | Damage]:
    """Yield the records as `RecordFile.frames` does, but each chunk of the index as a chunk or as damage.

    `ends`: for the first byte of each chunk that the index names, the first byte after the chunk. No checksum covers
    the head of a record. A flipped bit in it may make a chunk look like another record, like a longer chunk, or like
    the end of the file. If a whole chunk is where the index names none, the chunks are not in their places: from there
    on this reads one record after the other, as without an index.
    """
    starts, offset = sorted(ends), len(MAGIC)
    while True:
        for frame in records.frames(offset):
            at = bisect_left(starts, frame.offset)
            start = starts[at] if at < len(starts) else None  # the start of the next chunk
            end = None if start is None or isinstance(frame, Damage) else _end_of_damage(frame, start, ends[start])
            if end is None:
                yield frame
                continue
            if records.is_chunk(frame.offset):
                yield from records.frames(frame.offset)
                return
            offset = min(end, records.size)
            yield Damage(frame.offset, offset, "this is not the record that the index names")
            break
        else:
            return


def has_records_beside(records: RecordFile, indexed: Iterable[tuple[int, int]], end: int) -> bool:
    """Whether there are messages or chunks before the byte `end` that the index does not name.

    `indexed`: for each chunk of the index its first byte, and the first byte after its indexes of messages. Reads only
    the heads of the records between the chunks.
    """
    offset = len(MAGIC)
    for start, following in [*sorted(indexed), (end, end)]:
        while offset < start and (frame := records.frame_at(offset)) is not None:
            if frame.opcode in (Opcode.MESSAGE, Opcode.CHUNK):
                return True
            offset = frame.end
        offset = following
    return False


def _end_of_damage(frame: RecordFrame, start: int, end: int) -> int | None:
    """Return where a damaged record ends; None if it is whole.

    `start`, `end`: the bounds of the next chunk of the index.
    """
    if frame.offset == start:
        whole = frame.opcode == Opcode.CHUNK and frame.end == end
        return None if whole else max(end, start + 1)
    return start if frame.end > start or frame.opcode in _LAST_OPCODES else None
