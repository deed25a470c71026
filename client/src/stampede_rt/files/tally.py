"""Counts the items of one channel in a recording, and finds the missing ones. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt.values.model import Item
from stampede_rt.values.recording import GAPS_KEPT_MAX, NOT_READ, UNEXPLAINED, RecordedCounts, RecordingGap
from stampede_rt.values.seq_starts import given_between


class ChannelTally:
    """Counts the items and gaps of one incarnation of a channel.

    The host gives each accepted item the next seq. `live_seq` is the seq of the first item after the recording began.
    The recording must have an item or a gap for every seq from there on. So the tally finds missing items even if the
    host has reported no gap for them.
    """

    def __init__(self, channel: str, incarnation: int, live_seq: int) -> None:
        self.channel = channel
        self.incarnation = incarnation
        self._live_seq = live_seq
        self._end_seq = live_seq - 1  # the last seq that belongs to the recording, as known so far
        self._recorded = self._payload_bytes = 0
        self._live_recorded = 0  # the recorded items from `live_seq` on
        self._named = 0  # the number of missing items for which a gap was added
        self._gaps: list[RecordingGap] = []
        self._gap_count = 0
        self._first_seq: int | None = None
        self._last_seq: int | None = None
        self._start: int | None = None
        self._end: int | None = None
        self.advance: int | None = None
        self.written_to = live_seq - 1  # the last seq that the file has, or names as missing
        self.is_ended = False  # whether the channel's part of the recording has ended

    @property
    def recorded(self) -> int:
        """The number of items in the file."""
        return self._recorded

    @property
    def newest(self) -> int | None:
        """The greatest time of the items in the file; None: there is none."""
        return self._end

    @property
    def end_seq(self) -> int:
        """The last seq that belongs to the recording, as known so far."""
        return self._end_seq

    def add(self, items: Sequence[Item]) -> None:
        """Count items that are in the file now. Their seqs rise."""
        if not items:
            return
        times = [item.time for item in items]
        self._recorded += len(items)
        self._live_recorded += sum(item.seq >= self._live_seq for item in items)
        self._payload_bytes += sum(item.payload_length_bytes for item in items)
        self._first_seq = items[0].seq if self._first_seq is None else self._first_seq
        self._last_seq = items[-1].seq
        self._start = min(times) if self._start is None else min(self._start, *times)
        self._end = max(times) if self._end is None else max(self._end, *times)
        self.reaches(items[-1].seq)

    def add_gap(self, gap: RecordingGap) -> None:
        """Count a gap that is in the file now."""
        self._named += gap.items or 0
        self._gap_count += 1
        if len(self._gaps) < GAPS_KEPT_MAX:
            self._gaps.append(gap)
        if gap.last_seq is not None:
            self.reaches(gap.last_seq)

    def reaches(self, seq: int) -> None:
        """Note that the recording reaches at least to `seq`, inclusive."""
        self._end_seq = max(self._end_seq, seq)

    def ends(self, accepted_to: int, read_to: int) -> list[RecordingGap]:
        """End the recording at `accepted_to`, the seq of the last item that the host has accepted.

        `read_to`: the last seq that was read from the stream. Returns the gaps that the host has not reported: for
        items that were not read, and for items that are missing without a reason. The caller writes these gaps, and
        passes each of them to `add_gap`.
        """
        self.reaches(accepted_to)
        gaps, unread = [], given_between(read_to + 1, accepted_to + 1)
        if unread:
            detail = f"the recording ended before it had read seq {read_to + 1} to {accepted_to}"
            gaps.append(self._gap(NOT_READ, detail, read_to + 1, accepted_to, unread))
        if unexplained := max(0, self._live_missing() - self._named - unread):
            detail = f"the host accepted {unexplained} items more than it has sent or named as missing"
            gaps.append(self._gap(UNEXPLAINED, detail, self._live_seq, self._end_seq, unexplained))
        return gaps

    def _gap(self, reason: str, detail: str, first_seq: int, last_seq: int, items: int) -> RecordingGap:
        return RecordingGap(
            channel=self.channel, incarnation=self.incarnation, reason=reason, detail=detail, first_seq=first_seq,
            last_seq=last_seq, items=items,
        )  # fmt: skip

    def _live_missing(self) -> int:
        return self._end_seq - self._live_seq + 1 - self._live_recorded

    def counts(self) -> RecordedCounts:
        """Return the counts so far."""
        live = self._end_seq - self._live_seq + 1
        earlier = self._recorded - self._live_recorded  # items from the time before the recording
        return RecordedCounts(
            channel=self.channel, incarnation=self.incarnation, recorded=self._recorded,
            accepted=live + earlier + max(0, self._named - self._live_missing()),
            missing=max(self._named, self._live_missing()), gaps=tuple(self._gaps), gap_count=self._gap_count,
            payload_bytes=self._payload_bytes, first_seq=self._first_seq, last_seq=self._last_seq, start=self._start,
            end=self._end, advance=self.advance,
        )  # fmt: skip
