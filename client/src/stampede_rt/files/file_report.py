"""Reads a whole file, and finds what it lacks, by its damage, its summary, its index and its checksum."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from mcap.records import Attachment, Metadata

from stampede_rt.files.chunk_content import ChunkContent, Event
from stampede_rt.files.file_index import ContentCounts
from stampede_rt.files.file_tally import FileTally, recorded_between
from stampede_rt.files.framing import Damage
from stampede_rt.files.intact import LOSSES_MAX
from stampede_rt.files.reading import FileReader
from stampede_rt.files.summaries import SUMMARY_NAME
from stampede_rt.values.recording import RecordingSummary

DAMAGES_KEPT_MAX = 1000


@dataclass(frozen=True, kw_only=True, slots=True)
class FileReport:
    """The findings of `verify` or `recover` about a file that it has read to its end.

    `damages` has the first 1000 parts that cannot be read. `finished`: the file has the index that its writer
    writes last. `unknown` counts messages of topics that the file does not name. `stated` is the recorder's own
    summary; None if the file has none that can be read. `data_is_whole`: the bytes before the index have the stated
    checksum, if there is one. `differences` says where the contents disagree with the index.
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
                "the messages can be read, but the bytes around them do not have their checksum; `stampede file "
                "recover` writes the messages to a file with new indexes"
            )
        for stated in self.stated.channels if self.stated else ():
            one = found.get((stated.channel, stated.incarnation))
            has = 0 if one is None else one.recorded
            if has != stated.recorded:
                wrong.append(f"channel {stated.channel}: the summary says {stated.recorded} items, the file has {has}")
        return [*wrong, *self.differences]


class _Found:
    """Gathers the findings about one file while its parts come."""

    def __init__(self, reader: FileReader) -> None:
        self.reader, self.stated = reader, reader.summary_if_readable()
        self.tally, self.counts = FileTally(self.stated), ContentCounts()
        self.damages: list[Damage] = []
        self.damaged_bytes = self.unknown = 0
        self.outer_bytes = 0  # damaged bytes before the summary, outside of known chunks
        self.has_inner_damage = False  # whether a part before the summary is damaged
        self.has_summary = False  # whether a record of a summary has come

    def damage(self, part: Damage) -> None:
        length = part.end - part.offset
        self.damaged_bytes += length
        if not self.has_summary:
            self.has_inner_damage = True
            self.outer_bytes += length if part.times == (None, None) else 0
        self.tally.damage(part.times, f"the file is damaged at byte {part.offset}: {part.detail}")
        if len(self.damages) < DAMAGES_KEPT_MAX:
            self.damages.append(part)

    def add(self, part: ChunkContent | Attachment | Metadata) -> None:
        self.counts.add(part)
        if isinstance(part, ChunkContent):
            self.unknown += part.unknown
        elif isinstance(part, Metadata) and part.name == SUMMARY_NAME:
            self.has_summary = True

    def report(self, take: Callable[[Event], None]) -> FileReport:
        """Return the findings. Passes the gaps that the file does not name to `take`."""
        reader, stated = self.reader, self.stated
        for gap in self.tally.ends():
            take(gap)
        differences = self.counts.differences(reader.index, foreign_only=stated is not None)
        losses = self._unnamed_losses(stated)
        losses += [f"the contents of {reader.path!r} do not agree with the index: {one}" for one in differences]
        summary = _with_losses(self.tally.summary(reader.path), stated, losses)
        if not summary.damaged and not self.has_inner_damage and not reader.data_is_whole:
            summary = replace(summary, damaged=(_changed(reader.path),))
        return FileReport(
            summary=summary, stated=stated, damages=tuple(self.damages), damaged_bytes=self.damaged_bytes,
            finished=reader.index is not None, unknown=self.unknown, size_bytes=reader.size,
            data_is_whole=reader.data_is_whole, differences=tuple(differences),
        )  # fmt: skip

    def _unnamed_losses(self, stated: RecordingSummary | None) -> list[str]:
        """Return the losses that no gap names, as texts."""
        reader, losses = self.reader, [] if stated is None else [*stated.damaged]
        has_own, file = self.tally.has_own, f"the file {reader.path!r}"
        if self.damages and stated is None:
            what = f"{self.damaged_bytes} bytes of {file} were damaged" if self.damaged_bytes else f"{file} had no end"
            losses.append(f"{what}, so items of channels that it does not name may be missing")
        elif stated is None and reader.index is None and (has_own or not reader.states_no_index):
            what = "summary" if has_own else "index"
            losses.append(f"the {what} of {file} cannot be read, so it may lack items without a gap")
        elif reader.index is None and self.outer_bytes:
            losses.append(f"{self.outer_bytes} bytes of {file} were damaged: perhaps attachments or metadata")
        if reader.index is None or not reader.data_is_whole:
            channels = self.tally.disordered
            losses += [f"the items of channel {one} are not in the order in which it had them" for one in channels]
        if self.unknown:
            losses.append(f"{self.unknown} messages of {file}, which does not name their topics")
        return losses


def scan_file(
    reader: FileReader,
    take: Callable[[Event | Attachment | Metadata], None],
    on_bytes: Callable[[int], object],
    is_repeated: Callable[[Event], bool] = lambda _: False,
) -> FileReport:
    """Read a file to its end, and pass what it holds to `take`, with the gaps that damage has made.

    Leaves out the events that are repeated. Calls `on_bytes` after each chunk, with the byte at which it ends.
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


def _changed(path: str) -> str:
    return (
        f"the bytes around the messages of the file {path!r} do not have their checksum, so attachments, metadata or "
        "the order of the messages may have changed"
    )


def _with_losses(found: RecordingSummary, stated: RecordingSummary | None, losses: list[str]) -> RecordingSummary:
    """Add the losses that no gap of a channel names. `stated`: the summary in the file."""
    by_key = {(one.channel, one.incarnation): one for one in found.channels}
    for counts in stated.channels if stated else ():
        one = by_key.get((counts.channel, counts.incarnation))
        has = 0 if one is None else one.recorded + sum(recorded_between(gap, counts) for gap in one.gaps)
        if has < counts.recorded:
            missing = counts.recorded - has
            losses.append(f"{missing} items of channel {counts.channel}, which the summary of the file names")
    return replace(found, absent=() if stated is None else tuple(stated.absent), damaged=tuple(losses[:LOSSES_MAX]))
