"""Items from datagrams and items from the host become one sequence of items."""

from __future__ import annotations

from dataclasses import dataclass

from stampede_rt.multicast.seq_merge import SeqMerge


@dataclass(frozen=True, slots=True)
class NumberedItem:
    seq: int


def items(first: int, end: int) -> list[NumberedItem]:
    return [NumberedItem(seq) for seq in range(first, end)]


def seqs(taken: list[NumberedItem]) -> list[int]:
    return [one.seq for one in taken]


def merge_from(next_seq: int) -> SeqMerge[NumberedItem]:
    merge = SeqMerge[NumberedItem](1, 100)
    merge.pass_to(next_seq)
    return merge


def test_items_from_datagrams_wait_for_missing_earlier_ones() -> None:
    merge = merge_from(3)
    assert merge.add(5, 7, items(5, 7), 10)
    assert (merge.take(), merge.missing_items, merge.is_missing, merge.is_contiguous) == ([], 2, True, False)
    assert merge.add(3, 5, items(3, 5), 10)
    assert merge.is_contiguous
    assert seqs(merge.take()) == [3, 4, 5, 6]
    assert (merge.next_seq, merge.held_bytes, merge.is_missing) == (7, 0, False)


def test_an_item_from_both_the_host_and_datagrams_is_given_once() -> None:
    merge = merge_from(1)
    merge.add(3, 6, items(3, 6), 10)
    assert seqs(merge.fill(items(1, 5))) == [1, 2, 3, 4]
    assert seqs(merge.take()) == [5]
    assert merge.taken == 1  # the other items came from the host
    assert not merge.add(3, 6, items(3, 6), 10)
    assert merge.fill(items(1, 6)) == []


def test_held_items_inside_a_gap_are_not_lost_with_it() -> None:
    """The host collected items that datagrams had brought before."""
    merge = merge_from(1)
    merge.add(3, 5, items(3, 5), 10)
    merge.add(7, 12, items(7, 12), 10)
    assert seqs(merge.take_up_to(9)) == [3, 4, 7, 8, 9, 10, 11]
    assert (merge.next_seq, merge.held_bytes, merge.taken) == (12, 0, 7)


def test_a_merge_beyond_its_bound_drops_the_latest_items_and_asks_for_them_later() -> None:
    merge = merge_from(1)
    for first in (2, 4, 3):
        merge.add(first, first + 1, items(first, first + 1), 40)
    assert merge.held_bytes == 80
    assert seqs(merge.fill(items(1, 2))) == [1]
    assert seqs(merge.take()) == [2, 3]
    assert (merge.missing_items, merge.announced_seq) == (1, 5)


def test_messages_before_the_readers_position_are_dropped() -> None:
    merge = merge_from(1)
    merge.add(2, 4, items(2, 4), 10)
    merge.add(5, 6, items(5, 6), 10)
    merge.pass_to(4)
    assert (merge.held_bytes, merge.is_contiguous) == (10, False)
    merge.announce(9)
    assert (merge.missing_items, merge.is_missing) == (1, True)
