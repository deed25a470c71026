"""A recorded channel that moves between hosts: the segments of several owners have some items twice."""

from __future__ import annotations

import random
from collections.abc import Sequence

from stampede_rt_channel_host.core.archive import (
    ArchivedRun,
    PlacedBlock,
    Segment,
    SegmentBlocks,
    TimeRange,
    summary,
)
from stampede_rt_channel_host.core.archive.stored_segment import below
from stampede_rt_channel_host.core.channel import Run, make_run
from tests.property.archived_channel import ArchivedChannel


class MovedChannel(ArchivedChannel):
    """An `ArchivedChannel` whose owner changes. The channel has one archive, as in an object store."""

    def move(self, draw: random.Random) -> None:
        """Let a new owner go on. It writes again the last items that memory holds, from any of them on.

        The segments of the former owners then lack these items, as the host leaves them out.
        """
        self.archive()
        begin = draw.randrange(self._held_from(), self.channel.next_seq + 1)
        rewritten = [self._from(part.run, begin) for part in self.channel.accepted_from(begin)]
        self._leave_out(begin)
        per_segment, self._per_segment = self._per_segment, 0
        for run in dict.fromkeys(run.first_seq for run in rewritten):  # the first block begins a segment
            self._append([self._runs[run]])
            self._per_segment = per_segment
        self._per_segment = per_segment

    def _held_from(self) -> int:
        """The seq after the last hole in memory."""
        first = self.channel.next_seq
        for part in reversed([*self.channel.accepted_from(0)]):
            if part.end_seq < first:
                break
            first = min(first, part.first_seq)
        return first

    def _from(self, run: Run, begin: int) -> Run:
        """The run without its items before `begin`, as the archive then has it."""
        at = max(0, begin - run.first_seq)
        if at:
            durations = None if run.durations is None else run.durations[at:]
            accepted = self._accepted[run.first_seq]
            run = make_run(begin, run.times[at:], durations, run.lengths[at:], b"%d" % begin)
            self._runs[begin], self._accepted[begin] = run, accepted
        return run

    def _leave_out(self, begin: int) -> None:
        """Leave out the items from the seq `begin` on."""
        kept: list[Segment] = []
        for one in self.segments:
            blocks = below(self._blocks[one.number], one.length, begin)
            short = summary(one.number, one.length, blocks) if any(placed.head.items for placed in blocks) else None
            if short is not None:
                self._blocks[one.number] = blocks
                kept.append(short._replace(first_seq=one.first_seq))
        self.segments = kept

    def _archived_runs_of(
        self, segment: Segment, block: PlacedBlock, within: TimeRange | None = None
    ) -> list[ArchivedRun]:
        runs = super()._archived_runs_of(segment, block, within)
        if runs:
            runs[-1] = runs[-1].below(block.head.end_seq, lambda body, begin, end: body)
        return runs

    def _written_blocks_of(self, segment: Segment) -> SegmentBlocks:
        blocks: Sequence[PlacedBlock] = self._blocks[segment.number]
        return SegmentBlocks(blocks)
