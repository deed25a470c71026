"""Files as sources of a replay or an import: the order of their events, the times of their topics, their errors."""

from __future__ import annotations

from collections.abc import Sequence
from contextlib import closing
from pathlib import Path

import pytest
from rosbags.rosbag2 import StoragePlugin

from stampede_rt.errors import FileError
from stampede_rt.files import sources
from stampede_rt.files.chunk_content import ChunkContent
from stampede_rt.files.editing import cut
from stampede_rt.files.entries import FileAdvance, FileEntry, item_entry
from stampede_rt.files.foreign import source_of
from stampede_rt.files.reading import FileReader
from stampede_rt.files.sources import McapSource
from stampede_rt.values.recording import RecordingGap
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT
from tests.support.files.foreign_files import bag_of_topics, foxglove_file, rosbag, xdf_file
from tests.support.files.recordings import INCARNATION, MS, START, entries, gap, item, topic, write


def played(path: Path, start: int = MIN_INSTANT, end: int = MAX_INSTANT) -> list[object]:
    source = source_of(path)
    try:
        events = [event for _, event in source.events(lambda _: True, start, end)]
    finally:
        source.close()
    return [(one.topic.name, one.seq) if isinstance(one, FileEntry) else one for one in events]


def payloads_of(path: Path) -> list[bytes]:
    source = source_of(path)
    try:
        events = [event for _, event in source.events(lambda _: True, MIN_INSTANT, MAX_INSTANT)]
    finally:
        source.close()
    return [bytes(one.data) for one in events if isinstance(one, FileEntry)]


def test_channels_that_were_recorded_one_after_the_other_are_played_side_by_side(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [*entries("cam", range(1, 101)), *entries("imu", range(1, 101))])
    expected = [(name, seq) for seq in range(1, 101) for name in ("cam", "imu")]
    assert played(path) == expected
    assert played(path, START + 10 * MS, START + 12 * MS) == [("cam", 10), ("imu", 10), ("cam", 11), ("imu", 11)]


def test_a_late_item_keeps_its_place_behind_the_items_before_it(tmp_path: Path) -> None:
    events = [*entries("cam", range(1, 31)), item_entry(topic(), item(31, time=START)), *entries("cam", range(32, 40))]
    assert played(write(tmp_path / "a.mcap", events)) == [("cam", seq) for seq in range(1, 40)]


def test_gaps_and_advances_keep_their_positions_even_between_chunks_of_other_channels(tmp_path: Path) -> None:
    advance = FileAdvance("cam", INCARNATION, START + 11 * MS, 10)
    events = [*entries("cam", range(1, 11)), advance, *entries("imu", range(1, 10)), gap("cam", 11, 12)]
    events += [*entries("cam", range(13, 20)), FileAdvance("cam", INCARNATION, START + 90 * MS, 19)]
    found = played(write(tmp_path / "a.mcap", events, chunk_items=10))
    cam = [one for one in found if not (isinstance(one, tuple) and one[0] == "imu")]
    assert cam == [
        *(("cam", seq) for seq in range(1, 11)), advance, gap("cam", 11, 12), *(("cam", seq) for seq in range(13, 20)),
        events[-1],
    ]  # fmt: skip


@pytest.mark.parametrize("compression", ["none", "zstd", "lz4"])
def test_a_chunk_whose_bytes_are_zero_is_an_error_and_not_an_empty_chunk(tmp_path: Path, compression: str) -> None:
    path = write(tmp_path / "a.mcap", entries("cam", range(1, 31)), compression=compression)
    with FileReader(path) as reader:
        start = [part.offset for part in reader.contents() if isinstance(part, ChunkContent)][1]
    content = bytearray(path.read_bytes())
    content[start + 30 : start + 90] = bytes(60)  # also over its checksum, and over the name of its compression
    path.write_bytes(content)
    with pytest.raises(FileError, match=f"names a chunk at byte {start}, and there is none"):
        played(path)


GAPPED = [*entries("cam", range(1, 6)), gap("cam", 6, 8), *entries("cam", range(9, 20)), gap("cam", 20, 22)]
GAPPED += entries("cam", range(23, 30))


@pytest.mark.parametrize("chunk_items", [1, 3, 6, 10, 100])
@pytest.mark.parametrize(
    ("start", "end", "gaps"),
    [(9, 12, [6]), (10, 12, []), (1, 5, []), (1, 6, [6]), (6, 9, [6]), (21, 40, [20]), (24, 40, []), (5, 24, [6, 20])],
)
def test_an_interval_of_a_file_has_the_same_gaps_as_a_cut_of_the_file(
    tmp_path: Path, chunk_items: int, start: int, end: int, gaps: list[int]
) -> None:
    path = write(tmp_path / "a.mcap", GAPPED, chunk_items=chunk_items)
    within = {"start": START + start * MS, "end": START + end * MS}
    events = played(path, **within)
    items = [("cam", seq) for seq in (*range(1, 6), *range(9, 20), *range(23, 30)) if start <= seq < end]
    assert [one for one in events if isinstance(one, tuple) and not isinstance(one, FileAdvance)] == items
    assert [one.first_seq for one in events if isinstance(one, RecordingGap)] == gaps
    (counts,) = cut(path, tmp_path / "b.mcap", **within).channels
    assert [one.first_seq for one in counts.gaps] == gaps


