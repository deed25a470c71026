"""The order of the events of a channel that began anew after the loss of its host."""

from __future__ import annotations

from pathlib import Path

import pytest

from stampede_rt.files.chunk_content import Event
from stampede_rt.files.editing import cut
from stampede_rt.files.entries import FileAdvance, FileEntry, Topic, item_entry
from stampede_rt.files.merging import merge
from stampede_rt.files.sources import McapSource
from stampede_rt.values.recording import RecordingGap
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT
from tests.support.files.recordings import INCARNATION, MS, START, item, read, write

NEXT = 3  # less than the former incarnation: incarnations are random numbers
LOST = RecordingGap(channel="cam", incarnation=INCARNATION, reason="LOST", detail="the host was lost", first_seq=6)
BEGUN = RecordingGap(channel="cam", incarnation=NEXT, reason="COLLECTED", detail="", start=START)
SLOW = RecordingGap(channel="cam", incarnation=NEXT, reason="COLLECTED", detail="", first_seq=6, last_seq=7, items=2)


def items_of(incarnation: int, seqs: range, later: int = 0) -> list[FileEntry]:
    topic = Topic("cam", "", incarnation)
    return [item_entry(topic, item(seq, b"%d" % seq, time=START + (later + seq) * MS)) for seq in seqs]


EVENTS: list[Event] = [
    *items_of(INCARNATION, range(1, 6)), FileAdvance("cam", INCARNATION, START + 5 * MS, 5), LOST, BEGUN,
    *items_of(NEXT, range(1, 6), 100), SLOW, *items_of(NEXT, range(8, 12), 100),
]  # fmt: skip


@pytest.mark.parametrize("chunk_items", [1, 2, 3, 4, 7, 100])
def test_the_end_of_an_incarnation_comes_before_the_items_of_the_next_one(tmp_path: Path, chunk_items: int) -> None:
    path = write(tmp_path / "a.mcap", EVENTS, chunk_items=chunk_items)
    cut(path, tmp_path / "part.mcap", start=MIN_INSTANT, end=MAX_INSTANT)
    merge([path, path], tmp_path / "both.mcap")
    for copy in ("a.mcap", "part.mcap", "both.mcap"):
        assert read(tmp_path / copy)[0] == EVENTS, copy
    source = McapSource(path)
    found = [event for _, event in source.events(lambda _: True, MIN_INSTANT, MAX_INSTANT)]
    source.close()
    assert found == EVENTS
