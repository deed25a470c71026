"""A channel of the core with a small memory and an archive of small blocks, read window by window, as a host does."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import Bound, MetaTime, ResolvedInterval
from stampede_rt_channel_host.core import archive
from stampede_rt_channel_host.core.archive import (
    ArchivedAdvance,
    ArchivedRead,
    ArchivedRun,
    ArchiveSpan,
    BlockHead,
    BlocksOf,
    PastFacts,
    PlacedBlock,
    Segment,
    SegmentBlocks,
    TimeRange,
    WantedWindow,
)
from stampede_rt_channel_host.core.channel import (
    FIRST_KEY,
    AllCursor,
    ChannelCore,
    ChannelSnapshot,
    Offer,
    Position,
    PutOutcome,
    Query,
    ReadAnswer,
    Run,
    SubscriptionBatch,
    make_run,
    run_to_end,
)
from stampede_rt_channel_host.core.group import Horizon, RecordedStep, RecordedView, VisibleAllCursor
from stampede_rt_channel_host.core.group.recorded_track import Reads

FoundBlocks = Callable[[Segment], SegmentBlocks]
ContentOf = Callable[[Segment, PlacedBlock], bytes]


class ArchivedChannel:
    """Puts items, archives them when the caller says so, and reads them over archive and memory."""

    def __init__(self, policy: Policy, *, runs_per_block: int, blocks_per_segment: int) -> None:
        self.channel = ChannelCore(policy, incarnation=7)
        self.channel.record(1)
        self.now = 0
        self.loads = self.loaded_max = 0  # the windows loaded, and the most bytes of one
        self._per_block, self._per_segment = runs_per_block, blocks_per_segment
        self._archived_to = 1
        self._runs: dict[int, Run] = {}  # by first seq
        self._accepted: dict[int, int] = {}  # by first seq
        self.advances: list[tuple[int, int]] = []  # the instant of each acceptance, and the advance
        self._unwritten: list[ArchivedAdvance] = []
        self._advance: ArchivedAdvance | None = None
        self.offers: list[tuple[int, Offer]] = []  # each accepted offer, with the instant of its acceptance
        self._blocks: dict[int, list[PlacedBlock]] = {}  # by the number of the segment
        self._files: dict[int, bytes] = {}
        self.segments: list[Segment] = []
        self._read_blocks: FoundBlocks = self._written_blocks_of
        self._content_of: ContentOf = self._written_content_of
        self.step: RecordedStep | None = None  # the step of the subscription through a group

    def put(self, offer: Offer, now: int) -> PutOutcome:
        self.now = max(self.now, now)
        outcome = self.channel.put(offer, now, lambda first_seq, kept, stamped: b"%d" % first_seq)
        if outcome.run is not None:
            self._accepted[outcome.run.first_seq] = now
            self.offers.append((now, offer))
        return outcome

    def file(self, segment: Segment) -> bytes:
        """The bytes of a segment's file."""
        return self._files[segment.number]

    def read_from(self, blocks_of: FoundBlocks, content_of: ContentOf) -> None:
        """Read the files from another place from now on."""
        self._read_blocks, self._content_of = blocks_of, content_of

    @property
    def first_accepted(self) -> int:
        """The instant at which the channel accepted the first item."""
        return min(self._accepted.values(), default=0)

    def archive(self) -> None:
        """Write all accepted items that the archive does not have."""
        if self._unwritten:
            self._append_block(*archive.encode_advances(self._unwritten, self._archived_to, (0, 0)))
            self._advance, self._unwritten = self._unwritten[-1], []
        runs = list(dict.fromkeys(part.run for part in self.channel.accepted_from(self._archived_to)))
        for run in runs:
            self._runs[run.first_seq] = run
        for at in range(0, len(runs), self._per_block):
            self._append(runs[at : at + self._per_block])
        self._archived_to = self.channel.next_seq
        self.channel.record(self._archived_to)
        self.channel.collect(self.now)

    def advance(self, instant: int, now: int) -> None:
        self.now = max(self.now, now)
        before = self.channel.advanced_to
        if self.channel.advance(instant, now) != before:
            self.advances.append((now, instant))
            self._unwritten.append(ArchivedAdvance(now, instant))

    def _append(self, runs: list[Run]) -> None:
        self._append_block(*archive.encode_items([ArchivedRun(self._accepted[run.first_seq], run) for run in runs]))

    def _append_block(self, head: BlockHead, parts: list[bytes]) -> None:
        if not self.segments or len(self._blocks[self.segments[-1].number]) >= self._per_segment:
            number = self.segments[-1].number + 1 if self.segments else 0
            self._blocks[number], self._files[number] = [], b""
            self.segments.append(Segment(number, 0, 0, head.first_seq, head.first_seq, None, None, 0))
            if self._advance is not None:
                self._place(*archive.encode_advances([self._advance], head.first_seq, (0, 0)))
        self._place(head, parts)

    def _place(self, head: BlockHead, parts: list[bytes]) -> None:
        segment = self.segments[-1]
        self._blocks[segment.number].append(PlacedBlock(len(self._files[segment.number]), head))
        self._files[segment.number] += b"".join(parts)
        self.segments[-1] = archive.grown(segment, head)

    def read(self, query: Query) -> ReadAnswer:
        """The answer, in as many requests as a host would need. As at a host, memory alone answers if it can."""
        span, (held, _) = span_of(self.segments), self.channel.look(self.now)
        within = archive.resolved_now(held, span, query, self.now)
        if within is not None and not archive.needs_archive(held, span, query, within):
            return self.channel.read(query, self.now)
        moment = self.channel.snapshot(self.now)
        try:
            return self._read(query, moment, self.segments, self._blocks_of)
        finally:
            moment.close()

    def load(self, reads: Reads) -> None:
        """Perform the reads of a search that needs archived items."""
        found: ArchivedRead | None = None
        while True:
            try:
                query = reads.send(found) if found is not None else next(reads)
            except StopIteration:
                return
            found = self.performed(query)

    def performed(self, query: Query) -> ArchivedRead:
        """One read, of one request."""
        moment, span = self.channel.snapshot(self.now), span_of(self.segments)
        try:
            within = archive.resolved(moment, span, query)
            assert within is not None, "the bounds are instants"
            read = ArchivedRead(moment, span, query, within)
            self._perform(read, self.segments, self._blocks_of)
            return read
        finally:
            moment.close()

    def view(self, query: Query, horizon: Horizon, within: ResolvedInterval | None = None) -> RecordedView:
        """The answer to one request of a get that may wait, with the items before a group's cut."""
        moment = self.channel.snapshot(self.now)
        try:
            view = RecordedView(moment, span_of(self.segments), query, horizon)
            for read in view.reads(within, waits=True):
                self._perform(read, self.segments, self._blocks_of)
            return view
        finally:
            moment.close()

    def take_in_group(self, place: VisibleAllCursor, horizon: Horizon, limit_bytes: int) -> SubscriptionBatch:
        """The next part of a subscription through a group, from the archive if memory does not have it."""
        step = self.step = self.step or place.unheld_step(horizon, self.now)
        if step is None:
            return place.take(horizon, self.now, limit_bytes)
        if step.late is not None:
            self._find_late(step, limit_bytes)
        elif not step.is_read:
            view = self.view(step.query, Horizon(step.target, lambda: "the step"))
            step.take_page(
                view.answer, continues=view.continues, missing_items=view.missing_items, kept_from=self.kept_from()
            )
        batch = step.batch(limit_bytes)
        if step.is_over and batch.is_empty:
            self.step = None
            place.skip_to(step, self.now)
        return replace(batch, more=True)

    def kept_from(self) -> int:
        """The lowest seq of an item."""
        return min(one.first_seq for one in (*self.segments, *self.channel.accepted_from(0)))

    def _find_late(self, step: RecordedStep, limit_bytes: int) -> None:
        assert step.late is not None
        held, _ = self.channel.look(self.now)
        end = held.held_up_to(*step.late, 4)
        if end == step.late[0] and end < self._archived_to:
            part = self._load_part((end, min(step.late[1], self._archived_to)), limit_bytes)
            found = part.items.slices_by_seq(*step.late, FIRST_KEY)
            step.take_late(
                found, lambda time: archive.next_time_of(part, held.next_time, time), part.end_seq, self.kept_from()
            )
        else:
            step.take_late(held.slices_by_seq(step.late[0], end), held.next_time, end, self.kept_from())

    def _load_part(self, missing: tuple[int, int], limit_bytes: int) -> archive.ArchivedPart:
        chosen = archive.choose_part(self.segments, self._blocks_of, missing, bytes_max=limit_bytes)
        runs = [run for segment, block in (*chosen.blocks, *chosen.among) for run in self._runs_of(segment, block)]
        return archive.part_of(runs, chosen)

    def read_in_group(self, query: Query, horizon: Horizon) -> ReadAnswer:
        """The answer with the items before a group's cut, in as many requests as a host would need."""
        within, left, answers = None, query, []
        while True:
            view = self.view(left, horizon, within)
            within = view.within
            answers.append(view.answer)
            if not view.continues:
                return joined(answers, down=query.newest_first)
            left = rest_of(left, view.answer)

    def past(self, as_of: int) -> archive.PastArchive:
        """The archive as of an earlier instant."""
        return archive.past_of(self.segments, self._blocks_of, self._archived_runs_of, self._advances_of, as_of)

    def read_in_group_as_of(self, query: Query, horizon: Horizon, as_of: int) -> ReadAnswer:
        """The answer as of an earlier instant, with the items before a group's cut, in as many requests as a host would
        need.
        """
        past, within, left, answers = self.past(as_of), None, query, []
        facts = PastFacts(self.channel.policy, self.channel.incarnation, past.advance, None, None)
        while True:
            span = span_of(past.segments)
            view = RecordedView(archive.past_moment(facts, past, span, as_of), span, left, horizon)
            for read in view.reads(within):
                self._perform(read, past.segments, past.blocks_of(self._blocks_of))
            answers.append(view.answer)
            if not view.continues:
                return joined(answers, down=query.newest_first)
            within, left = view.within, rest_of(left, view.answer)

    def read_as_of(self, query: Query, as_of: int) -> ReadAnswer:
        """The answer as of an earlier instant, in as many requests as a host would need."""
        past = self.past(as_of)
        span = span_of(past.segments)
        facts = PastFacts(self.channel.policy, self.channel.incarnation, past.advance, None, None)
        moment = archive.past_moment(facts, past, span, as_of)
        if span.newest is None:
            within = archive.resolved(moment, span, query)
            if archive.is_nothing_left(self.segments, past, has_dropped=self.is_cut):
                return archive.nothing_left(self.segments, past, within, as_of, self.channel.incarnation)
            return run_to_end(archive.read_nothing(moment, query, within))
        return self._read(query, moment, past.segments, past.blocks_of(self._blocks_of))

    @property
    def is_cut(self) -> bool:
        """Whether the archive has dropped items."""
        return bool(self.segments) and self.segments[0].first_seq > 1

    def drop_segments(self, count: int) -> None:
        """Drop the oldest segments, but never the last one, as the limits of an archive do."""
        del self.segments[: min(count, len(self.segments) - 1)]

    def _read(
        self, query: Query, moment: ChannelSnapshot, segments: Sequence[Segment], blocks_of: BlocksOf
    ) -> ReadAnswer:
        span = span_of(segments)
        within = archive.resolved(moment, span, query)
        assert within is not None, "the scenario puts an item first"
        answers = []
        while True:
            read = ArchivedRead(moment, span, query, within)
            self._perform(read, segments, blocks_of)
            answers.append(answer := read.answer())
            if not read.continues:
                return joined(answers, down=query.newest_first)
            query = rest_of(query, answer)
            if query.interval.end.meta is MetaTime.NOW:  # as the client does; meanwhile time passes
                query = replace(query, now=within.end - query.interval.end.offset)
                moment.clock += 1

    def _perform(self, read: ArchivedRead, segments: Sequence[Segment], blocks_of: BlocksOf) -> None:
        run_to_end(read.begin())
        while (wanted := read.next_window()) is not None:
            run_to_end(read.take(self._load(wanted, segments, blocks_of)))

    def subscribe(self, start: int) -> AllCursor:
        """A subscription to the items from the time `start` on."""
        held, _ = self.channel.look(self.now)
        reach = [one.first_seq for one in self.segments if one.high is not None and one.high >= (start, 0)]
        archived = held.newest_collected is not None and start <= held.newest_collected
        return run_to_end(
            self.channel.subscribing_all(
                self.now, start=Bound(None, start), archived_from=min(reach) if archived and reach else None
            )
        )

    def take(self, cursor: AllCursor, limit_bytes: int) -> SubscriptionBatch:
        """The next part of a subscription, from the archive if memory does not have it."""
        missing = self.channel.missing(cursor, self.now)
        if missing is None:
            return self.channel.since(cursor, self.now, limit_bytes)
        part = self._load_part(missing, limit_bytes)
        held, _ = self.channel.look(self.now)
        kept_from = self.segments[0].first_seq if self.segments else self.channel.next_seq
        return archive.deliver(cursor, missing, part, held.next_time, kept_from, limit_bytes)

    def _blocks_of(self, segment: Segment) -> SegmentBlocks:
        return self._read_blocks(segment)

    def _written_blocks_of(self, segment: Segment) -> SegmentBlocks:
        return SegmentBlocks(self._blocks[segment.number])

    def _written_content_of(self, segment: Segment, block: PlacedBlock) -> bytes:
        return self._files[segment.number][block.offset + archive.HEAD_BYTES : block.end]

    def _archived_runs_of(
        self, segment: Segment, block: PlacedBlock, within: TimeRange | None = None
    ) -> list[ArchivedRun]:
        content = self._content_of(segment, block)
        assert archive.is_whole(block.head, content)
        return archive.decode_items(block.head, content, self._decode, within)

    def _advances_of(self, segment: Segment, block: PlacedBlock) -> list[ArchivedAdvance]:
        content = self._content_of(segment, block)
        return archive.decode_advances(content)

    def _runs_of(self, segment: Segment, block: PlacedBlock, within: TimeRange | None = None) -> list[Run]:
        return [one.run for one in self._archived_runs_of(segment, block, within)]

    def _load(self, wanted: WantedWindow, segments: Sequence[Segment], blocks_of: BlocksOf) -> archive.ArchiveWindow:
        self.loads += 1
        chosen = archive.choose(segments, blocks_of, wanted.wanted)
        self.loaded_max = max(self.loaded_max, sum(one.head.length for _, one in chosen.blocks))
        runs = []
        for segment, block in sorted(chosen.blocks, key=lambda one: one[1].head.first_seq):
            runs += self._runs_of(segment, block, wanted.wanted.times)
        return archive.window_of(runs, chosen, wanted.low, wanted.high, down=wanted.wanted.down)

    def _decode(self, body: bytes) -> Run:
        run = self._runs[int(body)]
        return make_run(run.first_seq, run.times, run.durations, run.lengths, body)


