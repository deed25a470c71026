"""Files of other programs of which a source must not leave out a part, and times that MCAP does not have."""

from __future__ import annotations

import sqlite3
from pathlib import Path

import pytest
from mcap.data_stream import RecordBuilder
from mcap.records import Message
from mcap.writer import IndexType, Writer
from rosbags.rosbag2 import StoragePlugin

from stampede_rt.errors import FileError
from stampede_rt.files.editing import cut
from stampede_rt.files.entries import FileEntry, item_entry
from stampede_rt.files.file_source import FileSource
from stampede_rt.files.foreign import source_of
from stampede_rt.files.merging import merge
from stampede_rt.files.sources import McapSource
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT
from tests.support.files.foreign_files import rosbag, xdf_file
from tests.support.files.recordings import MS, START, entries, item, topic, write


def items_of(source: FileSource) -> list[FileEntry]:
    events = [event for _, event in source.events(lambda _: True, MIN_INSTANT, MAX_INSTANT)]
    source.close()
    return [one for one in events if isinstance(one, FileEntry)]


def written(path: Path, times: list[int], loose: int | None = None, **settings: object) -> Path:
    """A file with a chunk for each message, and with a message after the first chunk that is in no chunk."""
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=1, **settings)  # type: ignore[arg-type]
        writer.start()
        number = writer.register_channel("pose", "json", 0)
        for place, time in enumerate(times):
            writer.add_message(number, time, b"{}", time)
            if loose is not None and not place:
                builder = RecordBuilder()
                Message(channel_id=number, sequence=0, log_time=loose, publish_time=loose, data=b"loose").write(builder)
                file.write(builder.end())
                counts = writer._Writer__statistics.channel_message_counts  # type: ignore[attr-defined]
                counts[number] += 1
        writer.finish()
    return path


def test_a_message_outside_of_chunks_is_not_left_out_in_silence(tmp_path: Path) -> None:
    path = written(tmp_path / "a.mcap", [START, START + 2 * MS], loose=START + MS)
    with pytest.raises(FileError, match="no index of all its messages; `stampede file merge`"):
        McapSource(path)
    merge([path], tmp_path / "b.mcap")
    assert [one.time for one in items_of(McapSource(tmp_path / "b.mcap"))] == [START, START + MS, START + 2 * MS]


@pytest.mark.parametrize(
    "settings", [{"index_types": IndexType.CHUNK}, {"index_types": IndexType.MESSAGE}, {"repeat_channels": False}]
)
def test_a_file_with_a_part_of_the_index_is_merged_before_it_is_played(
    tmp_path: Path, settings: dict[str, object]
) -> None:
    path = written(tmp_path / "a.mcap", [START, START + MS], **settings)
    with pytest.raises(FileError, match="`stampede file merge` writes a file with such an index"):
        McapSource(path)
    merge([path], tmp_path / "b.mcap")
    assert len(items_of(McapSource(tmp_path / "b.mcap"))) == 2


def test_a_message_with_a_later_time_than_a_channel_can_have_stays_in_a_file(tmp_path: Path) -> None:
    path, copy = written(tmp_path / "a.mcap", [START, 2**64 - 1]), tmp_path / "b.mcap"
    assert cut(path, copy, start=MIN_INSTANT, end=MAX_INSTANT).recorded == 2
    source = McapSource(copy)
    assert source.first_time("pose", START + 1, MAX_INSTANT) == 2**64 - 1
    assert [one.time for one in items_of(source)] == [START, 2**64 - 1]


@pytest.mark.parametrize("beside", [[], entries("imu", range(1, 4))])
def test_a_topic_has_the_times_of_its_items_also_before_1970(tmp_path: Path, beside: list[FileEntry]) -> None:
    """The index of MCAP has the time 0 for these items."""
    times = [-(10**18) + number * MS for number in range(30)]
    old = [item_entry(topic("old"), item(seq, time=time)) for seq, time in enumerate(times, 1)]
    source = McapSource(write(tmp_path / "a.mcap", [*old, *beside]))
    found = {one.name: (one.start, one.end) for one in source.topics(lambda name: name == "old")}
    source.close()
    assert found == {"old": (times[0], times[-1])}