def test_a_late_item_after_a_gap_does_not_hide_that_later_items_are_missing(tmp_path: Path) -> None:
    late = item_entry(topic(), item(9, time=START + 2 * MS))
    path = write(tmp_path / "a.mcap", [*entries("cam", range(1, 6)), gap("cam", 6, 8), late, *entries("cam", [10, 11])])
    for start, gaps in ((7, [6]), (2, [6]), (11, [])):
        within = {"start": START + start * MS, "end": START + 20 * MS}
        (counts,) = cut(path, tmp_path / "b.mcap", overwrite=True, **within).channels
        assert [one.first_seq for one in counts.gaps] == gaps
        assert [one.first_seq for one in played(path, **within) if isinstance(one, RecordingGap)] == gaps


def test_a_source_reports_the_same_gaps_when_it_is_read_again_also_of_channels_without_items(tmp_path: Path) -> None:
    early, other = gap("cam", 1, 4), gap("lost", 1, 9)
    path = write(tmp_path / "a.mcap", [*entries("imu", [1, 2]), early, other, *entries("cam", [5, 6])], chunk_items=4)
    source = McapSource(path)
    for _ in range(2):
        found = [event for _, event in source.events(lambda name: name != "imu", MIN_INSTANT, MAX_INSTANT)]
        assert [one.seq if isinstance(one, FileEntry) else one for one in found] == [early, 5, 6, other]
    source.close()


def test_few_chunks_are_in_memory_at_a_time(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sources, "CACHE_BYTES", 5_000)
    path = write(tmp_path / "a.mcap", [*entries("cam", range(1, 1001)), *entries("imu", range(1, 1001))])
    source, most = McapSource(path), 0
    for _ in source.events(lambda _: True, MIN_INSTANT, MAX_INSTANT):
        most = max(most, len(source._cache))
    source.close()
    assert most < 12


def test_a_topic_has_the_times_of_its_items_also_in_shared_chunks(tmp_path: Path) -> None:
    late = item_entry(topic(), item(4, time=START - MS))
    events = [*entries("old", [1]), *entries("cam", range(60, 63)), late, *entries("old", range(2, 200))]
    source = McapSource(write(tmp_path / "a.mcap", [*events, *entries("cam", range(63, 70))], chunk_items=100))
    found = {one.name: (one.start, one.end) for one in source.topics(lambda _: True)}
    source.close()
    assert found == {"old": (START + MS, START + 199 * MS), "cam": (START - MS, START + 69 * MS)}


