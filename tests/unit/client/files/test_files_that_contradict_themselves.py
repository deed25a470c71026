"""A file whose chunks, index, checksums and counts do not agree may lack items: each command notices it."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from contextlib import closing
from pathlib import Path

import pytest
from mcap.writer import CompressionType, Writer

from stampede_rt.cli.main import main as stampede
from stampede_rt.errors import FileError
from stampede_rt.files.chunk_content import ChunkContent, Event
from stampede_rt.files.editing import cut, recover, verify
from stampede_rt.files.entries import item_entry
from stampede_rt.files.framing import RecordFile, RecordFrame
from stampede_rt.files.merging import merge
from stampede_rt.files.reading import FileReader
from stampede_rt.files.sources import McapSource
from tests.support.files.recordings import MS, START, entries, gap, item, read, seqs_of, topic, write

Change = Callable[[bytearray, Sequence[tuple[int, int]]], None]


def other_recording(path: Path) -> Path:
    """Write a file as another program writes it: chunks of the same length, without a checksum over all data."""
    with path.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.NONE)
        writer.start()
        topic = writer.register_channel("/pose", "json", 0)
        for number in range(8):
            writer.add_message(topic, START + number * MS, b'{"x":%d}' % number, START)
            if number % 2:
                writer.flush()  # type: ignore[no-untyped-call]
        writer.add_attachment(1, 2, "map", "image/png", b"a map of the site")
        writer.finish()  # type: ignore[no-untyped-call]
    return path


def recording(path: Path, events: Sequence[Event] = ()) -> Path:
    """Write a recording with chunks of the same length."""
    return write(path, events or entries("cam", range(1, 10)), chunk_items=3, compression="none")


def changed(path: Path, change: Change) -> Path:
    content = bytearray(path.read_bytes())
    with FileReader(path) as reader:
        chunks = [(one.offset, one.end) for one in reader.contents() if isinstance(one, ChunkContent)]
    change(content, chunks)
    path.write_bytes(content)
    return path


def records_of(path: Path) -> list[RecordFrame]:
    with RecordFile(path) as records:
        return [one for one in records.frames() if isinstance(one, RecordFrame)]


def swap(content: bytearray, chunks: Sequence[tuple[int, int]]) -> None:
    """Swap a chunk with the one before it, with the indexes between them."""
    (a, after_a), (b, after_b) = chunks[1:3]
    content[a:after_b] = content[b:after_b] + content[after_a:b] + content[a:after_a]


def replace_second(content: bytearray, chunks: Sequence[tuple[int, int]]) -> None:
    (a, after_a), (b, after_b) = chunks[1:3]
    content[a:after_a] = content[b:after_b]


def replace_without_index(content: bytearray, chunks: Sequence[tuple[int, int]]) -> None:
    """The footer says that the file has no index."""
    replace_second(content, chunks)
    content[-28:-8] = bytes(20)


def copies_refuse(path: Path, output: Path) -> None:
    for copied in (lambda: cut(path, output, start=0, end=2**62), lambda: merge([path], output)):
        with pytest.raises(FileError, match="`stampede file recover` saves"):
            copied()
        assert not output.exists()


@pytest.mark.parametrize("change", [swap, replace_second, replace_without_index])
@pytest.mark.parametrize("made", [recording, other_recording])
def test_a_file_with_the_wrong_chunks_is_recovered_with_a_warning_and_not_copied(
    tmp_path: Path, made: Callable[[Path], Path], change: Change, capsys: pytest.CaptureFixture[str]
) -> None:
    path, saved = changed(made(tmp_path / "a.mcap"), change), tmp_path / "saved.mcap"
    copies_refuse(path, saved)
    assert not verify(path).intact
    with pytest.raises(FileError), closing(McapSource(path)) as source:
        [*source.events(lambda _: True, 0, 2**62)]
    assert stampede(["file", "recover", str(path), "-o", str(saved)]) == 3
    assert "missing: " in capsys.readouterr().out
    assert not verify(saved).summary.complete


def test_all_items_of_swapped_chunks_are_recovered(tmp_path: Path) -> None:
    """The chunks have different lengths, so that one of them does not begin where the index says."""
    events = [*entries("cam", range(1, 4)), *entries("cam", range(4, 7), b"longer"), *entries("cam", range(7, 10))]
    path, saved = changed(recording(tmp_path / "a.mcap", events), swap), tmp_path / "saved.mcap"
    summary = recover(path, saved).summary
    assert set(seqs_of(read(saved)[0])) == {*range(1, 10)}
    assert (summary.recorded, summary.missing, summary.complete) == (9, 0, False)


def test_a_recovered_file_of_another_recording_says_that_its_index_was_lost(tmp_path: Path) -> None:
    path = other_recording(tmp_path / "a.mcap")
    chunks = [one for one in records_of(path) if one.opcode == 6]
    content = path.read_bytes()
    path.write_bytes(content[: chunks[1].offset] + content[chunks[1].end :])
    assert recover(path, tmp_path / "saved.mcap").summary.damaged == (
        f"the index of the file {str(path)!r} cannot be read, so the file may lack items that no gap names",
    )


def test_a_changed_attachment_is_not_copied(tmp_path: Path) -> None:
    path, saved = other_recording(tmp_path / "a.mcap"), tmp_path / "saved.mcap"
    path.write_bytes(path.read_bytes().replace(b"a map of", b"a mop of"))
    copies_refuse(path, saved)
    assert len(recover(path, saved).damages) == 1
    assert b"a mop of" not in saved.read_bytes()


@pytest.mark.parametrize("opcode", [0x80, 0x0F])
def test_the_lack_of_a_hidden_metadata_record_is_noticed(tmp_path: Path, opcode: int) -> None:
    """The opcode of the record names another kind of record, such as the end of the data."""
    path = tmp_path / "a.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        writer.add_message(writer.register_channel("/pose", "json", 0), START, b"{}", START)
        writer.flush()  # type: ignore[no-untyped-call]
        writer.add_metadata("robot", {"name": "crane"})
        writer.finish()  # type: ignore[no-untyped-call]
    (place,) = (one.offset for one in records_of(path) if one.opcode == 0x0C)
    content = bytearray(path.read_bytes())
    content[place] = opcode
    path.write_bytes(content)
    copies_refuse(path, tmp_path / "saved.mcap")
    assert not verify(path).intact
    assert not recover(path, tmp_path / "saved.mcap").summary.complete


def test_changed_metadata_of_a_recording_is_named(tmp_path: Path) -> None:
    """Only the checksum of all data covers metadata."""
    path, saved = recording(tmp_path / "a.mcap"), tmp_path / "saved.mcap"
    path.write_bytes(path.read_bytes().replace(b'"advance":null', b'"advance":1234'))
    copies_refuse(path, saved)
    assert not recover(path, saved).summary.complete


def test_the_gaps_of_a_lost_chunk_are_taken_from_the_summary(tmp_path: Path) -> None:
    """The chunk had nothing but gaps of its channel, so no later item shows that something is missing."""
    events = [*entries("cam", range(1, 4)), gap("imu", 1, 3), gap("imu", 7, 9), gap("cam", 4, 4)]
    path, saved = recording(tmp_path / "a.mcap", events), tmp_path / "saved.mcap"

    def flip(content: bytearray, chunks: Sequence[tuple[int, int]]) -> None:
        content[sum(chunks[1]) // 2] ^= 4

    recover(changed(path, flip), saved)
    found = {one.channel: [(gap.first_seq, gap.last_seq) for gap in one.gaps] for one in verify(saved).summary.channels}
    assert found == {"cam": [(4, 4)], "imu": [(1, 3), (7, 9)]}


@pytest.mark.parametrize("start", [0, START + MS])
def test_a_replay_notices_a_chunk_with_the_times_the_size_and_the_topics_of_another_one(
    tmp_path: Path, start: int
) -> None:
    """Only the checksum of all data tells these chunks apart. A replay from a later time also skips the first one."""
    former = [item_entry(topic(), item(seq, b"%d" % seq, time=START)) for seq in range(1, 4)]
    same = [item_entry(topic(), item(seq, b"%d" % seq, time=START + MS)) for seq in range(4, 10)]
    path = recording(tmp_path / "a.mcap", [*former, *same])
    for change, losses in ((lambda *_: None, 0), (replace_second, 1)):
        with closing(McapSource(changed(path, change))) as source:
            for _ in range(2):  # a loop compares the checksum once
                items = [event for _, event in source.events(lambda _: True, start, 2**62)]
            assert len(items) == (6 if start else 9)
            assert len(source.damaged) == losses
    assert "do not have the checksum that the file states" in source.damaged[0]