def test_a_rosbag_says_that_it_has_fewer_messages_than_its_metadata(tmp_path: Path) -> None:
    folder = rosbag(tmp_path / "bag", StoragePlugin.SQLITE3)
    with sqlite3.connect(next(folder.glob("*.db3"))) as base:
        base.execute("DELETE FROM messages WHERE id % 10 = 0")
    base.close()
    source = source_of(folder)
    assert source.damaged == []
    assert len(items_of(source)) == 90
    assert source.damaged == ["10 of the 100 messages of topic '/chatter'"]


def test_the_journal_of_a_killed_recorder_is_not_left_out_in_silence(tmp_path: Path) -> None:
    folder = rosbag(tmp_path / "bag", StoragePlugin.SQLITE3)
    file = next(folder.glob("*.db3"))
    base = sqlite3.connect(file)
    base.execute("PRAGMA journal_mode=WAL")
    base.execute("DELETE FROM messages WHERE id = 1")
    base.commit()
    for path in (folder, file):
        with pytest.raises(FileError, match=r"has messages in 'bag.db3-wal'.*: sqlite3 bag.db3 'VACUUM'"):
            source_of(path)
    base.close()  # takes the journal over
    assert len(items_of(source_of(file))) == 99


def test_streams_of_xdf_with_confusing_names_are_all_there(tmp_path: Path) -> None:
    path = xdf_file(tmp_path / "a.xdf", [(1.0, (1.5,))], [(2.0, "blink")], ["EEG", "EEG"])
    assert [one.topic.name for one in items_of(source_of(path))] == ["EEG", "EEG-2"]
    path = xdf_file(tmp_path / "b.xdf", [(1.0, (1.5,))], [(2.0, "blink")], ["EEG-3", "EEG"], third_stream=(3.0, (7.5,)))
    assert [one.topic.name for one in items_of(source_of(path))] == ["EEG-3", "EEG", "EEG-3-3"]


def test_an_xdf_file_that_was_cut_off_between_two_chunks_says_so(tmp_path: Path) -> None:
    path = xdf_file(tmp_path / "a.xdf", [(1.0, (1.5,)), (2.0, (2.5,))], [(1.5, "blink")])
    assert source_of(path).damaged == []
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"<sample_count>") - len(b"<?xml version='1.0'?><info>") - 11])
    source = source_of(path)
    assert len(items_of(source)) == 3
    assert [text.split(":")[0] for text in source.damaged] == [
        f"perhaps the last samples of stream '{name}'" for name in ("EEG", "Marks")
    ]
    path.write_bytes(content.replace(b"<sample_count>2<", b"<sample_count>7<"))
    assert source_of(path).damaged == ["5 of the 7 samples of stream 'EEG'"]


@pytest.mark.parametrize("chunk_items", [1, 2, 5, 100])
@pytest.mark.parametrize("beside", [False, True])
def test_the_first_time_of_a_topic_is_that_of_its_latest_item_out_of_order(
    tmp_path: Path, chunk_items: int, beside: bool
) -> None:
    offsets = [50, 52, 10, 53, 90, 20, 91]
    events = [item_entry(topic(), item(seq, time=START + at * MS)) for seq, at in enumerate(offsets, 1)]
    other = entries("imu", range(1, 8))
    pairs = [one for pair in zip(other, events, strict=True) for one in pair]
    source = McapSource(write(tmp_path / "a.mcap", pairs if beside else events, chunk_items=chunk_items))
    for start, end in ((0, 100), (10, 11), (11, 90), (21, 100), (54, 90), (91, 92), (92, 200)):
        within = [START + at * MS for at in offsets if start <= at < end]
        found = source.first_time("cam", START + start * MS, START + end * MS)
        assert found == min(within, default=None), (start, end)
    source.close()
