"""Torn and damaged files, cuts and merges."""

from __future__ import annotations

import random
from contextlib import suppress
from itertools import product
from pathlib import Path

import pytest
from mcap.writer import IndexType, Writer

from stampede_rt.errors import FileError, InvalidArgument
from stampede_rt.files import seq_order
from stampede_rt.files.chunk_content import ChunkContent
from stampede_rt.files.editing import cut, recover, verify
from stampede_rt.files.entries import FileAdvance, FileEntry, item_entry
from stampede_rt.files.file_report import FileReport
from stampede_rt.files.framing import RecordFile, RecordFrame
from stampede_rt.files.merging import merge
from stampede_rt.files.reading import FileReader
from stampede_rt.files.writing import FileWriter
from stampede_rt.values.recording import RecordingGap
from tests.support.files.recordings import INCARNATION, MS, START, entries, gap, item, read, seqs_of, topic, write

ITEMS = range(1, 101)


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """Two channels, ten items in each chunk."""
    left, right = entries("cam", ITEMS), entries("imu", ITEMS)
    return write(tmp_path / "whole.mcap", [one for pair in zip(left, right, strict=True) for one in pair])


def chunk_ends(path: Path) -> list[int]:
    with FileReader(path) as reader:
        return [part.end for part in reader.contents() if isinstance(part, ChunkContent)]


def test_a_whole_file_is_intact(whole: Path) -> None:
    report = verify(whole)
    assert report.intact
    assert report.summary.complete
    assert [(one.channel, one.recorded) for one in report.summary.channels] == [("cam", 100), ("imu", 100)]


def test_a_file_that_is_cut_off_at_any_byte_loses_at_most_its_last_chunk(whole: Path, tmp_path: Path) -> None:
    content, ends = whole.read_bytes(), chunk_ends(whole)
    torn, saved = tmp_path / "torn.mcap", tmp_path / "saved.mcap"
    places = {*range(ends[0], len(content), 211), *ends, *(end - 1 for end in ends[1:]), *(end + 1 for end in ends)}
    for length in sorted(places):
        torn.write_bytes(content[:length])
        report = recover(torn, saved, overwrite=True)
        expected = list(range(1, 5 * sum(end <= length for end in ends) + 1))
        events, damages = read(saved)
        assert not damages
        assert seqs_of(events) == seqs_of(events, "imu") == expected, length
        assert report.damages[-1].end == length
        for counts in report.summary.channels:  # names the missing items of each channel that it knows
            assert [(one.first_seq, one.reason) for one in counts.gaps] == [(expected[-1] + 1, "DAMAGED")] or (
                report.summary.complete and report.stated is not None and expected == [*ITEMS]
            )
        assert verify(saved).intact


def test_a_file_whose_only_chunk_is_damaged_becomes_a_file_that_names_all_items_as_lost(tmp_path: Path) -> None:
    damaged, saved = write(tmp_path / "a.mcap", entries("cam", range(1, 6))), tmp_path / "saved.mcap"
    content = bytearray(damaged.read_bytes())
    content[chunk_ends(damaged)[0] - 10] ^= 1
    damaged.write_bytes(content)
    report = recover(damaged, saved)
    [counts] = report.summary.channels
    assert (counts.accepted, counts.recorded, report.summary.complete) == (5, 0, False)
    assert [(one.reason, one.first_seq, one.last_seq) for one in counts.gaps] == [("DAMAGED", 1, 5)]
    other = write(tmp_path / "other.mcap", entries("cam", range(2, 9)))
    [merged] = merge([saved, other], tmp_path / "merged.mcap").channels
    assert [(one.first_seq, one.last_seq, one.items) for one in merged.gaps] == [(1, 1, 1)]


def test_a_file_that_was_cut_off_before_its_first_chunk_has_nothing_to_recover(whole: Path, tmp_path: Path) -> None:
    """In an earlier version the output was a whole file without items, which `verify` accepted."""
    torn, saved = tmp_path / "torn.mcap", tmp_path / "saved.mcap"
    writer = FileWriter(tmp_path / "metadata.mcap")
    writer.add_metadata("a", {"b": "c"})
    writer.abandon()
    with pytest.raises(FileError, match="nothing can be recovered"):
        recover(tmp_path / "metadata.mcap", saved)
    for length in range(8, chunk_ends(whole)[0], 97):
        torn.write_bytes(whole.read_bytes()[:length])
        with pytest.raises(FileError, match=f"nothing can be recovered .* {length} bytes, .* no file was written"):
            recover(torn, saved)
        assert not saved.exists()
    saved.write_bytes(b"former")
    with pytest.raises(FileError, match="nothing can be recovered"):
        recover(torn, saved, overwrite=True)
    assert saved.read_bytes() == b"former"


