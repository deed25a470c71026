"""A recovered file names the items that it may lack, even if nobody can know them exactly."""

from __future__ import annotations

import random
from pathlib import Path

import pytest
from mcap.writer import Writer

from stampede_rt.cli.main import main as stampede
from stampede_rt.files.chunk_content import ChunkContent
from stampede_rt.files.editing import cut, recover, verify
from stampede_rt.files.entries import POLICY_KEY, FileAdvance, FileEntry, Topic, item_entry
from stampede_rt.files.merging import merge
from stampede_rt.files.reading import FileReader
from stampede_rt.files.sources import McapSource
from stampede_rt.values.recording import RecordingGap
from tests.support.files.recordings import INCARNATION, MS, START, entries, gap, item, read, seqs_of, write

ITEMS = range(1, 31)
FOREIGN = FileEntry(Topic("/tf", "ros1"), 5, 5, 0, b"transform", None, 5, None, {}, "")
"""A message of another program, without facts."""


@pytest.fixture
def whole(tmp_path: Path) -> Path:
    """Two channels, and one with a single item in the first chunk."""
    pairs = zip(entries("cam", ITEMS), entries("imu", ITEMS), strict=True)
    return write(tmp_path / "whole.mcap", [*entries("once", [1]), *(one for pair in pairs for one in pair)])


def chunks_of(path: Path) -> list[tuple[int, int]]:
    with FileReader(path) as reader:
        return [(part.offset, part.end) for part in reader.contents() if isinstance(part, ChunkContent)]


def damaged(path: Path, place: int, length: int | None = None) -> Path:
    """Write a copy with a flipped bit, of `length` bytes."""
    content, copy = bytearray(path.read_bytes()[:length]), path.with_name("damaged.mcap")
    content[place] ^= 4
    copy.write_bytes(content)
    return copy


def middle(chunk: tuple[int, int]) -> int:
    return sum(chunk) // 2


def test_messages_are_recovered_although_the_chunk_that_names_their_topics_is_damaged_and_the_end_is_missing(
    whole: Path, tmp_path: Path
) -> None:
    """In an earlier version the output had no message, and `verify` called it complete."""
    chunks, saved = chunks_of(whole), tmp_path / "saved.mcap"
    report = recover(damaged(whole, middle(chunks[0]), chunks[-1][0] + 5), saved)
    cam, imu = seqs_of(read(saved)[0]), seqs_of(read(saved)[0], "imu")
    assert (cam[0], imu[0]) == (6, 5)
    assert cam == [*range(6, 31)]
    assert imu == [*range(5, 30)]
    assert report.unknown == 0
    verified = verify(saved)
    assert (verified.intact, verified.complete) == (True, False)
    gaps = {one.channel: [(gap.first_seq, gap.last_seq) for gap in one.gaps] for one in verified.summary.channels}
    assert gaps == {"cam": [(None, 5), (31, None)], "imu": [(None, 4), (30, None)]}
    begun = verified.summary.channels[0].gaps[0].detail
    assert begun == f"the file is damaged at byte {chunks[0][0]}: its checksum does not match its content"


