"""The blocks of a segment after a crash and after damage."""

from __future__ import annotations

import random

from stampede_rt_channel_host.core import archive
from stampede_rt_channel_host.core.archive import ArchivedRun, SegmentScan
from stampede_rt_channel_host.core.channel import Run, make_run


def run_at(seq: int, items: int = 2) -> Run:
    times = [1000 + seq + at for at in range(items)]
    return make_run(seq, times, None, [7] * items, b"body of %d" % seq)


def decoded(body: bytes) -> Run:
    return run_at(int(body.rsplit(b" ", 1)[1]))


def segment_of(blocks: int) -> tuple[bytes, list[int]]:
    """The bytes of a segment of this number of blocks of two runs, and where each block ends."""
    raw, ends = b"".join(archive.encode_opening(b"facts", 1)), []
    for number in range(blocks):
        runs = [ArchivedRun(50 + number, run_at(1 + 4 * number)), ArchivedRun(60 + number, run_at(3 + 4 * number))]
        raw += b"".join(archive.encode_items(runs)[1])
        ends.append(len(raw))
    return raw, ends


def scanned(raw: bytes, *, check_contents: bool = False) -> SegmentScan:
    return archive.scan(lambda offset, length: raw[offset : offset + length], len(raw), check_contents=check_contents)


def test_a_scan_finds_all_blocks_and_their_runs() -> None:
    raw, ends = segment_of(3)
    found = scanned(raw, check_contents=True)
    assert [one.end for one in found.blocks[1:]] == ends
    assert not found.damaged
    head = found.blocks[2].head
    assert (head.first_seq, head.end_seq, head.items, head.low, head.high) == (5, 9, 4, (1005, 5), (1008, 8))
    content = raw[found.blocks[2].offset + archive.HEAD_BYTES : found.blocks[2].end]
    runs = archive.decode_items(head, content, decoded)
    assert [(one.accepted, one.run.first_seq, one.run.body) for one in runs] == [
        (51, 5, b"body of 5"),
        (61, 7, b"body of 7"),
    ]


def test_a_segment_cut_at_any_byte_keeps_all_blocks_before_the_cut() -> None:
    raw, ends = segment_of(3)
    for cut in range(len(raw)):
        found = scanned(raw[:cut], check_contents=True)
        whole = [end for end in ends if end <= cut]
        assert [one.end for one in found.blocks if one.head.kind == archive.ITEMS] == whole
        assert found.end <= cut
        assert not found.damaged


def test_a_flipped_bit_is_found_anywhere_and_loses_only_its_block() -> None:
    raw, ends = segment_of(3)
    for at in range(len(raw) - len(segment_of(0)[0])):
        place = at + len(segment_of(0)[0])
        bad = bytearray(raw)
        bad[place] ^= 1 << random.Random(at).randrange(8)
        found = scanned(bytes(bad), check_contents=True)
        struck = next(number for number, end in enumerate(ends) if place < end)
        whole = [
            one.end
            for one in found.blocks
            if one.head.kind == archive.ITEMS
            and archive.is_whole(one.head, bytes(bad[one.offset + archive.HEAD_BYTES : one.end]))
        ]
        assert whole == [end for number, end in enumerate(ends) if number != struck]
        assert bool(found.damaged) == (struck < 2)  # a damaged last block is cut off as a torn tail


def test_a_read_reports_a_gap_and_a_block_with_a_damaged_head_as_holes() -> None:
    gap = archive.encode_gap(5, 9, (1004, 4), 70)
    first, third = (archive.encode_items([ArchivedRun(50, run_at(seq, 4))]) for seq in (1, 9))
    raw = b"".join((*first[1], *gap[1], *third[1]))
    blocks = scanned(raw).blocks
    hole = archive.Hole(1005, 1008, 4)
    for present in (archive.SegmentBlocks(blocks), archive.SegmentBlocks([blocks[0], blocks[2]])):
        assert [*archive.holes(present, {blocks[0].offset})] == [*archive.holes(present, {blocks[2].offset})] == [hole]
        assert [*archive.holes(present, set())] == []
    short = archive.summary(0, len(raw), blocks)
    assert short is not None
    assert (short.items, short.first_seq, short.end_seq, short.low, short.high) == (8, 1, 13, (1001, 1), (1012, 12))


def test_a_segment_that_grew_block_by_block_has_the_summary_of_all_its_blocks() -> None:
    raw, _ = segment_of(3)
    blocks = scanned(raw).blocks
    grown = archive.Segment(0, blocks[0].end, 0, 1, 1, None, None, 0)
    for block in blocks[1:]:
        grown = archive.grown(grown, block.head)
    assert grown == archive.summary(0, len(raw), blocks)
