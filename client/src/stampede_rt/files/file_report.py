"""Reads a whole MCAP file, and finds the items and messages that are missing in it.

The evidence is: damaged bytes, the recorder's summary in the file, the index at the end of the file, and the checksum
of the data. A file of another program has no such summary.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mcap.records import Attachment, Metadata

from stampede_rt.files.chunk_content import ChunkContent, Event
from stampede_rt.files.file_index import ContentCounts
from stampede_rt.files.file_tally import FileTally, recorded_in_gap
from stampede_rt.files.framing import Damage
from stampede_rt.files.intact import LOSSES_MAX
from stampede_rt.files.reading import FileReader
from stampede_rt.files.summaries import SUMMARY_NAME
from stampede_rt.values.recording import RecordingSummary

DAMAGES_KEPT_MAX = 1000


@dataclass(frozen=True, kw_only=True, slots=True)
class FileReport:
    """The findings of `verify` or `recover` about a file that it has read to its end.

    - `damages` has the first 1000 parts of the file that cannot be read.
    - `finished`: the file has an index. Its writer writes the index last.
    - `unknown` is the number of messages whose topics the file does not name.
    - `summary` has the counts of this reading. `stated` is the recorder's own summary in the file; None if there is no
      summary, or if it cannot be read.
    - `data_is_whole`: the bytes before the index have the checksum that the file states, or it states none.
    - `differences` has a text for each point in which the contents disagree with the index.
    """

    summary: RecordingSummary
    stated: RecordingSummary | None
    damages: Sequence[Damage]
    damaged_bytes: int
    finished: bool
    unknown: int
    size_bytes: int
    data_is_whole: bool
    differences: Sequence[str]

    @property
    def complete(self) -> bool:
        """Whether the file is intact, and names no missing items."""
        return self.intact and self.summary.complete

    @property
    def intact(self) -> bool:
        """Whether every byte could be read, and the file agrees with its summary."""
        return self.finished and not self.damages and not self.unknown and not self.contradictions

    @property
    def contradictions(self) -> list[str]:
        """Where the file disagrees with its summary, its index or its checksum."""
        found = {(one.channel, one.incarnation): one for one in self.summary.channels}
        wrong = []
        if not self.data_is_whole and not self.damages:
            wrong.append(
                "the messages can be read, but the bytes around the messages do not have the checksum that the file "
                "states; `stampede file recover` writes the messages to a file with new indexes"
            )
        for stated in self.stated.channels if self.stated else ():
            one = found.get((stated.channel, stated.incarnation))
            has = 0 if one is None else one.recorded
            if has != stated.recorded:
                wrong.append(f"channel {stated.channel}: the summary says {stated.recorded} items, the file has {has}")
        return [*wrong, *self.differences]


class _Found:
    """Gathers the findings about one file, while `scan_file` passes the parts of the file to it."""

    def __init__(self, reader: FileReader) -> None:
        self.reader, self.stated = reader, reader.summary_if_readable()
        self.tally = FileTally(self.stated)  # counts the items of each channel, to find missing ones
        self.content_counts = ContentCounts()  # counts messages and records, to compare them with the index
        self.damages: list[Damage] = []
        self.damaged_bytes = self.unknown = 0
        self.has_summary = False  # whether the recorder's summary, which follows all chunks, has been read
        self.has_damage_before_summary = False
        self.damaged_bytes_beside_chunks = 0  # before the summary

    def damage(self, part: Damage) -> None:
        length = part.end - part.offset
        self.damaged_bytes += length
        if not self.has_summary:
            self.has_damage_before_summary = True
            if part.times == (None, None):  # only damaged chunks have times
                self.damaged_bytes_beside_chunks += length
        self.tally.damage(part.times, f"the file is damaged at byte {part.offset}: {part.detail}")
        if len(self.damages) < DAMAGES_KEPT_MAX:
            self.damages.append(part)

    def add(self, part: ChunkContent | Attachment | Metadata) -> None:
        self.content_counts.add(part)
        if isinstance(part, ChunkContent):
            self.unknown += part.unknown
        elif isinstance(part, Metadata) and part.name == SUMMARY_NAME:
            self.has_summary = True

    def report(self, take: Callable[[Event], None]) -> FileReport:
        """Return the findings. Calls `take` with the gaps after the last items that the file does not name."""
        reader, stated = self.reader, self.stated
        for gap in self.tally.ends():
            take(gap)
        differences = self.content_counts.differences(reader.index, skip_own_channels=stated is not None)
        summary = _with_losses(self.tally.summary(reader.path), stated, self._unnamed_losses(differences))
        is_explained = summary.damaged or self.has_damage_before_summary  # damage explains a wrong checksum
        if not is_explained and not reader.data_is_whole:
            summary = replace(summary, damaged=(_wrong_checksum_text(reader.path),))
        return FileReport(
            summary=summary, stated=stated, damages=tuple(self.damages), damaged_bytes=self.damaged_bytes,
            finished=reader.index is not None, unknown=self.unknown, size_bytes=reader.size,
            data_is_whole=reader.data_is_whole, differences=tuple(differences),
        )  # fmt: skip

    def _unnamed_losses(self, differences: Sequence[str]) -> list[str]:
        """Return the losses that no gap names, as texts."""
        reader, stated = self.reader, self.stated
        losses = [] if stated is None else [*stated.damaged]
        has_own_channels, file = self.tally.has_own_channels, f"the file {reader.path!r}"
        if self.damages and stated is None:  # nothing in the file says which channels it had
            what = f"{self.damaged_bytes} bytes of {file} were damaged" if self.damaged_bytes else f"{file} had no end"
            losses.append(f"{what}, so items of channels that the file does not name may be missing")
        # A recorder writes a summary and an index. Some other programs write no index, and their files say so.
        elif stated is None and reader.index is None and (has_own_channels or not reader.says_no_index):
            what = "summary" if has_own_channels else "index"
            losses.append(f"the {what} of {file} cannot be read, so the file may lack items that no gap names")
        # The summary accounts for all items, but nothing accounts for other records.
        elif reader.index is None and self.damaged_bytes_beside_chunks:
            losses.append(
                f"{self.damaged_bytes_beside_chunks} bytes of {file} were damaged: perhaps attachments or metadata"
            )
        # Without an index or the right checksum, chunks may have changed places.
        if reader.index is None or not reader.data_is_whole:
            channels = self.tally.disordered
            losses += [
                f"the items of channel {one} are not in the order in which the channel had them" for one in channels
            ]
        if self.unknown:
            losses.append(
                f"{self.unknown} messages of {file} were left out, because the file does not name their topics"
            )
        return losses + [f"the contents of {reader.path!r} do not agree with the index: {one}" for one in differences]


def scan_file(
    reader: FileReader,
    take: Callable[[Event | Attachment | Metadata], None],
    on_bytes: Callable[[int], object],
    is_repeated: Callable[[Event], bool] = lambda _: False,
) -> FileReport:
    """Read a file to its end. Calls `take` with each part of its contents, and with each gap that damage has made.

    Leaves out the events for which `is_repeated` is true. Calls `on_bytes` after each chunk, with the position in the
    file at which the chunk ends.
    """
    found = _Found(reader)
    for part in reader.contents():
        if isinstance(part, Damage):
            found.damage(part)
            continue
        found.add(part)
        if not isinstance(part, ChunkContent):
            take(part)
            continue
        for event in part.in_host_order():
            if not is_repeated(event):
                for gap in found.tally.add(event):
                    take(gap)
                take(event)
        on_bytes(part.end)
    return found.report(take)


def _wrong_checksum_text(path: str) -> str:
    return (
        f"the bytes around the messages of the file {path!r} do not have the checksum that the file states, so "
        "attachments, metadata or the order of the messages may have changed"
    )


def _with_losses(found: RecordingSummary, stated: RecordingSummary | None, losses: list[str]) -> RecordingSummary:
    """Return `found` with the losses that no gap of a channel names. `stated`: the recorder's summary in the file.

    `losses` are such losses, as texts. This function adds the items that the summary counts and the file lacks.
    `absent` has the texts of the summary about channels that the recorder could not record at all.
    """
    by_key = {(one.channel, one.incarnation): one for one in found.channels}
    for counts in stated.channels if stated else ():
        one = by_key.get((counts.channel, counts.incarnation))
        has = 0 if one is None else one.recorded + sum(recorded_in_gap(gap, counts) for gap in one.gaps)
        if has < counts.recorded:
            missing = counts.recorded - has
            losses.append(
                f"{missing} items of channel {counts.channel} are missing, which the summary of the file counts"
            )
    return replace(found, absent=() if stated is None else tuple(stated.absent), damaged=tuple(losses[:LOSSES_MAX]))