def test_a_flipped_bit_loses_only_its_chunk_and_a_gap_names_the_lost_items(whole: Path, tmp_path: Path) -> None:
    content, ends = whole.read_bytes(), chunk_ends(whole)
    flipped, saved = tmp_path / "flipped.mcap", tmp_path / "saved.mcap"
    drawn = random.Random(7)
    for _ in range(50):
        place = drawn.randrange(60, ends[-1])
        changed = bytearray(content)
        changed[place] ^= 1 << drawn.randrange(8)
        flipped.write_bytes(changed)
        report = recover(flipped, saved, overwrite=True)
        seqs = seqs_of(read(saved)[0])
        lost = sorted(set(ITEMS) - {seq for seq in seqs if seq is not None})
        assert len(lost) in (0, 5), (place, lost)
        for counts in report.summary.channels:
            named = [seq for one in counts.gaps for seq in range(one.first_seq or 0, (one.last_seq or 0) + 1)]
            assert named == lost, place
            assert counts.accepted == 100 == counts.recorded + counts.missing
        assert bool(lost) <= bool(report.damages)


def test_verify_notices_each_flipped_bit(whole: Path, tmp_path: Path) -> None:
    content, flipped, drawn = whole.read_bytes(), tmp_path / "flipped.mcap", random.Random(11)
    end_mark = range(len(content) - 8, len(content))
    for place in (*(drawn.randrange(8, len(content)) for _ in range(150)), *end_mark):
        changed = bytearray(content)
        changed[place] ^= 1 << drawn.randrange(8)
        flipped.write_bytes(changed)
        assert not verify(flipped).complete, place


def test_a_torn_file_is_never_complete(whole: Path, tmp_path: Path) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole.read_bytes()[:40])
    assert not verify(torn).complete
    assert verify(torn).summary.damaged == (
        f"32 bytes of the file {str(torn)!r} were damaged, so items of channels that the file does not name may be "
        "missing",
    )


def test_an_empty_file_is_named_as_empty(tmp_path: Path) -> None:
    (tmp_path / "empty.mcap").write_bytes(b"")
    with pytest.raises(FileError, match=r"empty\.mcap' is empty"):
        verify(tmp_path / "empty.mcap")


def test_flipped_bits_cause_only_the_documented_errors(whole: Path, tmp_path: Path) -> None:
    content, drawn = whole.read_bytes(), random.Random(3)
    flipped, saved = tmp_path / "flipped.mcap", tmp_path / "saved.mcap"
    for _ in range(25):
        changed = bytearray(content)
        for _ in range(20):
            changed[drawn.randrange(8, len(content))] ^= 1 << drawn.randrange(8)
        flipped.write_bytes(changed)
        recover(flipped, saved, overwrite=True)
        assert verify(saved).intact


def test_verify_finds_items_that_the_summary_counts_but_the_file_lacks(whole: Path, tmp_path: Path) -> None:
    content, ends = whole.read_bytes(), chunk_ends(whole)
    shorter = tmp_path / "shorter.mcap"
    shorter.write_bytes(content[: ends[3]] + content[ends[4] :])
    report = verify(shorter)
    assert not report.intact


def test_recover_does_not_write_over_its_source_or_another_file(whole: Path, tmp_path: Path) -> None:
    with pytest.raises(InvalidArgument, match="is the file to read"):
        recover(whole, whole, overwrite=True)
    with pytest.raises(FileError, match="exists"):
        recover(whole, write(tmp_path / "b.mcap", []))


def test_cutting_a_file_keeps_the_items_gaps_and_advances_of_the_interval(tmp_path: Path) -> None:
    events = [
        *entries("cam", range(1, 21)), gap("cam", 21, 25), *entries("cam", range(26, 41)),
        FileAdvance("cam", INCARNATION, START + 41 * MS, 40), gap("cam", 41, 50), *entries("cam", range(51, 61)),
        *entries("imu", range(1, 61)),
    ]  # fmt: skip
    path = write(tmp_path / "a.mcap", events, chunk_items=7)
    output = tmp_path / "b.mcap"
    summary = cut(path, output, start=START + 10 * MS, end=START + 35 * MS, chosen=lambda name: name == "cam")
    found, _ = read(output)
    assert seqs_of(found) == [*range(10, 21), *range(26, 35)]
    assert not seqs_of(found, "imu")
    assert [one.gaps for one in summary.channels] == [(gap("cam", 21, 25),)]
    assert verify(output).intact
    cut(path, output, start=START + 30 * MS, end=START + 100 * MS, overwrite=True)
    found, _ = read(output)
    assert [one for one in found if isinstance(one, FileAdvance)] == [events[36]]
    assert len(seqs_of(found, "imu")) == 31


