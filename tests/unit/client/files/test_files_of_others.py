"""Files of other writers, and other readers of our files.

Two other writers: foxglove-sdk (in Rust) and rosbags. Two other readers: the reader of the mcap library, and the
reader of rosbags, which has its own code for MCAP. foxglove-sdk has no reader.
"""

from __future__ import annotations

from pathlib import Path

import pytest
from mcap.reader import make_reader
from rosbags.rosbag2 import StoragePlugin, storage_mcap

from stampede_rt.files.editing import cut, recover, verify
from stampede_rt.files.entries import FileEntry, item_entry
from tests.support.files.foreign_files import foxglove_file, rosbag
from tests.support.files.recordings import MS, START, entries, item, read, topic, write


@pytest.fixture(params=["foxglove", "rosbags"])
def foreign(request: pytest.FixtureRequest, tmp_path: Path) -> Path:
    if request.param == "foxglove":
        return foxglove_file(tmp_path / "foxglove.mcap")
    return next(rosbag(tmp_path / "bag", StoragePlugin.MCAP).glob("*.mcap"))


def test_a_file_of_another_writer_is_read_completely(foreign: Path) -> None:
    events, damages = read(foreign)
    assert not damages
    found = [event for event in events if isinstance(event, FileEntry)]
    assert [event.time for event in found] == [START + number * MS for number in range(100)]
    assert {(event.topic.name, event.topic.incarnation, event.seq) for event in found} <= {
        ("/pose", None, None),
        ("/chatter", None, None),
    }
    assert verify(foreign).intact


def test_a_file_of_another_writer_is_cut_with_its_schemas(foreign: Path, tmp_path: Path) -> None:
    before, _ = read(foreign)
    output = tmp_path / "cut.mcap"
    cut(foreign, output, start=START + 10 * MS, end=START + 20 * MS)
    after, _ = read(output)
    assert after == before[10:20]
    with output.open("rb") as file:
        assert len(list(make_reader(file, validate_crcs=True).iter_messages())) == 10


def test_a_torn_file_of_another_writer_is_recovered(foreign: Path, tmp_path: Path) -> None:
    content, output = foreign.read_bytes(), tmp_path / "saved.mcap"
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(content[: len(content) - 50])
    report = recover(torn, output)
    assert report.damages
    assert read(output)[0] == read(foreign)[0]


def test_the_reader_of_rosbags_reads_our_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    events = [*entries("cam", range(1, 101)), item_entry(topic("big"), item(1, b"y" * 3_000_000))]
    path = write(tmp_path / "a.mcap", events)
    read_string = storage_mcap.read_string
    # the reader of rosbags requires the profile "ros2" in the head of the file, and reads the rest as plain MCAP
    monkeypatch.setattr(storage_mcap, "read_string", lambda bio: read_string(bio) or "ros2")
    reader = storage_mcap.McapReader(path)
    reader.open()
    try:
        topics = {one.id: one.topic for one in reader.connections}
        found = [
            (topics[connection.id], time, data)
            for connection, time, data in reader.messages(reader.connections)
            if not connection.topic.startswith("stampede/")
        ]
    finally:
        reader.close()
    expected = sorted((event.topic.name, event.time, event.data) for event in events if isinstance(event, FileEntry))
    assert sorted(found) == expected