def rest_of(query: Query, answer: ReadAnswer) -> Query:
    """The query of the next page, as a reader makes it."""
    last = answer.slices[0] if query.newest_first else answer.slices[-1]
    at = last.lo if query.newest_first else last.hi - 1
    position = Position(last.run.times[at], last.run.first_seq + at)
    left = None if query.limit is None else query.limit - sum(one.items for one in answer.slices)
    return replace(query, after=position, limit=left)


def span_of(segments: Sequence[Segment]) -> ArchiveSpan:
    lows = [one.low[0] for one in segments if one.low is not None]
    highs = [one.high[0] for one in segments if one.high is not None]
    is_cut = bool(segments) and segments[0].first_seq > 1
    return ArchiveSpan(min(lows, default=None), max(highs, default=None), is_cut=is_cut)


def joined(answers: list[ReadAnswer], *, down: bool) -> ReadAnswer:
    """The answers of several requests as one, as a reader joins them."""
    first, last = answers[0], answers[-1]
    slices = [one for answer in (reversed(answers) if down else answers) for one in answer.slices]
    following = first.next_time if down else next((one.next_time for one in reversed(answers) if one.slices), None)
    next_times = {key: time for answer in answers for key, time in answer.next_times.items()}
    for answer in answers:
        if answer.slices and answer.next_time is not None:
            next_times[answer.slices[-1].last_time, answer.slices[-1].end_seq] = answer.next_time
    hidden = last.reason if last.reason == "HIDDEN" else None
    reason = last.reason if down and first.truncated and not last.more else first.reason or hidden
    return first._replace(slices=slices, next_time=following, more=last.more, reason=reason, next_times=next_times)