def test_a_damaged_file_is_recovered_before_it_is_cut(whole: Path, tmp_path: Path) -> None:
    torn = tmp_path / "torn.mcap"
    torn.write_bytes(whole.read_bytes()[:2000])
    with pytest.raises(FileError, match="stampede file recover"):
        cut(torn, tmp_path / "b.mcap", start=0, end=1)


def test_a_file_without_its_end_is_recovered_before_it_is_cut_or_merged(whole: Path, tmp_path: Path) -> None:
    """Its chunks can all be read. Without the index nothing shows that a whole chunk is missing."""
    content, ends, torn = whole.read_bytes(), chunk_ends(whole), tmp_path / "torn.mcap"
    for present in (content[: ends[3]], content[: ends[3]] + content[ends[4] :]):
        torn.write_bytes(present)
        for edit in (lambda output: cut(torn, output, start=0, end=2**62), lambda output: merge([torn], output)):
            with pytest.raises(FileError, match=r"the end of the file .* is missing or damaged.* file recover"):
                edit(tmp_path / "b.mcap")
            assert {path.name for path in tmp_path.iterdir()} == {"torn.mcap", "whole.mcap"}


@pytest.mark.parametrize("overwrite", [False, True])
def test_a_cut_that_fails_or_may_not_overwrite_leaves_the_former_file_as_it_was(
    whole: Path, tmp_path: Path, overwrite: bool
) -> None:
    output = write(tmp_path / "b.mcap", entries("cam", range(3)))
    former, damaged, place = output.read_bytes(), bytearray(whole.read_bytes()), chunk_ends(whole)[3] - 20
    damaged[place] ^= 1
    whole.write_bytes(damaged)
    with pytest.raises(FileError, match="is damaged at" if overwrite else "exists"):
        cut(whole, output, start=0, end=2**62, overwrite=overwrite)
    assert output.read_bytes() == former
    assert {path.name for path in tmp_path.iterdir()} == {"b.mcap", "whole.mcap"}


def test_a_file_whose_writer_writes_no_index_can_be_cut_and_merged(tmp_path: Path) -> None:
    path, output = tmp_path / "other.mcap", tmp_path / "b.mcap"
    with path.open("wb") as file:
        writer = Writer(
            file, index_types=IndexType.NONE, repeat_channels=False, repeat_schemas=False, use_statistics=False,
            use_summary_offsets=False,
        )  # fmt: skip
        writer.start()
        number = writer.register_channel("cam", "json", 0)
        writer.add_message(number, START, b"{}", START)
        writer.finish()
    with FileReader(path) as reader:
        assert (reader.index, reader.says_no_index) == (None, True)
    assert merge([path], output).recorded == 1
    assert cut(path, output, start=START, end=START + 1, overwrite=True).recorded == 1


def test_merging_files_keeps_each_item_once_and_fills_gaps(tmp_path: Path) -> None:
    one = write(
        tmp_path / "1.mcap", [*entries("cam", range(1, 41)), gap("cam", 41, 60), *entries("cam", range(61, 81))]
    )
    two = write(tmp_path / "2.mcap", [gap("cam", 1, 9), *entries("cam", range(10, 51)), gap("cam", 51, 80)])
    three = write(tmp_path / "3.mcap", entries("imu", range(1, 5)))
    output = tmp_path / "all.mcap"
    summary = merge([one, two, three], output)
    found, _ = read(output)
    assert seqs_of(found) == [*range(1, 51), *range(61, 81)]
    assert seqs_of(found, "imu") == [1, 2, 3, 4]
    cam = summary.channels[0]
    assert (cam.accepted, cam.recorded, cam.missing) == (80, 70, 10)
    assert [(gap.first_seq, gap.last_seq) for gap in cam.gaps] == [(51, 60)]
    assert verify(output).intact


def heads_of(path: Path) -> list[int]:
    """The places of the opcodes and lengths of the records before the index."""
    with FileReader(path) as reader:
        assert reader.index is not None
        end = max(one.chunk_start_offset + one.chunk_length for one in reader.index.chunks)
    with RecordFile(path) as records:
        frames = [one.offset for one in records.frames() if isinstance(one, RecordFrame) and one.offset < end]
    return [offset + at for offset in frames for at in range(9)]


