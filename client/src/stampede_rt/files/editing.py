"""Verifies, recovers and cuts files. Each function holds one chunk of each file in memory."""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import replace

from mcap.records import Attachment, Metadata

from stampede_rt.errors import FileError, InvalidArgument
from stampede_rt.files.chunk_content import ChunkContent, Event
from stampede_rt.files.entries import FileAdvance, FileEntry
from stampede_rt.files.file_report import FileReport, scan_file
from stampede_rt.files.file_tally import FileTally
from stampede_rt.files.intact import intact_contents, losses_of
from stampede_rt.files.interval_filter import IntervalFilter
from stampede_rt.files.reading import FileReader
from stampede_rt.files.seq_ranges import SeqRanges
from stampede_rt.files.summaries import SUMMARY_NAME, summary_fields
from stampede_rt.files.writing import FileWriter, replacing
from stampede_rt.values.recording import RecordingGap, RecordingSummary


def verify(path: str | os.PathLike[str], on_bytes: Callable[[int], object] = lambda _: None) -> FileReport:
    """Read a whole file, and check every checksum.

    Calls `on_bytes` after each chunk, with the position of its end in the file. Raises FileError.
    """
    with FileReader(path) as reader:
        return scan_file(reader, lambda _: None, on_bytes)


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
            report = scan_file(reader, writer_of(writer), lambda _: None, _Repeated())
            finish_with(writer, report.summary)
    return report


class _Repeated:
    """Recognizes an item that an earlier part of the file also has. A faulty copy of a file may have a chunk twice."""

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

    The summary is needed if the file has a channel of Stampede RT, or a loss that no gap names.
    """
    own = [one for one in summary.channels if one.incarnation]
    if own or summary.damaged:
        written = replace(summary, channels=own)
        writer.add_metadata(SUMMARY_NAME, summary_fields(written))
    writer.finish()


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
