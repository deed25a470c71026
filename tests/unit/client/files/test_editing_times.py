"""A recovered file says when its lost items were, and how many, also if several parts of the file are damaged."""

from __future__ import annotations

from pathlib import Path

import pytest

from stampede_rt.files.chunk_content import ChunkContent
from stampede_rt.files.editing import cut, recover, verify
from stampede_rt.files.entries import item_entry
from stampede_rt.files.reading import FileReader
from tests.support.files.recordings import MS, START, entries, gap, item, topic, write


def chunks_of(path: Path) -> list[tuple[int, int]]:
    with FileReader(path) as reader:
        return [(part.offset, part.end) for part in reader.contents() if isinstance(part, ChunkContent)]


def flipped(path: Path, *places: int) -> Path:
    content = bytearray(path.read_bytes())
    for place in places:
        content[place] ^= 4
    path.write_bytes(content)
    return path


def middle(chunk: tuple[int, int]) -> int:
    return sum(chunk) // 2


@pytest.mark.parametrize("finished", [True, False])
def test_a_gap_of_damage_has_the_times_of_its_chunk(tmp_path: Path, finished: bool) -> None:
    """The lost items have the times 4, 5 and -1. The first item after them came late."""
    times = [1, 2, 3, 4, 5, -1, 3, 7, 8, 9, 10, 11]
    events = [item_entry(topic(), item(seq, time=START + at * MS)) for seq, at in enumerate(times, 1)]
    path = write(tmp_path / "a.mcap", events, chunk_items=3, finish=finished)
    recover(flipped(path, middle(chunks_of(path)[1])), tmp_path / "saved.mcap")
    (counts,) = verify(tmp_path / "saved.mcap").summary.channels
    found = next(one for one in counts.gaps if one.last_seq == 6)
    assert (found.first_seq, found.start, found.end) == (4, START - MS, START + 5 * MS)
    for at, has_gap in ((-1, True), (4, True), (5, True), (8, False)):
        within = {"start": START + at * MS, "end": START + (at + 1) * MS}
        part = cut(tmp_path / "saved.mcap", tmp_path / "part.mcap", overwrite=True, **within)
        assert any(one.last_seq == 6 for counts in part.channels for one in counts.gaps) is has_gap


def test_seqs_that_the_recorder_named_as_missing_do_not_hide_items_that_damage_took(tmp_path: Path) -> None:
    """The second damaged chunk has a gap. An earlier version said that the first damaged chunk had 0 items."""
    events = [*entries("cam", range(1, 7)), gap("cam", 7, 10), *entries("cam", range(11, 17))]
    path = write(tmp_path / "a.mcap", events, chunk_items=3)
    chunks = chunks_of(path)
    recover(flipped(path, middle(chunks[0]), middle(chunks[2])), tmp_path / "saved.mcap")
    (counts,) = verify(tmp_path / "saved.mcap").summary.channels
    assert [(one.first_seq, one.last_seq, one.items) for one in counts.gaps] == [(1, 3, 3), (7, 12, 6)]


def test_a_gap_of_damage_does_not_hide_items_of_a_chunk_that_is_gone(tmp_path: Path) -> None:
    events = [*entries("cam", range(1, 13)), gap("cam", 13, 16), *entries("cam", range(17, 25))]
    path = write(tmp_path / "a.mcap", events, chunk_items=4)
    chunks, content = chunks_of(path), bytearray(path.read_bytes())
    content[middle(chunks[3])] ^= 4
    path.write_bytes(content[: chunks[1][0]] + content[chunks[1][1] :])
    assert recover(path, tmp_path / "saved.mcap").summary.damaged == (
        "4 items of channel cam are missing, which the summary of the file counts",
    )


def test_a_file_whose_index_and_summary_are_damaged_may_lack_items(tmp_path: Path) -> None:
    """Nothing shows that one of its chunks is gone."""
    path = write(tmp_path / "a.mcap", entries("cam", range(1, 13)), chunk_items=4)
    chunks, content = chunks_of(path), bytearray(path.read_bytes())
    at = content.index(b"stampede.summary")
    content[at : at + 16] = bytes(16)
    path.write_bytes(content[: chunks[1][0]] + content[chunks[1][1] :])
    summary = recover(path, tmp_path / "saved.mcap").summary
    assert summary.damaged == (
        f"the summary of the file {str(path)!r} cannot be read, so the file may lack items that no gap names",
    )
    assert not verify(tmp_path / "saved.mcap").complete
