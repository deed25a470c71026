"""A cut or a merge keeps metadata, attachments, advances and gaps, too, each of them once."""

from __future__ import annotations

from dataclasses import replace
from itertools import permutations
from pathlib import Path

import pytest
from mcap.reader import make_reader
from mcap.records import Message
from mcap.writer import Writer

from stampede_rt.cli.main import main as stampede
from stampede_rt.errors import FileError
from stampede_rt.files.editing import cut, finish_with, recover, verify
from stampede_rt.files.entries import FileAdvance, FileEntry, Topic, item_entry
from stampede_rt.files.file_tally import FileTally
from stampede_rt.files.merging import merge
from stampede_rt.files.sources import McapSource
from stampede_rt.files.writing import FileWriter
from stampede_rt.values.recording import RecordingGap
from stampede_rt.values.timeline import MAX_INSTANT, MIN_INSTANT
from tests.support.files.recordings import INCARNATION, MS, START, entries, gap, item, read, write

ABSENT = "channel 'lidar': its host did not answer in time"
OPEN_GAP = RecordingGap(channel="cam", incarnation=INCARNATION, reason="LOST", detail="the host was lost", first_seq=31)
ADVANCES = [FileAdvance("cam", INCARNATION, START + seq * MS, seq) for seq in (10, 20)]


def with_records(path: Path, number: int = 0) -> Path:
    """A file with metadata, an attachment, and a channel that could not be recorded."""
    writer, tally = FileWriter(path), FileTally()
    writer.add_metadata("stampede.clocks", {"moment": f"begin {number}"})
    for entry in entries("cam", range(1, 4)):
        writer.add([entry])
        tally.add(entry)
    writer.add_attachment(START, START, "calibration.yaml", "text/yaml", b"k: 1")
    finish_with(writer, replace(tally.summary(str(path)), absent=(ABSENT,)))
    return path


def records_of(path: Path) -> tuple[list[str], list[tuple[str, bytes]]]:
    with path.open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        found = [one.metadata["moment"] for one in reader.iter_metadata() if one.name == "stampede.clocks"]
        return found, [(one.name, one.data) for one in reader.iter_attachments()]


def test_a_cut_and_a_merge_keep_each_metadata_record_and_attachment_once(tmp_path: Path) -> None:
    first, second = with_records(tmp_path / "1.mcap"), with_records(tmp_path / "2.mcap", 2)
    output = tmp_path / "out.mcap"
    cut(first, output, start=START, end=START + MS)
    assert records_of(output) == (["begin 0"], [("calibration.yaml", b"k: 1")])
    merge([first, output, second], output.with_name("all.mcap"))
    assert records_of(output.with_name("all.mcap")) == (["begin 0", "begin 2"], [("calibration.yaml", b"k: 1")])


def test_a_cut_a_merge_and_a_source_name_the_channels_that_the_file_lacks(tmp_path: Path) -> None:
    path, part, both = with_records(tmp_path / "a.mcap"), tmp_path / "part.mcap", tmp_path / "both.mcap"
    for summary in (cut(path, part, start=START, end=START + MS), merge([path, part], both)):
        assert (summary.absent, summary.complete) == ((ABSENT,), False)
    assert verify(both).summary.absent == (ABSENT,)
    source = McapSource(both)
    assert source.damaged == (ABSENT,)
    source.close()


def test_a_merge_of_overlapping_files_keeps_each_advance_and_each_open_gap_once(tmp_path: Path) -> None:
    items = entries("cam", range(1, 31))
    whole = write(
        tmp_path / "whole.mcap", [*items[:10], ADVANCES[0], *items[10:20], ADVANCES[1], *items[20:], OPEN_GAP]
    )
    parts = [tmp_path / f"{name}.mcap" for name in ("early", "late", "middle")]
    bounds = [(MIN_INSTANT, START + 15 * MS), (START + 15 * MS, MAX_INSTANT), (START + 5 * MS, START + 25 * MS)]
    for part, (start, end) in zip(parts, bounds, strict=True):
        cut(whole, part, start=start, end=end)
    for order in permutations([*parts, whole]):
        merge(order, tmp_path / "all.mcap", overwrite=True)
        assert read(tmp_path / "all.mcap") == read(whole)


