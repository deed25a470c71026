"""Merges files. Holds one chunk of each file, the ranges of all seqs, and at most 64 MiB of items that must wait."""

from __future__ import annotations

import heapq
import os
from collections.abc import Iterator, Sequence
from contextlib import ExitStack
from dataclasses import replace

from stampede_rt.errors import InvalidArgument
from stampede_rt.files.editing import check_other, finish_with, intact_contents, losses_of, writer_of
from stampede_rt.files.entries import FileEntry
from stampede_rt.files.file_tally import FileTally
from stampede_rt.files.reading import Event, FileReader
from stampede_rt.files.seq_order import SeqOrder
from stampede_rt.files.seq_ranges import SeqRanges
from stampede_rt.files.writing import replacing
from stampede_rt.values.recording import RecordingGap, RecordingSummary

MERGED_MAX = 64  # files
Ranges = dict[tuple[str, int], SeqRanges]


def merge(
    paths: Sequence[str | os.PathLike[str]], output: str | os.PathLike[str], *, overwrite: bool = False
) -> RecordingSummary:
    """Write the items of several files to one, each item once. An item of one file fills the gap of another.

    The items of a channel are written in the order of their seqs, also late items, as long as at most 64 MiB of items
    must wait for earlier ones.

    Raises FileError, also if a file is damaged; InvalidArgument.
    """
    if not 1 <= len(paths) <= MERGED_MAX:
        raise InvalidArgument(f"{len(paths)} files cannot be merged; give 1 to {MERGED_MAX}")
    for path in paths:
        check_other(path, output)
    held = _seqs_of(paths)
    with ExitStack() as stack:
        readers = [stack.enter_context(FileReader(path)) for path in paths]
        writer = stack.enter_context(replacing(output, overwrite=overwrite))
        tally, write = FileTally(), writer_of(writer)
        seen: Ranges = {}

        def take(event: Event) -> None:
            tally.add(event)
            write(event)

        order = SeqOrder(held, take)
        for _, _, event in heapq.merge(*map(_by_time, range(len(readers)), readers), key=lambda one: one[:2]):
            for kept in _merged(event, seen, held):
                order.add(kept)
        order.finish()
        summary = tally.summary(os.fspath(output), damaged=losses_of(readers))
        finish_with(writer, summary)
    return summary


def _seqs_of(paths: Sequence[str | os.PathLike[str]]) -> Ranges:
    """Return the seqs of the items in all files together."""
    held: Ranges = {}
    for path in paths:
        with FileReader(path) as reader:
            for part in intact_contents(reader):
                for entry in part.entries:
                    if entry.seq is not None and entry.topic.incarnation is not None:
                        held.setdefault((entry.topic.name, entry.topic.incarnation), SeqRanges()).add(entry.seq)
    return held


def _by_time(number: int, reader: FileReader) -> Iterator[tuple[int, int, Event]]:
    """Yield each event as (time, number of the file, event). The time is the latest so far, so it never falls."""
    latest = -(2**63)
    for part in intact_contents(reader):
        for event in part.events():
            if isinstance(event, FileEntry):
                latest = max(latest, event.time)
            yield latest, number, event


def _merged(event: Event, seen: Ranges, held: Ranges) -> Iterator[Event]:
    """Yield the new part of one event: nothing for a repeated item, and for a gap the part that no file has."""
    if isinstance(event, FileEntry):
        foreign = event.seq is None or event.topic.incarnation is None
        key = (event.topic.name, event.topic.incarnation or 0)
        if foreign or seen.setdefault(key, SeqRanges()).add(event.seq or 0):
            yield event
    elif isinstance(event, RecordingGap):
        key = (event.channel, event.incarnation)
        told = seen.setdefault(
            (event.channel, -1 - event.incarnation), SeqRanges()
        )  # the gaps already written; the negative number keeps them apart from seen items
        yield from _remaining(event, held.get(key, SeqRanges()), told)
    else:
        yield event


def _remaining(gap: RecordingGap, held: SeqRanges, told: SeqRanges) -> Iterator[RecordingGap]:
    first, last = gap.first_seq, gap.last_seq
    if first is not None and last is None:
        gap = replace(gap, first_seq=held.end_from(first))
    if first is None or last is None:
        yield gap
        return
    whole = gap.items == last - first + 1
    for begin, end in held.missing(first, last):
        for start, stop in told.missing(begin, end):
            told.add_range(start, stop)
            items = stop - start + 1 if whole else min(gap.items or 0, stop - start + 1)
            yield RecordingGap(
                channel=gap.channel, incarnation=gap.incarnation, reason=gap.reason, detail=gap.detail,
                first_seq=start, last_seq=stop, items=items, start=gap.start, end=gap.end,
            )  # fmt: skip