def lost_in_silence(report: FileReport, output: Path, true: set[tuple[str, int]]) -> set[tuple[str, int]]:
    """Return the items of `true` that a recovered file lacks, and that no gap of the file names.

    Checks that the file has no items beside those of `true`. If the file no longer names the topic of a channel, only
    the reported damage shows that items are missing.
    """
    found, _ = read(output)
    items = {(one.topic.name, one.seq) for one in found if isinstance(one, FileEntry)}
    gaps = [one for one in found if isinstance(one, RecordingGap)]
    reported = {(gap.channel, seq) for gap in gaps for seq in range(gap.first_seq or 1, (gap.last_seq or 19) + 1)}
    assert items <= true
    known = {one.channel for one in report.summary.channels}
    return {one for one in true - items - reported if one[0] in known or not report.damages}


def test_a_flipped_bit_in_the_head_of_a_record_hides_no_item_in_silence(tmp_path: Path) -> None:
    events = [*entries("cam", range(1, 20)), *entries("imu", range(1, 20))]
    path = write(tmp_path / "a.mcap", events)
    content, flipped, output = path.read_bytes(), tmp_path / "b.mcap", tmp_path / "c.mcap"
    true = {(name, seq) for name in ("cam", "imu") for seq in range(1, 20)}
    for place, bit in product(heads_of(path), range(8)):
        flipped.write_bytes(content[:place] + bytes([content[place] ^ 1 << bit]) + content[place + 1 :])
        report = recover(flipped, output, overwrite=True)
        assert not lost_in_silence(report, output, true), (place, bit)
        with suppress(FileError):
            assert cut(flipped, output, start=START, end=START + 99 * MS, overwrite=True).recorded == len(true)


def test_a_flipped_bit_in_the_head_of_a_record_of_a_torn_file_costs_one_chunk_and_hides_no_item_in_silence(
    tmp_path: Path,
) -> None:
    events = [*entries("cam", range(1, 20)), *entries("imu", range(1, 20))]
    path = write(tmp_path / "a.mcap", [one for pair in zip(events[:19], events[19:], strict=True) for one in pair])
    content, flipped, output = path.read_bytes()[: chunk_ends(path)[-1] - 1], tmp_path / "b.mcap", tmp_path / "c.mcap"
    true = {(name, seq) for name in ("cam", "imu") for seq in range(1, 20)}
    header = heads_of(path)[:9]
    for place, bit in product([one for one in heads_of(path) if one < len(content)], range(8)):
        flipped.write_bytes(content[:place] + bytes([content[place] ^ 1 << bit]) + content[place + 1 :])
        try:
            report = recover(flipped, output, overwrite=True)
        except FileError:  # no chunk can be read
            assert place in header, (place, bit)
            continue
        assert not lost_in_silence(report, output, true), (place, bit)
        recorded = sum(one.recorded for one in report.summary.channels)
        # the file has three whole chunks of ten items, and the bit costs at most one of them
        assert recorded + report.unknown >= 20 or place in header, (place, bit)


def test_a_merge_keeps_the_order_of_acceptance_of_late_items(tmp_path: Path) -> None:
    times = {1: 10, 2: 50, 3: 20, 4: 51, 5: 52}  # seq 3 came late
    made = {seq: item_entry(topic(), item(seq, time=START + at * MS)) for seq, at in times.items()}
    advance = FileAdvance("cam", INCARNATION, START + 15 * MS, 3)
    one = write(tmp_path / "one.mcap", [made[1], gap("cam", 2, 2), made[3], advance, made[4]])
    other = write(tmp_path / "other.mcap", [made[2], gap("cam", 3, 4), made[5]], chunk_items=1)
    for paths in ((one, other), (other, one)):
        merge(paths, tmp_path / "both.mcap", overwrite=True)
        found, _ = read(tmp_path / "both.mcap")
        assert [event.seq if isinstance(event, FileEntry) else event for event in found] == [1, 2, 3, advance, 4, 5]


def test_a_merge_writes_all_items_if_too_many_wait_for_their_order(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(seq_order, "WAITING_BYTES_MAX", 2000)
    early = write(tmp_path / "early.mcap", [item_entry(topic(), item(seq, time=START)) for seq in range(11, 31)])
    late = write(tmp_path / "late.mcap", [item_entry(topic(), item(seq, time=START + MS)) for seq in range(1, 11)])
    merge([early, late], tmp_path / "both.mcap")
    found, _ = read(tmp_path / "both.mcap")
    assert sorted(seqs_of(found), key=lambda seq: seq or 0) == [*range(1, 31)]
