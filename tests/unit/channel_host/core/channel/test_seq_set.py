"""A set of seqs against a plain set."""

from __future__ import annotations

from collections.abc import Iterator
from unittest import mock

from hypothesis import given
from hypothesis import strategies as st

from stampede_rt_channel_host.core.channel import seq_set
from stampede_rt_channel_host.core.channel.seq_set import CountedSeqs, SeqSet

RANGES = st.lists(st.tuples(st.integers(1, 40), st.integers(0, 6)), max_size=25)


@given(RANGES)
def test_a_set_holds_the_added_seqs_and_counts_the_new_ones(ranges: list[tuple[int, int]]) -> None:
    seqs, plain = SeqSet(), set[int]()
    for first, items in ranges:
        new_seqs = set(range(first, first + items)) - plain
        assert seqs.add(first, first + items) == len(new_seqs)
        plain |= new_seqs
        assert seqs.size == len(plain)
        missing = [seq for seq in range(1, 60) if seq not in plain]
        assert seqs.below == missing[0]
        assert {seq for low, end in seqs.ranges for seq in range(low, end)} == {s for s in plain if s > seqs.below}
        assert all(seqs.end_of(seq) == min(one for one in missing if one >= seq) for seq in range(1, 50))


@given(RANGES)
def test_ranges_never_touch_and_seqs_in_order_from_1_need_no_range(ranges: list[tuple[int, int]]) -> None:
    seqs = SeqSet()
    for first, items in ranges:
        seqs.add(first, first + items)
    bounds = [seqs.below, *(bound for one in seqs.ranges for bound in one)]
    assert bounds == sorted(set(bounds))
    restored = SeqSet(seqs.below, seqs.ranges)
    assert (restored.size, restored.ranges) == (seqs.size, seqs.ranges)
    in_order = SeqSet()
    for seq in range(1, 100):
        in_order.add(seq, seq + 1)
    assert (in_order.below, in_order.ranges) == (100, [])


@given(RANGES, st.integers(1, 80), st.integers(0, 80))
def test_counted_seqs_know_how_many_lie_between_two_others(ranges: list[tuple[int, int]], low: int, more: int) -> None:
    with mock.patch.object(seq_set, "BLOCK_SEQS", 8):
        counted, plain = CountedSeqs(), SeqSet()
        for first, items in ranges:
            assert counted.add(first, first + items) == plain.add(first, first + items)
            present = {seq for at, end in [(1, plain.below), *plain.ranges] for seq in range(at, end)}
            assert counted.count(low, low + more) == len(present & set(range(low, low + more)))


def test_counting_among_very_many_ranges_walks_a_block_at_each_end() -> None:
    counted = CountedSeqs()
    for seq in range(3, 200_001, 2):
        counted.add(seq, seq + 1)
    scanned: list[int] = []
    touching = CountedSeqs.touching

    def counting(self: CountedSeqs, first: int, end: int) -> Iterator[tuple[int, int]]:
        for one in touching(self, first, end):
            scanned.append(1)
            yield one

    with mock.patch.object(CountedSeqs, "touching", counting):
        assert counted.count(100, 200_000) == 99_950
    assert len(scanned) <= seq_set.BLOCK_SEQS
