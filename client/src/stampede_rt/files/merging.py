"""Merges files. Holds one chunk of each file, the ranges of all seqs, and at most 64 MiB of items that must wait."""

from __future__ import annotations

import hashlib
import heapq
import os
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack
from dataclasses import replace
from itertools import combinations, groupby

from mcap.records import Attachment, Metadata

from stampede_rt.errors import InvalidArgument
from stampede_rt.files.chunk_content import ChunkContent, Event
from stampede_rt.files.editing import check_other, finish_with, writer_of
from stampede_rt.files.entries import FileAdvance, FileEntry
from stampede_rt.files.file_tally import FileTally
from stampede_rt.files.intact import intact_contents, losses_of
from stampede_rt.files.reading import FileReader
from stampede_rt.files.seq_order import SeqOrder
from stampede_rt.files.seq_ranges import SeqRanges
from stampede_rt.files.writing import replacing
from stampede_rt.values.recording import RecordingGap, RecordingSummary

MERGED_MAX = 64  # files
Ranges = dict[tuple[str, int], SeqRanges]
Times = dict[tuple[str, int], tuple[int, int]]  # the least and the greatest time of the items


def merge(
    paths: Sequence[str | os.PathLike[str]],
    output: str | os.PathLike[str],
    *,
    overwrite: bool = False,
    warn: Callable[[str], object] = lambda _: None,
) -> RecordingSummary:
    """Write the items of several files to one, each item once. An item of one file fills the gap of another.

    The items of a channel are written in the order of their seqs, also late items, as long as at most 64 MiB of items
    must wait for earlier ones. Metadata and attachments come once, too. Calls `warn` with a sentence for each channel
    of which the output may have items twice, under two incarnations.

    Raises FileError, also if a file is damaged; InvalidArgument.
    """
    if not 1 <= len(paths) <= MERGED_MAX:
        raise InvalidArgument(f"{len(paths)} files cannot be merged; give 1 to {MERGED_MAX}")
    for path in paths:
        check_other(path, output)
    held, times = _seqs_of(paths)
    with ExitStack() as stack:
        readers = [stack.enter_context(FileReader(path)) for path in paths]
        writer = stack.enter_context(replacing(output, overwrite=overwrite))
        tally, write, merged = FileTally(), writer_of(writer), _Merged(held)

        def take(event: Event) -> None:
            if merged.is_new(event):
                tally.add(event)
                write(event)

        order = SeqOrder(held, take)
        for _, _, part in heapq.merge(*map(_by_time, range(len(readers)), readers), key=lambda one: one[:2]):
            if isinstance(part, Attachment | Metadata):
                if merged.is_new_record(part):
                    write(part)
                continue
            for kept in merged.new_parts(part):
                order.add(kept)
        order.finish()
        summary = tally.summary(os.fspath(output), **losses_of(readers))
        finish_with(writer, summary)
    for text in _repetitions(held, times):
        warn(text)
    return summary


def _repetitions(held: Ranges, times: Mapping[tuple[str, int], tuple[int, int]]) -> Iterator[str]:
    """Yield a sentence for each two incarnations of a channel that have seqs and times in common.

    After a crash the archive of a channel gives its items under the next incarnation. Only the host knows this.
    """
    in_order = sorted(held, key=lambda key: (key[0], *times[key]))
    for _, keys in groupby(in_order, key=lambda key: key[0]):
        for one, other in combinations(keys, 2):
            common = held[one].common(held[other]) if times[other][0] <= times[one][1] else 0
            if common:
                yield (
                    f"channel {one[0]!r} may have up to {common} items twice: its incarnations {one[1]} and {other[1]} "
                    "have these seqs, and times in common, as after a crash of a host whose archive had kept the items"
                )


