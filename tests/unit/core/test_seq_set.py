"""A set of seqs against a plain set."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from stampede_rt_channel_host.core.channel.seq_set import SeqSet

RANGES = st.lists(st.tuples(st.integers(1, 40), st.integers(0, 6)), max_size=25)


@given(RANGES)
def test_it_holds_what_was_put_in_and_says_what_was_new(ranges: list[tuple[int, int]]) -> None:
    seqs, plain = SeqSet(), set[int]()
    for first, items in ranges:
        news = set(range(first, first + items)) - plain
        assert seqs.add(first, first + items) == len(news)
        plain |= news
        assert seqs.size == len(plain)
        missing = [seq for seq in range(1, 60) if seq not in plain]
        assert seqs.below == missing[0]
        assert {seq for low, end in seqs.ranges for seq in range(low, end)} == {s for s in plain if s > seqs.below}
        assert all(seqs.end_of(seq) == min(one for one in missing if one >= seq) for seq in range(1, 50))


@given(RANGES)
def test_its_ranges_are_apart_so_that_in_order_there_is_none(ranges: list[tuple[int, int]]) -> None:
    seqs = SeqSet()
    for first, items in ranges:
        seqs.add(first, first + items)
    bounds = [seqs.below, *(bound for one in seqs.ranges for bound in one)]
    assert bounds == sorted(set(bounds))
    again = SeqSet(seqs.below, seqs.ranges)
    assert (again.size, again.ranges, seqs.copy().ranges) == (seqs.size, seqs.ranges, seqs.ranges)
    in_order = SeqSet()
    for seq in range(1, 100):
        in_order.add(seq, seq + 1)
    assert (in_order.below, in_order.ranges) == (100, [])