def test_a_damaged_chunk_gives_its_topics_the_times_of_the_index(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [*entries("old", [1]), *entries("cam", range(60, 63))])
    with FileReader(path) as reader:
        assert reader.index is not None
        [chunk] = reader.index.chunks
    content = bytearray(path.read_bytes())
    content[chunk.chunk_start_offset + chunk.chunk_length // 2] ^= 1
    path.write_bytes(content)
    source = McapSource(path)
    assert {(one.start, one.end) for one in source.topics(lambda _: True)} == {(START + MS, START + 62 * MS)}
    source.close()


@pytest.mark.parametrize("finish", [True, False])
def test_the_error_says_why_a_file_cannot_be_played(tmp_path: Path, finish: bool) -> None:
    path = write(tmp_path / "a.mcap", [] if finish else entries("cam", [1]), finish=finish)
    with pytest.raises(FileError, match="it has no items" if finish else "its end is missing or damaged.* recover"):
        McapSource(path)


def test_a_file_of_foxglove_is_a_source(tmp_path: Path) -> None:
    assert played(foxglove_file(tmp_path / "a.mcap")) == [("/pose", None)] * 100


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_a_rosbag_is_a_source_by_its_folder_and_by_its_file(tmp_path: Path, plugin: StoragePlugin) -> None:
    folder = rosbag(tmp_path / "bag", plugin)
    source = source_of(folder)
    (found,) = source.topics(lambda _: True)
    events = [event for _, event in source.events(lambda _: True, START + 5 * MS, START + 7 * MS)]
    source.close()
    assert (found.name, found.start, found.end) == ("/chatter", START, START + 99 * MS)
    assert [(e.time, e.attributes, e.content_type) for e in events if isinstance(e, FileEntry)] == [
        (START + number * MS, {"schema": "std_msgs/msg/String"}, "application/x-ros-cdr") for number in (5, 6)
    ]
    assert len(played(next(one for one in folder.iterdir() if one.suffix in (".db3", ".mcap")))) == 100


@pytest.mark.parametrize("plugin", list(StoragePlugin))
def test_the_compressed_messages_of_a_rosbag_are_played_from_its_folder_and_refused_from_its_file(
    tmp_path: Path, plugin: StoragePlugin
) -> None:
    plain, packed = (rosbag(tmp_path / name, plugin, packed=name == "packed") for name in ("plain", "packed"))
    assert payloads_of(packed) == payloads_of(plain)
    with pytest.raises(FileError, match="compressed messages of a rosbag2; name the folder"):
        played(next(one for one in packed.iterdir() if one.suffix in (".db3", ".mcap")))
    source = source_of(next(one for one in packed.iterdir() if one.suffix in (".db3", ".mcap")))
    with closing(source), pytest.raises(FileError, match="name the folder of the bag"):
        source.first_time("/chatter", MIN_INSTANT, MAX_INSTANT)  # before a replay makes the channel


@pytest.mark.parametrize("plugin", list(StoragePlugin))
@pytest.mark.parametrize(
    ("chosen", "start", "end"),
    [
        (("/mid",), 7_200_000, 7_299_999),
        (("/once",), 9_000_000, 9_000_000),
        (("/mid", "/once"), 7_200_000, 9_000_000),
        (("/rare",), 5, 14_000_000),
        (("/mid", "/once", "/rare", "/long"), 0, 14_400_000),
    ],
)
def test_chosen_topics_of_a_rosbag_have_their_own_times(
    tmp_path: Path, plugin: StoragePlugin, chosen: tuple[str, ...], start: int, end: int
) -> None:
    """In an earlier version they had the times of the whole bag, so `--shift now` made an import hours too early."""
    times: dict[str, Sequence[int]] = {
        "/mid": [*range(7_200_000, 7_300_000, 333), 7_299_999], "/once": [9_000_000],
        "/rare": [5, 3_000_000, 14_000_000], "/long": range(0, 14_400_001, 60_000),
    }  # fmt: skip
    source = source_of(bag_of_topics(tmp_path / "bag", plugin, times))
    found = source.topics(lambda name: name in chosen)
    source.close()
    assert [one.name for one in found] == sorted(chosen)
    assert {(one.start, one.end) for one in found} == {(START + start * MS, START + end * MS)}


def test_xdf_samples_and_markers_are_a_source(tmp_path: Path) -> None:
    path = xdf_file(tmp_path / "a.xdf", [(1.0, (1.5, float("nan"))), (1.5, (2.0, 3.0))], [(1.25, "blink\x1b")])
    source = source_of(path)
    events = [event for _, event in source.events(lambda _: True, MIN_INSTANT, MAX_INSTANT)]
    source.close()
    assert [(e.topic.name, e.time, e.data, e.attributes) for e in events if isinstance(e, FileEntry)] == [
        ("EEG", 1_000_000_000, b"[1.5, null]", {"type": "eeg"}),
        ("Marks", 1_250_000_000, b'["blink\\u001b"]', {"type": "marks"}),
        ("EEG", 1_500_000_000, b"[2.0, 3.0]", {"type": "eeg"}),
    ]


@pytest.mark.parametrize("name", ["a.db3", "a.xdf", "bag"])
def test_a_damaged_foreign_file_is_an_error_that_names_it(tmp_path: Path, name: str) -> None:
    path = tmp_path / name
    if name == "bag":
        path.mkdir()
        (path / "metadata.yaml").write_text("rosbag2_bagfile_information: {version: x")
    else:
        path.write_bytes({"a.db3": b"SQLite format 3\x00", "a.xdf": b"XDF:"}[name] + b"\xff" * 500)
    with pytest.raises(FileError, match=name):
        source_of(path)


def test_an_error_about_a_foreign_file_or_folder_is_a_sentence_and_names_no_class(tmp_path: Path) -> None:
    (tmp_path / "a.db3").write_bytes(b"SQLite format 3\x00")
    with pytest.raises(FileError, match="it may be damaged: Cannot open database") as caught:
        source_of(tmp_path / "a.db3")
    assert "Error" not in str(caught.value)
    with pytest.raises(FileError, match="is a folder, and no rosbag2: it has no"):
        source_of(tmp_path)


def test_a_file_of_an_unknown_format_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "a.bin"
    path.write_bytes(b"hello")
    with pytest.raises(FileError, match="neither MCAP, nor rosbag2, nor XDF"):
        source_of(path)