@pytest.mark.parametrize("items", [None, 3])
def test_a_merge_does_not_change_the_number_of_items_in_a_gap(tmp_path: Path, items: int | None) -> None:
    """The gap encloses more seqs than it has items, as after the loss of an owner."""
    between = RecordingGap(
        channel="cam", incarnation=INCARNATION, reason="DAMAGED", detail="", first_seq=4, last_seq=2**44, items=items
    )
    one = write(tmp_path / "1.mcap", [*entries("cam", range(1, 4)), between])
    two = write(tmp_path / "2.mcap", entries("cam", range(4, 50)) + entries("cam", range(100, 103)))
    (counts,) = merge([one, two, one], tmp_path / "all.mcap").channels
    assert [(one.first_seq, one.last_seq, one.items) for one in counts.gaps] == [(50, 2**44, items)]


def test_gaps_of_two_files_with_a_common_part_are_merged_without_the_items_of_the_other_file(tmp_path: Path) -> None:
    one = write(tmp_path / "1.mcap", [*entries("cam", [1]), gap("cam", 2, 20), *entries("cam", [21])])
    two = write(tmp_path / "2.mcap", [*entries("cam", [5, 6]), gap("cam", 7, 30)])
    (counts,) = merge([one, two], tmp_path / "all.mcap").channels
    assert [(one.first_seq, one.last_seq, one.items) for one in counts.gaps] == [(2, 4, 3), (7, 20, 14), (22, 30, 9)]


def test_a_file_with_messages_of_unnamed_topics_is_refused_except_by_recover(tmp_path: Path) -> None:
    path, output = tmp_path / "a.mcap", tmp_path / "out.mcap"
    with path.open("wb") as file:
        writer = Writer(file)
        writer.start()
        number = writer.register_channel("cam", "json", 0)
        writer.add_message(number, START, b"{}", START)
        unnamed = Message(channel_id=number + 1, sequence=0, log_time=START, publish_time=START, data=b"{}")
        writer._Writer__chunk_builder.add_message(unnamed)  # type: ignore[attr-defined]  # the writer refuses it
        writer.finish()
    for copied in (lambda: cut(path, output, start=0, end=2**62), lambda: merge([path], output)):
        with pytest.raises(FileError, match=r"1 messages at byte .* does not name; `stampede file recover`"):
            copied()
    with pytest.raises(FileError, match="it has no index of all its messages"):
        McapSource(path)
    assert len(recover(path, output).summary.damaged) == 1
    assert [one.topic.name for one in read(output)[0] if isinstance(one, FileEntry)] == ["cam"]


@pytest.mark.parametrize(("seqs", "later_ms", "common"), [((5, 14), 0, 6), ((11, 14), 0, 0), ((5, 14), 900, 0)])
def test_a_merge_says_that_two_incarnations_may_have_the_same_items(
    tmp_path: Path, seqs: tuple[int, int], later_ms: int, common: int, capsys: pytest.CaptureFixture[str]
) -> None:
    """A crash of the host lies between the recordings. If it had no archive, the seqs begin anew, with later times."""
    paths = [str(write(tmp_path / "a.mcap", entries("cam", range(1, 11))))]
    for name in ("cam", "imu"):
        after = [
            item_entry(Topic(name, "", INCARNATION + 1), item(seq, time=START + (seq + later_ms) * MS))
            for seq in range(*seqs)
        ]
        paths.append(str(write(tmp_path / f"{name}.mcap", after)))
    assert stampede(["file", "merge", *paths, "-o", str(tmp_path / "both.mcap")]) == 0
    printed = capsys.readouterr().err
    assert printed.count("stampede: ") == (1 if common else 0)
    assert (f"channel 'cam' may have up to {common} items twice" in printed) == bool(common)
