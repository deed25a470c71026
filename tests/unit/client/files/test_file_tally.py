"""Counts of the items of a file, with damage between the items of two owners of a channel."""

from __future__ import annotations

import pytest

from stampede_rt.files.entries import FileEntry, Topic
from stampede_rt.files.file_tally import FileTally
from stampede_rt.values.seq_starts import start_of

TOPIC = Topic("cam", "", 7)


def entry(seq: int) -> FileEntry:
    return FileEntry(TOPIC, 1, 1, 1, b"x", seq, 1, None, {}, "")


@pytest.mark.parametrize(("seq", "items"), [(8, 4), (start_of(2) + 3, None)])
def test_a_gap_of_damage_over_unused_seqs_has_an_unknown_number_of_items(seq: int, items: int | None) -> None:
    tally = FileTally()
    tally.add(entry(3))
    tally.damage()
    (gap,) = tally.add(entry(seq))
    assert (gap.first_seq, gap.last_seq, gap.items) == (4, seq - 1, items)
    (counts,) = tally.summary("file").channels
    assert (counts.recorded, counts.missing, counts.gap_count) == (2, items or 0, 1)
