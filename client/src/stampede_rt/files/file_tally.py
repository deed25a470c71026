"""Counts the items of each channel in a file, and the items lost to damage. Pure."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from stampede_rt.files.entries import FileAdvance, FileEntry, Topic
from stampede_rt.files.seq_ranges import SeqRanges
from stampede_rt.files.time_bounds import TimeBounds, joined_times
from stampede_rt.values.recording import GAPS_KEPT_MAX, RecordedCounts, RecordingGap, RecordingSummary
from stampede_rt.values.seq_starts import given_between

DAMAGED = "DAMAGED"
Key = tuple[str, int | None]


@dataclass(slots=True)
class _Counts:
    recorded: int = 0
    payload_bytes: int = 0
    missing: int = 0
    gap_count: int = 0
    gaps: list[RecordingGap] = field(default_factory=list)
    first_seq: int | None = None
    last_seq: int | None = None  # the greatest
    reached: int = 0  # the greatest seq that an item or a gap has named
    start: int | None = None
    end: int | None = None
    advance: int | None = None
    has_fallen: bool = False  # whether an item came after an item with a later seq
    damaged_after: int | None = None  # damage came after this seq, and no later item has come
    damaged_times: TimeBounds = (None, None)  # the times of this damage
    damaged_before: TimeBounds | None = None  # the times of the damage before the first item; None: there was none


class FileTally:
    """Counts entries, gaps and advances in the order of a file.

    After `damage` the next seq of each channel shows how many of its items the damage may have taken. `intended`: the
    summary of the recorder, if the file still has it; it says where each channel began and ended.
    """

    def __init__(self, intended: RecordingSummary | None = None) -> None:
        self._known: dict[Key, RecordedCounts] = {
            (one.channel, one.incarnation): one for one in (intended.channels if intended else ())
        }
        self._counts: dict[Key, _Counts] = {}
        self._damaged_so_far: TimeBounds | None = None
        self._first_damage = self._last_damage = ""
        self.foreign: dict[Topic, int] = {}  # messages of topics that are not channels of Stampede RT

    def add(self, event: FileEntry | RecordingGap | FileAdvance) -> list[RecordingGap]:
        """Count one event. Returns the gaps before this event that the file does not name."""
        if isinstance(event, RecordingGap):
            self._add_gap(event)
            return []
        if isinstance(event, FileAdvance):
            counts = self._of((event.channel, event.incarnation))
            counts.advance = event.time if counts.advance is None else max(counts.advance, event.time)
            return []
        return self._add_entry(event)

    def _add_entry(self, entry: FileEntry) -> list[RecordingGap]:
        counts = self._of((entry.topic.name, entry.topic.incarnation))
        counts.recorded += 1
        counts.payload_bytes += len(entry.data)
        counts.start = entry.time if counts.start is None else min(counts.start, entry.time)
        counts.end = entry.time if counts.end is None else max(counts.end, entry.time)
        if entry.topic.incarnation is None:
            self.foreign[entry.topic] = self.foreign.get(entry.topic, 0) + 1
        if entry.seq is None:
            return []
        revealed = self._lost_before(entry, counts) if counts.first_seq is None else []
        if counts.damaged_after is not None and entry.seq > counts.damaged_after:
            if entry.seq > counts.damaged_after + 1:
                revealed.append(
                    self._damaged(entry.topic, counts.damaged_after + 1, entry.seq - 1, counts.damaged_times)
                )
            counts.damaged_after = None
        counts.first_seq = entry.seq if counts.first_seq is None else min(counts.first_seq, entry.seq)
        counts.has_fallen = counts.has_fallen or (counts.last_seq is not None and entry.seq < counts.last_seq)
        counts.last_seq = entry.seq if counts.last_seq is None else max(counts.last_seq, entry.seq)
        counts.reached = max(counts.reached, entry.seq)
        return revealed

    def _damaged(self, topic: Topic, first_seq: int, last_seq: int, times: TimeBounds) -> RecordingGap:
        items: int | None = last_seq - first_seq + 1
        detail = f"a damaged part of the file had at most these {items} items"
        if given_between(first_seq, last_seq + 1) != items:
            items, detail = None, "a damaged part of the file may have had items of two owners of the channel"
        gap = RecordingGap(
            channel=topic.name, incarnation=topic.incarnation or 0, reason=DAMAGED, first_seq=first_seq,
            last_seq=last_seq, items=items, detail=detail, start=times[0], end=times[1],
        )  # fmt: skip
        self._add_gap(gap)
        return gap

    def _add_gap(self, gap: RecordingGap) -> None:
        counts = self._of((gap.channel, gap.incarnation))
        counts.missing += gap.items or 0
        counts.gap_count += 1
        counts.reached = max(counts.reached, gap.last_seq or 0)
        if len(counts.gaps) < GAPS_KEPT_MAX:
            counts.gaps.append(gap)

    def damage(self, times: TimeBounds = (None, None), detail: str = "") -> None:
        """Note that a part of the file is damaged here. `times`: the bounds of the times of its items."""
        self._first_damage, self._last_damage = self._first_damage or detail, detail
        so_far = self._damaged_so_far
        self._damaged_so_far = times if so_far is None else joined_times(so_far, times)
        for key, counts in self._counts.items():
            if key[1] is None:
                continue
            if counts.damaged_after is None:
                counts.damaged_after, counts.damaged_times = counts.reached, times
            else:
                counts.damaged_times = joined_times(counts.damaged_times, times)

    def ends(self) -> list[RecordingGap]:
        """End the file. Returns the gaps after the last item of each channel, and those that only the summary has."""
        gaps = []
        for key, counts in self._counts.items():
            if key[1] is not None:
                gaps += self._lost_behind(key, counts, self._known.get(key))
        for key, stated in self._known.items() if self._damaged_so_far is not None else ():
            if key not in self._counts and stated.recorded:
                times = (stated.start, stated.end)
                gaps.append(_gap(key, self._last_damage, stated.first_seq, stated.last_seq, stated.recorded, times))
        for gap in gaps:
            self._add_gap(gap)
        return gaps + self._gaps_without_chunk()

    def _gaps_without_chunk(self) -> list[RecordingGap]:
        """Count the gaps of the summary of the recorder that the file lacks, and return them.

        Their chunk was lost. A gap of damage may have counted their items. A summary has at most GAPS_KEPT_MAX gaps of
        each channel.
        """
        gaps = []
        for key, planned in self._known.items():
            counts = self._counts.get(key, _Counts())
            if counts.gap_count == len(counts.gaps):
                known, named = set(counts.gaps), _seqs_of(counts.gaps)
                gaps += [one for one in planned.gaps if one not in known and not _is_within(one, named)]
        for gap in gaps:
            self._add_gap(gap)
        return gaps

    def _lost_before(self, first: FileEntry, counts: _Counts) -> list[RecordingGap]:
        """Count and return the gap before the first item of a channel, if damage came before it."""
        times, seq = counts.damaged_before, first.seq or 0
        if counts.damaged_after == 0:  # the file has an advance of the channel, and then the damage
            times = counts.damaged_times if times is None else joined_times(times, counts.damaged_times)
            counts.damaged_after = None
        key = (first.topic.name, first.topic.incarnation)
        stated = self._known.get(key)
        begin, items = (None, None) if stated is None else (stated.first_seq, _lost_at_most(seq, stated))
        if times is None or seq == 1 or (stated is not None and (begin is None or begin >= seq)):
            return []
        gap = _gap(key, self._first_damage, begin, seq - 1, items, times)
        self._add_gap(gap)
        return [gap]

    def _lost_behind(self, key: Key, counts: _Counts, stated: RecordedCounts | None) -> list[RecordingGap]:
        """Return the gap after the last item, if damage came there."""
        if counts.damaged_after is None:
            return []
        first = counts.damaged_after + 1
        if stated is None:
            return [_gap(key, self._last_damage, first, None, None, (counts.damaged_times[0], None))]
        if stated.last_seq is None or stated.last_seq < first:
            return []
        items = min(_recorded_at_most(first, stated.last_seq, stated), max(0, stated.recorded - counts.recorded))
        return [_gap(key, self._last_damage, first, stated.last_seq, items, counts.damaged_times)]

    @property
    def disordered(self) -> list[str]:
        """The channels of which an item came after an item with a later seq."""
        return sorted({key[0] for key, counts in self._counts.items() if counts.has_fallen})

    @property
    def has_own_channels(self) -> bool:
        """Whether the file has a channel of Stampede RT, and not only topics of other programs."""
        return any(key[1] is not None for key in self._counts)

    def summary(self, path: str, absent: tuple[str, ...] = (), damaged: tuple[str, ...] = ()) -> RecordingSummary:
        """Return the counts of the channels of Stampede RT and of other topics, by name.

        `absent`, `damaged`: see `RecordingSummary`.
        """
        found = [_channel(key, counts) for key, counts in self._counts.items()]
        found.sort(key=lambda one: (one.channel, one.start or 0))
        return RecordingSummary(path=path, channels=tuple(found), absent=absent, damaged=damaged)

    def _of(self, key: Key) -> _Counts:
        counts = self._counts.get(key)
        if counts is None:
            counts = self._counts[key] = _Counts(damaged_before=self._damaged_so_far)
        return counts


def _gap(
    key: Key, detail: str, first: int | None, last: int | None, items: int | None, times: TimeBounds
) -> RecordingGap:
    return RecordingGap(
        channel=key[0], incarnation=key[1] or 0, reason=DAMAGED, detail=detail, first_seq=first, last_seq=last,
        items=items, start=times[0], end=times[1],
    )  # fmt: skip


def _lost_at_most(seq: int, stated: RecordedCounts) -> int:
    """Return the greatest number of items of the summary `stated` before its item `seq`."""
    found = 0 if stated.first_seq is None else _recorded_at_most(stated.first_seq, seq - 1, stated)
    return min(found, max(0, stated.recorded - 1))


def recorded_in_gap(gap: RecordingGap, stated: RecordedCounts) -> int:
    """Return the number of items that the recorder had written with the seqs of a gap of damage; 0 for another gap.

    `stated`: the recorder's counts of the channel. The number is too great if the recorder did not name the other seqs.
    """
    if gap.reason != DAMAGED or gap.first_seq is None or gap.last_seq is None:
        return 0
    return min(gap.items or 0, _recorded_at_most(gap.first_seq, gap.last_seq, stated))


def _recorded_at_most(first_seq: int, last_seq: int, stated: RecordedCounts) -> int:
    """Return how many seqs between two seqs, inclusive, are not in a gap that the recorder has named."""
    named = _seqs_of(stated.gaps)
    return sum(given_between(first, last + 1) for first, last in named.missing(first_seq, last_seq))


def _seqs_of(gaps: Iterable[RecordingGap]) -> SeqRanges:
    """Return the seqs of the gaps that have one item for each of their seqs."""
    named = SeqRanges()
    for gap in gaps:
        if gap.first_seq is not None and gap.last_seq is not None and gap.items == gap.last_seq - gap.first_seq + 1:
            named.add_range(gap.first_seq, gap.last_seq)
    return named


def _is_within(gap: RecordingGap, seqs: SeqRanges) -> bool:
    if gap.first_seq is None or gap.last_seq is None:
        return False
    return next(seqs.missing(gap.first_seq, gap.last_seq), None) is None


def _channel(key: Key, counts: _Counts) -> RecordedCounts:
    return RecordedCounts(
        channel=key[0], incarnation=key[1] or 0, accepted=counts.recorded + counts.missing, recorded=counts.recorded,
        missing=counts.missing, gaps=tuple(counts.gaps), gap_count=counts.gap_count, payload_bytes=counts.payload_bytes,
        first_seq=counts.first_seq, last_seq=counts.last_seq, start=counts.start, end=counts.end,
        advance=counts.advance,
    )  # fmt: skip