def _seqs_of(paths: Sequence[str | os.PathLike[str]]) -> tuple[Ranges, Times]:
    """Return the seqs of the items in all files together, and their times."""
    held: Ranges = {}
    times: Times = {}
    for path in paths:
        with FileReader(path) as reader:
            for part in intact_contents(reader):
                for entry in part.entries if isinstance(part, ChunkContent) else ():
                    if entry.seq is not None and entry.topic.incarnation is not None:
                        key = (entry.topic.name, entry.topic.incarnation)
                        held.setdefault(key, SeqRanges()).add(entry.seq)
                        least, greatest = times.get(key, (entry.time, entry.time))
                        times[key] = min(least, entry.time), max(greatest, entry.time)
    return held, times


def _by_time(number: int, reader: FileReader) -> Iterator[tuple[int, int, Event | Attachment | Metadata]]:
    """Yield each event as (time, number of the file, event). The time is the greatest so far, so it never falls."""
    latest = -(2**63)
    for part in intact_contents(reader):
        if not isinstance(part, ChunkContent):
            yield latest, number, part
            continue
        for event in part.in_host_order():
            if isinstance(event, FileEntry):
                latest = max(latest, event.time)
            yield latest, number, event


class _Merged:
    """Finds the parts of events that the output does not have yet. `held` has the seqs of the items in all files."""

    def __init__(self, held: Ranges) -> None:
        self._held = held
        self._items: Ranges = {}
        self._gaps: Ranges = {}
        self._open_gaps: set[RecordingGap] = set()  # the gaps of which a bound is not known
        self._advances: dict[tuple[str, int], int] = {}
        self._records: set[bytes] = set()

    def new_parts(self, event: Event) -> Iterator[Event]:
        """Yield the new part of an event: nothing for a repeated item, and for a gap the part that no file has."""
        if isinstance(event, FileEntry):
            foreign = event.seq is None or event.topic.incarnation is None
            key = (event.topic.name, event.topic.incarnation or 0)
            if foreign or self._items.setdefault(key, SeqRanges()).add(event.seq or 0):
                yield event
        elif isinstance(event, RecordingGap):
            key = (event.channel, event.incarnation)
            held, reported = self._held.get(key, SeqRanges()), self._gaps.setdefault(key, SeqRanges())
            yield from _remaining(event, held, reported)
        else:
            yield event

    def is_new(self, event: Event) -> bool:
        """Whether the output lacks an event, which comes in the order of the output.

        An advance adds nothing if it is not later than the advance before it.
        """
        if isinstance(event, FileAdvance):
            key = (event.channel, event.incarnation)
            former = self._advances.get(key)
            self._advances[key] = event.time if former is None else max(former, event.time)
            return former is None or event.time > former
        if isinstance(event, RecordingGap) and (event.first_seq is None or event.last_seq is None):
            known = event in self._open_gaps
            self._open_gaps.add(event)
            return not known
        return True

    def is_new_record(self, record: Attachment | Metadata) -> bool:
        """Whether the output lacks an attachment or metadata."""
        content = record.data if isinstance(record, Attachment) else b""
        text = repr(replace(record, data=b"") if isinstance(record, Attachment) else record)
        digest = hashlib.sha256(text.encode() + hashlib.sha256(content).digest()).digest()
        known = digest in self._records
        self._records.add(digest)
        return not known


def _remaining(gap: RecordingGap, held: SeqRanges, reported: SeqRanges) -> Iterator[RecordingGap]:
    first, last = gap.first_seq, gap.last_seq
    if first is not None and last is None:
        gap = replace(gap, first_seq=held.end_from(first))
    if first is None or last is None:
        yield gap  # a gap without a bound cannot be compared with the items
        return
    parts = [part for begin, end in held.missing(first, last) for part in reported.missing(begin, end)]
    for begin, end in parts:
        reported.add_range(begin, end)
    if parts and gap.items != last - first + 1:  # nobody knows which of these seqs an item had
        most = sum(end - begin + 1 for begin, end in parts)
        items = None if gap.items is None else min(gap.items, most)
        yield replace(gap, first_seq=parts[0][0], last_seq=parts[-1][1], items=items)
        return
    for begin, end in parts:
        yield replace(gap, first_seq=begin, last_seq=end, items=end - begin + 1)
