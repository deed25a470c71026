"""Reads by time from the files of archives of growing sizes, without a server: 64 B items in runs of 100."""

from __future__ import annotations

import os
import random
import shutil
from functools import partial
from pathlib import Path

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Bound, Interval
from stampede_rt.wire.runs import encode_run, seal_run
from stampede_rt_channel_host.archive.segment_files import ArchiveLimits, SegmentFiles
from stampede_rt_channel_host.copies.messages import run_of
from stampede_rt_channel_host.core.archive import ArchivedRead, ArchivedRun, Segment, resolved, span_of
from stampede_rt_channel_host.core.channel import ChannelCore, Query, run_to_end
from tests.benchmarks.archive_cost.figures import heading, percentile, row, seconds_of

RUN_ITEMS, RUNS_PER_WRITE, AT_TIMES = 100, 2000, 1000
US = 1000


def reading_files(folder: Path, largest: int) -> None:
    """Print the times of reads."""
    heading("items in files", "segments", "GB", "written, million items/s", "at(t), median", "at(t), p99")
    size = 10**5
    while size <= largest:
        files = SegmentFiles(folder, {})
        files.open(1)
        seconds = seconds_of(partial(fill, files, size))
        segments = files.drop_outdated(ArchiveLimits(None, None), 0)
        taken = read_times(files, segments, size)
        stored = sum(one.length for one in segments) / 1e9
        figures = (f"{percentile(taken, 0.5):.2f} ms", f"{percentile(taken, 0.99):.2f} ms")
        row(f"{size:,}", str(len(segments)), f"{stored:.2f}", f"{size / seconds / 1e6:.2f}", *figures)
        files.close(None)
        shutil.rmtree(folder)
        size *= 10


def fill(files: SegmentFiles, items: int) -> None:
    """Write this number of items, a microsecond apart."""
    payloads = [os.urandom(64)] * RUN_ITEMS
    runs: list[ArchivedRun] = []
    for seq in range(1, items + 1, RUN_ITEMS):
        times = [at * US for at in range(seq, seq + RUN_ITEMS)]
        runs.append(ArchivedRun(seq, run_of(seal_run(encode_run(payloads, times=times), seq))))
        if len(runs) == RUNS_PER_WRITE or seq + RUN_ITEMS > items:
            files.write([runs], ArchiveLimits(None, None))
            runs = []


def read_times(files: SegmentFiles, segments: tuple[Segment, ...], items: int) -> list[float]:
    """The milliseconds of reads at random times, as a host reads them; the first reads of each segment included."""
    core = ChannelCore(Policy(max_items=10), incarnation=7)
    core.restore((), after=items * US, next_seq=items + 1, loss=(None, None))
    draw, taken = random.Random(1), []
    for _ in range(AT_TIMES):
        number = draw.randrange(1, items)
        taken.append(seconds_of(partial(read_at, core, files, segments, number)) * 1e3)
    return taken


def read_at(core: ChannelCore, files: SegmentFiles, segments: tuple[Segment, ...], number: int) -> None:
    """Read the item of one time."""
    moment, span = core.snapshot(2**62), span_of(segments)
    query = Query(interval=Interval(Bound(None, number * US), Bound(None, number * US)))
    within = resolved(moment, span, query)
    assert within is not None, "the archive has items"
    read = ArchivedRead(moment, span, query, within)
    run_to_end(read.begin())
    while (wanted := read.next_window()) is not None:
        found = files.load_at_hand(segments, wanted, run_of)
        run_to_end(read.take(found or files.load(segments, wanted, run_of, lambda: None)))
    assert [one.first_seq for one in read.answer().slices] == [number]
    moment.close()
