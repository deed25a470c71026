"""The items, gaps and advances that one write appends to the files of a channel."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import NamedTuple

from stampede_rt.wire.run_slices import RunSlicer
from stampede_rt_channel_host.core.archive import ArchivedAdvance, ArchivedRun
from stampede_rt_channel_host.core.channel import make_run


class MissingSeqs(NamedTuple):
    """Seqs whose items the archive does not have: `first_seq` up to `end_seq`, exclusive.

    `lost_before`, if stated: items before this instant were lost with a host, and their seqs are not known.
    """

    first_seq: int
    end_seq: int
    lost_before: int | None = None


class Advances(NamedTuple):
    """Advances of the channel, in the order of their acceptance. `seq`: the seq of the next item to write."""

    seq: int
    rows: tuple[ArchivedAdvance, ...]


WrittenPart = Sequence[ArchivedRun] | MissingSeqs | Advances


def by_instants(joined: ArchivedRun) -> Iterator[ArchivedRun]:
    """A run for each instant of acceptance, because a block has one instant for each run."""
    if joined.rows is None:
        yield joined
        return
    run, slicer = joined.run, RunSlicer(bytes(joined.run.body))
    lo = max(0, joined.begin - run.first_seq)
    for end_seq, accepted in zip(*joined.rows, strict=True):
        hi = len(run) if end_seq == joined.rows.ends[-1] else end_seq - run.first_seq
        durations = None if run.durations is None else run.durations[lo:hi]
        part = make_run(run.first_seq + lo, run.times[lo:hi], durations, run.lengths[lo:hi], slicer.cut(lo, hi))
        yield ArchivedRun(accepted, part)
        lo = hi
