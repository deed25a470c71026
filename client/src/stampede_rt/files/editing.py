"""Verifies, recovers and cuts files. Each function holds one chunk of each file in memory."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from typing import TypedDict

from mcap.records import Attachment, Metadata

from stampede_rt.errors import FileError, InvalidArgument
from stampede_rt.files.chunk_content import ChunkContent, Event
from stampede_rt.files.entries import FileAdvance, FileEntry
from stampede_rt.files.file_tally import FileTally, recorded_between
from stampede_rt.files.framing import Damage
from stampede_rt.files.interval_filter import IntervalFilter
from stampede_rt.files.reading import FileReader
from stampede_rt.files.seq_ranges import SeqRanges
from stampede_rt.files.summaries import SUMMARY_NAME, summary_fields, summary_of
from stampede_rt.files.writing import FileWriter, replacing
from stampede_rt.values.recording import RecordingGap, RecordingSummary

DAMAGES_KEPT_MAX = 1000
LOSSES_MAX = 1000
"""The most texts of `RecordingSummary.damaged`."""


@dataclass(frozen=True, kw_only=True, slots=True)
class FileReport:
    """The findings of `verify` or `recover` about a file that it has read to its end.

    `damages` has the first 1000 parts that cannot be read. `finished`: the file has the index that its writer
    writes last. `unknown` counts messages of topics that the file does not name. `stated` is the recorder's own
    summary; None if the file has none that can be read. `data_is_whole`: the bytes before the index have the stated
    checksum; True also if nobody has checked it, as in `recover`.
    """

    summary: RecordingSummary
    stated: RecordingSummary | None
    damages: Sequence[Damage]
    damaged_bytes: int
    finished: bool
    unknown: int
    size_bytes: int
    data_is_whole: bool = True

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
        """Where the file disagrees with its summary, or with its checksum."""
        found = {(one.channel, one.incarnation): one for one in self.summary.channels}
        wrong = []
        if not self.data_is_whole and not self.damages:
            wrong.append(
                "the messages can be read, but the bytes around them do not have their checksum; `stampede file "
                "recover` writes the messages to a file with new indexes"
            )
        for told in self.stated.channels if self.stated else ():
            one = found.get((told.channel, told.incarnation))
            has = 0 if one is None else one.recorded
            if has != told.recorded:
                wrong.append(f"channel {told.channel}: the summary says {told.recorded} items, the file has {has}")
        return wrong


def verify(path: str | os.PathLike[str], on_bytes: Callable[[int], object] = lambda _: None) -> FileReport:
    """Read a whole file, and check every checksum.

    Calls `on_bytes` after each chunk, with the position of its end in the file. Raises FileError.
    """
    with FileReader(path) as reader:
        return replace(_walk(reader, lambda _: None, on_bytes), data_is_whole=reader.data_is_whole())


def recover(path: str | os.PathLike[str], output: str | os.PathLike[str], *, overwrite: bool = False) -> FileReport:
    """Copy the readable part of a torn or damaged file to `output`, with an index, and name the lost items.

    A file that was cut off at any byte loses at most its last chunk. Raises FileError. After an error there is no
    new `output`, and a former one stays.
    """
    check_other(path, output)
    with FileReader(path) as reader:
        if reader.index is None and not _has_content(reader):
            raise FileError(
                f"nothing can be recovered from the file {reader.path!r}: it is an MCAP file of {reader.size} bytes, "
                "without a whole chunk; its writer ended before its first chunk, or the file is damaged from there on; "
                "no file was written"
            )
        with replacing(output, overwrite=overwrite) as writer:
            report = _walk(reader, writer_of(writer), lambda _: None, _Repeated())
            finish_with(writer, report.summary)
    return report


class _Repeated:
    """Tells whether an item has come already. A faulty copy of a file may have a chunk twice."""

    def __init__(self) -> None:
        self._seqs: dict[tuple[str, int], SeqRanges] = {}

    def __call__(self, event: Event) -> bool:
        if not isinstance(event, FileEntry) or event.seq is None or event.topic.incarnation is None:
            return False
        seqs = self._seqs.setdefault((event.topic.name, event.topic.incarnation), SeqRanges())
        return not seqs.add(event.seq)


def _has_content(reader: FileReader) -> bool:
    return any(isinstance(part, ChunkContent | Attachment) for part in reader.contents())


def check_other(path: str | os.PathLike[str], output: str | os.PathLike[str]) -> None:
    """Raise InvalidArgument if `output` is the file `path`."""
    if os.path.exists(output) and os.path.samefile(path, output):
        raise InvalidArgument(f"the output {os.fspath(output)!r} is the file to read; name another one")


def writer_of(writer: FileWriter) -> Callable[[Event | Attachment | Metadata], None]:
    """Return a function that writes the events of a reader. It leaves out summaries, which the caller writes anew."""

    def write(event: Event | Attachment | Metadata) -> None:
        if isinstance(event, FileEntry):
            writer.add((event,))
        elif isinstance(event, RecordingGap):
            writer.add_gap(event)
        elif isinstance(event, FileAdvance):
            writer.add_advance(event)
        elif isinstance(event, Attachment):
            writer.add_attachment(event.log_time, event.create_time, event.name, event.media_type, event.data)
        elif event.name != SUMMARY_NAME:
            writer.add_metadata(event.name, event.metadata)

    return write


def finish_with(writer: FileWriter, summary: RecordingSummary) -> None:
    """Write the summary, if it is needed, and finish the file.

    It is needed for a channel of Stampede RT, and for a loss that no gap names.
    """
    own = [one for one in summary.channels if one.incarnation]
    if own or summary.damaged:
        written = replace(summary, channels=own)
        writer.add_metadata(SUMMARY_NAME, summary_fields(written))
    writer.finish()


def _walk(
    reader: FileReader,
    take: Callable[[Event | Attachment | Metadata], None],
    on_bytes: Callable[[int], object],
    is_repeated: Callable[[Event], bool] = lambda _: False,
) -> FileReport:
    """Read a file to its end, and pass what it holds to `take`, with the gaps that damage has made.

    Leaves out the events that are repeated.
    """
    tally, damaged_bytes, unknown, last = FileTally(), 0, 0, None
    damages: list[Damage] = []
    for part in reader.contents():
        if isinstance(part, Damage):
            damaged_bytes += part.end - part.offset
            tally.damage(part.times)
            if len(damages) < DAMAGES_KEPT_MAX:
                damages.append(part)
        elif isinstance(part, ChunkContent):
            unknown += part.unknown
            for event in part.in_host_order():
                if is_repeated(event):
                    continue
                for gap in tally.add(event):
                    take(gap)
                take(event)
            on_bytes(part.end)
        else:
            last = part if isinstance(part, Metadata) and part.name == SUMMARY_NAME else last
            take(part)
    stated = _stated(reader, last)
    if damages:
        for gap in tally.ends_torn(_detail(damages[0]), _detail(damages[-1]), stated):
            take(gap)
    losses = [] if stated is None else [*stated.damaged]
    if damages and stated is None:
        losses.append(_unnamed_loss(reader.path, damaged_bytes))
    elif stated is None and reader.index is None and tally.has_own:
        losses.append(f"the summary of the file {reader.path!r} cannot be read, so it may lack items without a gap")
    if unknown:
        losses.append(f"{unknown} messages of the file {reader.path!r}, which does not name their topics")
    return FileReport(
        summary=_with_losses(tally.summary(reader.path), stated, losses), stated=stated, damages=tuple(damages),
        damaged_bytes=damaged_bytes, finished=reader.index is not None, unknown=unknown, size_bytes=reader.size,
    )  # fmt: skip


def _detail(damage: Damage) -> str:
    return f"the file is damaged at byte {damage.offset}: {damage.detail}"


def _unnamed_loss(path: str, damaged_bytes: int) -> str:
    what = (
        f"{damaged_bytes} bytes of the file {path!r} were damaged" if damaged_bytes else f"the file {path!r} had no end"
    )
    return f"{what}, so items of channels that it does not name may be missing"


def _with_losses(found: RecordingSummary, stated: RecordingSummary | None, losses: list[str]) -> RecordingSummary:
    """Add the losses that no gap of a channel names. `stated`: the summary in the file."""
    by_key = {(one.channel, one.incarnation): one for one in found.channels}
    for told in stated.channels if stated else ():
        one = by_key.get((told.channel, told.incarnation))
        has = 0 if one is None else one.recorded + sum(recorded_between(gap, told) for gap in one.gaps)
        if has < told.recorded:
            losses.append(f"{told.recorded - has} items of channel {told.channel}, which the summary of the file names")
    return replace(found, absent=() if stated is None else tuple(stated.absent), damaged=tuple(losses[:LOSSES_MAX]))


def _stated(reader: FileReader, last: Metadata | None) -> RecordingSummary | None:
    """Return the summary in a file; None if there is none that can be read.

    `last`: the last record of a summary that the reading has met; None: take the record that the index names.
    """
    try:
        return reader.summary() if last is None else summary_of(reader.path, last.metadata)
    except FileError:
        return None


def cut(
    path: str | os.PathLike[str],
    output: str | os.PathLike[str],
    *,
    start: int,
    end: int,
    chosen: Callable[[str], bool] = lambda _: True,
    overwrite: bool = False,
) -> RecordingSummary:
    """Copy the items of the chosen channels with a time from `start` on and before `end`. Raises FileError.

    Copies all metadata and attachments, too, except the summary. Reads the whole file. Refuses a damaged file: recover
    it first.
    """
    check_other(path, output)
    with FileReader(path) as reader, replacing(output, overwrite=overwrite) as writer:
        tally, write = FileTally(), writer_of(writer)

        def take(event: Event) -> None:
            tally.add(event)
            write(event)

        chosen_part = IntervalFilter(start, end, chosen, take)
        for part in intact_contents(reader):
            if isinstance(part, ChunkContent):
                for event in part.in_host_order():
                    chosen_part.add(event)
            else:
                write(part)
        chosen_part.finish()
        summary = tally.summary(os.fspath(output), **losses_of([reader]))
        finish_with(writer, summary)
    return summary


class UnnamedLosses(TypedDict):
    """The losses of files that no gap names (see `RecordingSummary`)."""

    absent: tuple[str, ...]
    damaged: tuple[str, ...]


def losses_of(readers: Iterable[FileReader]) -> UnnamedLosses:
    """Return the losses of a file that is made of these files. Raises FileError."""
    told = [summary for one in readers if (summary := one.summary())]
    absent = dict.fromkeys(text for summary in told for text in summary.absent)
    damaged = dict.fromkeys(text for summary in told for text in summary.damaged)
    return UnnamedLosses(absent=tuple(absent)[:LOSSES_MAX], damaged=tuple(damaged)[:LOSSES_MAX])


def intact_contents(reader: FileReader) -> Iterator[ChunkContent | Attachment | Metadata]:
    """Yield the chunks, attachments and metadata of a file.

    Raises FileError at the first damage, at a message whose topic the file does not name, and if the end of the file is
    missing.
    """
    if reader.index is None and not reader.states_no_index:
        raise FileError(
            f"the end of the file {reader.path!r} is missing or damaged, so it may lack items; `stampede file recover` "
            "saves the readable part"
        )
    for part in reader.contents():
        if isinstance(part, Damage):
            raise FileError(
                f"the file {reader.path!r} is damaged at byte {part.offset}: {part.detail}; "
                "`stampede file recover` saves the readable part"
            )
        if isinstance(part, ChunkContent):
            reader.check_named(part)
        yield part
