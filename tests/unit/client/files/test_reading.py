"""The contents of a file, as our reader and other readers of MCAP see them."""

from __future__ import annotations

import json
import struct
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Channel, Chunk
from mcap.writer import CompressionType, Writer

from stampede_rt.errors import FileError
from stampede_rt.files import framing
from stampede_rt.files.entries import FACTS_TOPIC, FileAdvance, FileEntry, item_entry
from stampede_rt.files.reading import FileReader
from tests.support.files.recordings import INCARNATION, MS, START, entries, gap, item, read, seqs_of, topic, write

STRANGE = [
    item(1, b"", time=-5),
    item(2**32 + 5, b"\x00\xff", duration=0, k="v", ü="\x1b[31m"),
    item(2**32 + 6, b"{}", duration=33 * MS, content_type="application/json"),
    item(2**32 + 7, b"late", time=START - 10 * MS, duration=None, content_type="image/jpeg"),
    item(2**53 + 1, b"x" * 3_000_000, time=START + 99 * MS),
]


@pytest.mark.parametrize("compression", ["zstd", "lz4", "none"])
def test_a_read_item_has_all_fields_of_the_written_one(tmp_path: Path, compression: str) -> None:
    advance, missing = FileAdvance("cam", INCARNATION, START + 5, 2**32 + 5), gap("cam", 2, 2**32 + 4)
    events = [item_entry(topic(), STRANGE[0]), missing, *(item_entry(topic(), one) for one in STRANGE[1:3]), advance]
    events += [item_entry(topic(), one) for one in STRANGE[3:]]
    path = write(tmp_path / "a.mcap", events, chunk_items=100, compression=compression)
    found, damages = read(path)
    back = [event.to_item() for event in found if isinstance(event, FileEntry)]
    assert [one._replace(end=None) for one in back] == STRANGE
    assert not damages
    kinds = [event if not isinstance(event, FileEntry) else event.seq for event in found]
    assert kinds == [1, missing, 2**32 + 5, advance, 2**32 + 6, 2**32 + 7, 2**53 + 1]


def test_a_finished_file_has_an_index_and_its_summary(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [*entries("cam", range(1, 26)), gap("cam", 26, 30)])
    with FileReader(path) as reader:
        summary = reader.summary()
        assert reader.index is not None
        assert len(reader.index.chunks) == 3
    assert summary is not None
    (counts,) = summary.channels
    assert (counts.accepted, counts.recorded, counts.missing, counts.complete) == (30, 25, 5, False)
    assert counts.gaps == (gap("cam", 26, 30),)


def test_the_mcap_library_reads_times_payloads_and_topics(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [*entries("cam", range(1, 26)), *entries("imu", [7])])
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = [(message.log_time, message.data) for _, _, message in reader.iter_messages(topics=["cam"])]
        summary = reader.get_summary()
        some = reader.iter_messages(["cam"], starting_at=START + 5 * MS, ending_before=START + 7 * MS)
        middle = [message.data for _, _, message in some]
    assert found == [(START + seq * MS, b"x%d" % seq) for seq in range(1, 26)]
    assert middle == [b"x5", b"x6"]
    assert summary is not None
    assert {one.topic for one in summary.channels.values()} == {"cam", "imu", FACTS_TOPIC}


def test_a_file_of_another_writer_has_messages_without_facts(tmp_path: Path) -> None:
    path = tmp_path / "other.mcap"
    with path.open("wb") as file:
        writer = Writer(file, use_chunking=False)
        writer.start()
        schema = writer.register_schema("Pose", "jsonschema", b"{}")
        channel = writer.register_channel("/pose", "json", schema)
        for number in range(3):
            writer.add_message(channel, START + number, b'{"x":1}', START, number)
        writer.finish()
    events, damages = read(path)
    assert not damages
    assert [(e.time, e.seq, e.sequence, e.content_type) for e in events if isinstance(e, FileEntry)] == [
        (START + number, None, number, "application/json") for number in range(3)
    ]


def test_facts_that_another_program_has_moved_are_not_applied_to_other_items(tmp_path: Path) -> None:
    path = write(tmp_path / "a.mcap", [item_entry(topic(), item(seq, duration=seq)) for seq in range(1, 5)])
    moved = tmp_path / "moved.mcap"
    with path.open("rb") as file, moved.open("wb") as out:
        writer, numbers = Writer(out), {}
        writer.start()
        messages = list(make_reader(file).iter_messages(log_time_order=False))
        for _, channel, message in [messages[-1], *messages[1:-1]]:  # the first item is left out
            if channel.id not in numbers:
                numbers[channel.id] = writer.register_channel(
                    channel.topic, channel.message_encoding, 0, channel.metadata
                )
            writer.add_message(numbers[channel.id], message.log_time, message.data, 0, message.sequence)
        writer.finish()
    events, _ = read(moved)
    assert [(e.seq, e.duration) for e in events if isinstance(e, FileEntry)] == [(None, None)] * 3