def test_a_file_recovered_from_a_torn_file_reports_each_damaged_chunk(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    chunks, saved = chunks_of(whole), tmp_path / "saved.mcap"
    for chunk in chunks[:-1]:
        torn = damaged(whole, middle(chunk), chunks[-1][0] + 5)
        assert (
            recover(torn, saved, overwrite=True)
            .summary.damaged[0]
            .startswith(f"{chunk[1] - chunk[0] + 5} bytes of the file {str(torn)!r} were damaged")
        )
        for verb in ("verify", "info"):
            assert stampede(["file", verb, str(saved)]) == (3 if verb == "verify" else 0)
            printed = capsys.readouterr().out
            assert "cam: an unknown number of items" in printed
            assert "so items of channels that the file does not name may be missing" in printed


def test_the_parts_of_a_recovered_file_also_report_its_damage(whole: Path, tmp_path: Path) -> None:
    saved, part, both = (tmp_path / name for name in ("saved.mcap", "part.mcap", "both.mcap"))
    notes = recover(damaged(whole, 50, chunks_of(whole)[-1][1]), saved).summary.damaged
    assert len(notes) == 1
    assert cut(saved, part, start=0, end=2**62).damaged == notes
    assert merge([saved, part], both).damaged == notes
    assert verify(both).summary.damaged == notes


@pytest.mark.parametrize(("others", "unknown_from"), [((8, 26), 26), ((40, 50), 10)])
def test_in_a_merge_the_unknown_end_of_a_torn_file_begins_after_the_adjacent_items_of_the_other_file(
    tmp_path: Path, others: tuple[int, int], unknown_from: int
) -> None:
    whole = write(tmp_path / "whole.mcap", entries("cam", range(1, 31)), chunk_items=9)
    torn, saved, both = (tmp_path / name for name in ("torn.mcap", "saved.mcap", "both.mcap"))
    torn.write_bytes(whole.read_bytes()[: chunks_of(whole)[0][1]])
    recover(torn, saved)
    (before,) = verify(saved).summary.channels
    assert [(one.first_seq, one.last_seq) for one in before.gaps] == [(10, None)]
    merge([saved, write(tmp_path / "other.mcap", entries("cam", range(*others)))], both)
    (after,) = verify(both).summary.channels
    assert [(one.first_seq, one.last_seq) for one in after.gaps] == [(unknown_from, None)]


def test_a_file_that_is_damaged_only_after_its_summary_loses_nothing(
    whole: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    content, saved, copy = whole.read_bytes(), tmp_path / "saved.mcap", tmp_path / "torn.mcap"
    copy.write_bytes(content[:-60])
    for path in (damaged(whole, len(content) - 3), copy):
        assert stampede(["file", "recover", str(path), "-o", str(saved), "--overwrite"]) == 0
        assert "missing:" not in capsys.readouterr().out
        assert verify(saved).complete
        assert seqs_of(read(saved)[0]) == [*ITEMS]


def test_items_that_only_the_summary_knows_are_named(whole: Path, tmp_path: Path) -> None:
    content, chunks = whole.read_bytes(), chunks_of(whole)
    (tmp_path / "shorter.mcap").write_bytes(content[: chunks[0][0]] + content[chunks[0][1] :])
    recover(tmp_path / "shorter.mcap", tmp_path / "saved.mcap")
    assert verify(tmp_path / "saved.mcap").summary.damaged == tuple(
        f"{count} items of channel {channel} are missing, which the summary of the file counts"
        for channel, count in (("cam", 5), ("imu", 4), ("once", 1))
    )


def test_topics_are_found_between_messages_of_other_programs(tmp_path: Path) -> None:
    events: list[FileEntry] = []
    for seq in ITEMS:
        events += [FOREIGN, *entries("cam", [seq]), item_entry(Topic("imu", "json", INCARNATION), item(2 * seq, b"{}"))]
    path, saved = write(tmp_path / "mixed.mcap", events, chunk_items=12), tmp_path / "saved.mcap"
    chunks = chunks_of(path)
    report = recover(damaged(path, middle(chunks[0]), chunks[-1][1]), saved)
    assert seqs_of(read(saved)[0]) == [*range(5, 31)]
    assert seqs_of(read(saved)[0], "imu") == [*range(10, 61, 2)]
    assert report.unknown == 26
    assert report.summary.damaged[1].startswith("26 messages of the file ")
    assert verify(saved).summary.damaged == report.summary.damaged


def test_a_recovered_file_of_another_program_names_its_losses(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path, saved = tmp_path / "other.mcap", tmp_path / "saved.mcap"
    with path.open("wb") as stream:
        writer = Writer(stream)
        writer.start()
        for number in range(3):
            topic = writer.register_channel(f"/t{number}", "json", 0)
            writer.add_message(topic, number, b"{}" * 50, number)
            writer.flush()  # type: ignore[no-untyped-call]
        writer.finish()  # type: ignore[no-untyped-call]
    recover(damaged(path, middle(chunks_of(path)[0]), chunks_of(path)[-1][1]), saved)
    assert not verify(saved).complete
    assert stampede(["file", "info", str(saved)]) == 0
    printed = capsys.readouterr().out
    assert "/t1" in printed
    assert "missing: " in printed


@pytest.mark.parametrize("has_end", [True, False])
def test_a_policy_is_lost_only_if_its_chunk_is_damaged_and_the_end_of_the_file_is_missing(
    tmp_path: Path, has_end: bool
) -> None:
    kind = Topic("cam", "application/octet-stream", INCARNATION, metadata=((POLICY_KEY, '{"max_items":7}'),))
    path, saved = write(tmp_path / "a.mcap", [item_entry(kind, item(seq)) for seq in ITEMS]), tmp_path / "saved.mcap"
    chunks = chunks_of(path)
    report = recover(damaged(path, middle(chunks[0]), None if has_end else chunks[-1][1]), saved)
    assert [(one.channel, one.recorded) for one in report.summary.channels] == [("cam", 20)]
    source = McapSource(saved)
    [found] = source.topics(lambda _: True)
    source.close()
    assert found.policy == ({"max_items": 7} if has_end else {})


@pytest.mark.parametrize("finished", [True, False])
def test_a_cut_of_the_beginning_keeps_the_gap_of_a_damaged_first_chunk(tmp_path: Path, finished: bool) -> None:
    path, saved = tmp_path / "a.mcap", tmp_path / "saved.mcap"
    write(path, entries("cam", range(1, 13), random.Random(1).randbytes(400_000)), finish=finished)
    recover(damaged(path, middle(chunks_of(path)[0])), saved)
    assert len(chunks_of(saved)) == 5
    source = McapSource(saved)
    for start, end, gaps in ((0, 5, [2]), (0, 2, [2]), (4, 6, []), (12, 20, [])):
        within = {"start": START + start * MS, "end": START + end * MS}
        part = cut(saved, tmp_path / "part.mcap", overwrite=True, **within)
        assert [one.last_seq for counts in part.channels for one in counts.gaps if one.last_seq] == gaps
        events = [event for _, event in source.events(lambda _: True, *within.values())]
        assert [one.last_seq for one in events if isinstance(one, RecordingGap) and one.last_seq] == gaps
    source.close()


def test_items_keep_their_facts_although_the_names_of_other_topics_of_their_channel_are_damaged(tmp_path: Path) -> None:
    """A channel has a topic for each content type of its items."""
    kinds = ["text/plain", "application/json", "text/plain", "image/png", "application/json"] * 6
    items = [
        item(seq, b"%d" % seq, duration=seq, content_type=kind, n=str(seq)) for seq, kind in enumerate(kinds, 2**32 - 9)
    ]
    events = [item_entry(Topic("cam", one.content_type, INCARNATION), one) for one in items]
    path, saved = write(tmp_path / "a.mcap", events, chunk_items=3, finish=False), tmp_path / "saved.mcap"
    recover(damaged(path, middle(chunks_of(path)[0])), saved)
    found = [one.to_item() for one in read(saved)[0] if isinstance(one, FileEntry)]
    assert [one._replace(end=None) for one in found] == items[3:]


def test_a_chunk_that_a_faulty_copy_has_twice_is_recovered_once(whole: Path, tmp_path: Path) -> None:
    content, (begin, end) = whole.read_bytes(), chunks_of(whole)[1]
    (tmp_path / "twice.mcap").write_bytes(content[:end] + content[begin:])
    assert not verify(tmp_path / "twice.mcap").intact
    assert recover(tmp_path / "twice.mcap", tmp_path / "saved.mcap").summary.recorded == 61
    assert seqs_of(read(tmp_path / "saved.mcap")[0]) == [*ITEMS]


@pytest.mark.parametrize("lost_end", [0, 3, 2000])
def test_the_gap_of_a_damaged_first_chunk_comes_before_the_first_item(tmp_path: Path, lost_end: int) -> None:
    """The recorder's summary says what the chunk had. A damaged index does not hide it. A missing end does."""
    advance = FileAdvance("cam", INCARNATION, START, 0)
    events = [*entries("cam", range(3, 31), b"x" * 99), gap("cam", 31, 33), *entries("cam", range(34, 90), b"x" * 99)]
    path, saved = tmp_path / "a.mcap", tmp_path / "saved.mcap"
    write(path, [advance, *entries("imu", range(1, 10)), *events], compression="none")
    first, second = chunks_of(path)[:2]
    recover(damaged(path, middle(second), path.stat().st_size - lost_end), saved)
    source = McapSource(saved)
    found = [event for _, event in source.events(lambda name: name == "cam", 0, 2**62)]
    source.close()
    seqs = [(one.first_seq, one.last_seq, one.items) for one in found if isinstance(one, RecordingGap)]
    begin, items = (None, None) if lost_end == 2000 else (3, 10)
    assert seqs[:2] == [(begin, 12, items), (31, 33, 3)]
    place = next(at for at, one in enumerate(found) if isinstance(one, RecordingGap))
    assert seqs_of(found[:place]) == []
    assert seqs_of(found[place:])[0] == 13
    assert first[1] < second[0]


def test_messages_of_another_program_with_the_sequences_of_a_channel_do_not_become_its_items(tmp_path: Path) -> None:
    """The chunk that names both topics is damaged, and the end of the file is missing."""
    pairs = [(FOREIGN._replace(sequence=seq), entries("cam", [seq])[0]) for seq in ITEMS]
    path = write(tmp_path / "mixed.mcap", [one for pair in pairs for one in pair], finish=False)
    saved = tmp_path / "saved.mcap"
    report = recover(damaged(path, middle(chunks_of(path)[0])), saved)
    assert seqs_of(read(saved)[0]) == []
    assert (report.unknown, report.summary.complete) == (50, False)


def test_a_summary_with_a_damaged_name_of_a_field_says_nothing_about_the_first_chunk(tmp_path: Path) -> None:
    path, saved = write(tmp_path / "a.mcap", entries("cam", ITEMS)), tmp_path / "saved.mcap"
    torn = damaged(path, middle(chunks_of(path)[0]))
    torn.write_bytes(torn.read_bytes().replace(b'"first_seq":1,"last_seq":30', b'"firsu_seq":1,"last_seq":30'))
    recover(torn, saved)
    [found] = verify(saved).summary.channels
    assert [(one.first_seq, one.last_seq) for one in found.gaps] == [(None, 10)]
