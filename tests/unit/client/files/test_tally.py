"""The counts of one channel in a recording, at the end of the recording."""

from __future__ import annotations

from stampede_rt.files.tally import ChannelTally
from stampede_rt.values.seq_starts import start_of
from tests.support.files.recordings import INCARNATION, item


def test_the_items_that_the_recording_has_not_read_at_its_end_are_missing() -> None:
    tally = ChannelTally("cam", INCARNATION, 4)
    tally.add([item(seq) for seq in range(1, 7)])
    (gap,) = tally.ends(9, 6)
    assert (gap.reason, gap.first_seq, gap.last_seq, gap.items) == ("NOT_READ", 7, 9, 3)


def test_seqs_that_an_owner_left_out_after_a_loss_are_not_missing() -> None:
    start = start_of(3)
    tally = ChannelTally("cam", INCARNATION, start)
    tally.add([item(seq) for seq in range(1, 7)])
    assert tally.ends(start - 1, 6) == []
    counts = tally.counts()
    assert (counts.accepted, counts.recorded, counts.missing) == (6, 6, 0)
    (gap,) = tally.ends(start + 1, 6)
    assert (gap.reason, gap.items) == ("NOT_READ", 2)