@pytest.mark.parametrize("content", [b"\x89MCAP", b"#ROSBAG V2.0\n", b"not a file of ours" * 10])
def test_the_error_for_a_foreign_file_names_a_remedy(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "a.mcap"
    path.write_bytes(content)
    with pytest.raises(FileError, match=r"is no MCAP file.*stampede import"):
        FileReader(path)


def test_a_chunk_that_would_fill_the_memory_counts_as_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(framing, "RECORD_BYTES_MAX", 1_000_000)
    path = tmp_path / "bomb.mcap"
    with path.open("wb") as file:
        writer = Writer(file, chunk_size=2**40, compression=CompressionType.ZSTD)
        writer.start()
        channel = writer.register_channel("cam", "", 0)
        writer.add_message(channel, 1, bytes(5_000_000), 1)
        writer.finish()
    assert path.stat().st_size < 10_000
    _, damages = read(path)
    assert "5000" in damages[0].detail
    assert "at most 1000000" in damages[0].detail


@pytest.mark.parametrize("kind", ["zstd", "lz4"])
def test_a_chunk_is_not_unpacked_beyond_its_stated_length(tmp_path: Path, kind: str) -> None:
    content = write(tmp_path / "a.mcap", entries("cam", range(1, 500)), chunk_items=500, compression=kind).read_bytes()
    place = content.index(b"\x04\x00\x00\x00zstd" if kind == "zstd" else b"\x03\x00\x00\x00lz4") - 12
    stated_bytes = struct.unpack_from("<Q", content, place)[0]
    lying = tmp_path / "lying.mcap"
    lying.write_bytes(content[:place] + struct.pack("<Q", 100) + content[place + 8 :])
    _, damages = read(lying)
    assert stated_bytes > 100
    assert "it has 101 bytes in place of 100" in damages[0].detail


@pytest.mark.parametrize(
    "facts",
    [
        b"[" * 100_000,
        b"{}",
        b"\xff",
        json.dumps({"version": 9, "runs": [], "gaps": [], "advances": []}).encode(),
        json.dumps({"version": 1, "runs": [{"topic": "cam"}], "gaps": [], "advances": []}).encode(),
        json.dumps({"version": 1, "runs": [], "gaps": [7], "advances": []}).encode(),
        json.dumps({"version": 1, "runs": [], "gaps": [], "advances": [], "half of a pair": "\ud800"}).encode(),
        b'{"version": 1, "runs": [], "gaps": [], "advances": [], "half of a pair": "\xed\xa0\x80"}',
    ],
)
def test_hostile_facts_are_reported_as_damage(tmp_path: Path, facts: bytes) -> None:
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        channel = writer.register_channel(FACTS_TOPIC, "json", 0)
        writer.add_message(channel, 1, facts, 1)
        writer.finish()
    _, damages = read(path)
    assert damages


def test_a_run_that_claims_too_many_items_allocates_no_memory(tmp_path: Path) -> None:
    run = {"topic": "cam", "incarnation": "1", "first_seq": 1, "count": 10**18, "content_type": "", "attributes": {}}
    path = tmp_path / "a.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        cam = writer.register_channel("cam", "", 0, {"stampede.incarnation": "1"})
        channel = writer.register_channel(FACTS_TOPIC, "json", 0)
        facts = {"version": 1, "runs": [run], "gaps": [], "advances": []}
        writer.add_message(channel, 1, json.dumps(facts).encode(), 1)
        for number in (1, 2):
            writer.add_message(cam, number, b"", number, number)
        writer.finish()
    assert seqs_of(read(path)[0]) == [1, 2]


def test_a_record_is_not_read_beyond_the_end_of_its_file(tmp_path: Path) -> None:
    content = write(tmp_path / "a.mcap", entries("cam", range(1, 5))).read_bytes()
    path = tmp_path / "b.mcap"
    path.write_bytes(content[:8] + struct.pack("<BQ", 0x05, 2**62) + content[8:])
    events, damages = read(path)
    assert seqs_of(events) == [1, 2, 3, 4]
    assert damages[0].offset == 8


def test_the_classes_of_the_mcap_library_are_the_classes_that_this_code_expects() -> None:
    assert {"compression", "data", "uncompressed_crc", "uncompressed_size"} <= set(Chunk.__dataclass_fields__)
    assert {"id", "topic", "message_encoding", "metadata", "schema_id"} <= set(Channel.__dataclass_fields__)


def test_a_chunk_that_unpacks_to_very_many_records_is_damage(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = write(tmp_path / "a.mcap", [*entries("cam", range(1, 26)), *entries("imu", range(1, 400))], chunk_items=25)
    assert len(read(path)[0]) == 424
    monkeypatch.setattr(framing, "CHUNK_RECORDS_MAX", 10)
    found, damages = read(path)
    assert not found
    assert "it has more than 10 records, the most that are read" in str(damages[0])
