"""The blocks of a segment, found by time, by seq and by acceptance: as a look at all of them would find them."""

from __future__ import annotations

import random
from collections.abc import Sequence

import pytest

from stampede_rt_channel_host.core import archive
from stampede_rt_channel_host.core.archive import (
    ADVANCES,
    ITEMS,
    ArchivedAdvance,
    ArchivedRun,
    PlacedBlock,
    SegmentBlocks,
    TimeRange,
)
from stampede_rt_channel_host.core.channel import FIRST_KEY, Run, make_run
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY, SEQ_END


def drawn(seed: int, *, late: bool) -> list[PlacedBlock]:
    """Blocks of runs, with some gaps and advances. `late`: many items come late, or have equal times."""
    draw, blocks, seq, offset = random.Random(seed), [], 1, 0
    for number in range(draw.randrange(1, 40)):
        near = (0, 0)
        if draw.random() < 0.1:
            head, _ = archive.encode_gap(seq, seq + 3, near, number)
            seq += 3
        elif draw.random() < 0.1:
            head, _ = archive.encode_advances([ArchivedAdvance(number, number)], seq, near)
        else:
            times = [draw.randrange(60) if late else 10 * number + at for at in range(draw.randrange(1, 5))]
            head, _ = archive.encode_items([ArchivedRun(number, make_run(seq, times, None, [1] * len(times), b"x"))])
            seq += len(times)
        blocks.append(PlacedBlock(offset, head))
        offset += head.length
    return blocks


@pytest.mark.parametrize("late", [False, True])
@pytest.mark.parametrize("seed", range(25))
def test_the_index_finds_the_same_blocks_as_a_scan_of_all_blocks(seed: int, late: bool) -> None:
    blocks = drawn(seed, late=late)
    draw, count = random.Random(seed), random.Random(seed).randrange(len(blocks) + 1)
    grown = SegmentBlocks(blocks[:count]).followed_by(blocks[count:])
    for places, found in ((blocks, grown), (blocks[:count], grown.up_to(count))):
        assert [*found] == places
        assert [*found.advance_blocks] == [one for one in places if one.head.kind == ADVANCES]
        items = [one for one in places if one.head.kind == ITEMS]
        for _ in range(20):
            check_times(items, found, draw.randrange(-2, 62 if late else 400), draw.randrange(2))
            check_order(places, items, found, draw.randrange(-1, 120))
        check_times(items, found, FIRST_KEY[0], 0)
        check_times(items, found, LAST_KEY[0], 0)


def check_times(items: Sequence[PlacedBlock], found: SegmentBlocks, time: int, seq: int) -> None:
    key = (time, seq)
    by_low = sorted((one for one in items if one.head.high >= key), key=lambda one: one.head.low)
    assert [*found.up(key)] == by_low
    high = (time + 9, SEQ_END)
    between = [one for one in items if one.head.high >= key and one.head.low < high]
    assert [*found.down(key, high)] == sorted(between, key=lambda one: one.head.high, reverse=True)
    lows, highs = [one.head.low[0] for one in items], [one.head.high[0] for one in items]
    assert found.last_end_before(time) == max((one for one in highs if one < time), default=None)
    assert found.last_start_before(time) == max((one for one in lows if one < time), default=None)
    assert found.first_start_after(time) == min((one for one in lows if one > time), default=None)


def check_order(blocks: Sequence[PlacedBlock], items: Sequence[PlacedBlock], found: SegmentBlocks, at: int) -> None:
    assert [*found.from_seq(at)] == [one for one in items if one.head.end_seq > at]
    later = (place for place, one in enumerate(blocks) if one.head.kind == ITEMS and one.head.last_accepted > at)
    assert found.first_accepted_after(at) == next(later, None)
    for place, one in enumerate(items):
        assert found.position(one.offset) == place
        assert found.items_at(place) == one
    assert found.items_at(-1) == (items[-1] if items else None)
    assert found.items_at(len(items)) is None


def test_only_the_runs_that_a_read_needs_are_decoded() -> None:
    runs = [make_run(1 + 2 * at, [10 * at, 10 * at + 1], None, [1, 1], b"%d" % at) for at in range(100)]
    head, parts = archive.encode_items([ArchivedRun(1, run) for run in runs])
    decoded: list[int] = []

    def decode(body: bytes) -> Run:
        decoded.append(int(body))
        return runs[int(body)]

    content = b"".join(parts[1:])
    archive.decode_items(head, content, decode, TimeRange(start=500, end=515, overlap=0))
    assert decoded == [49, 50, 51, 52], "with the bucket before the range and the bucket after it"
    decoded.clear()
    archive.decode_items(head, content, decode, TimeRange(start=500, end=500, overlap=25))
    assert decoded == [48, 49, 50]
