"""Says which reads of a recorded channel may need its archive."""

from __future__ import annotations

from stampede_rt.values.timeline import MetaTime
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.core.archive import ArchiveSpan, needs_archive, resolved_now, span_of
from stampede_rt_channel_host.core.channel import ChannelCore, ItemKey, Query
from stampede_rt_channel_host.core.group import Horizon, reaches_archive


class ArchiveReach:
    """The times and seqs of one channel's archive, and the reads that may need it."""

    def __init__(self, recorder: ChannelRecorder, channel: ChannelCore) -> None:
        self._recorder = recorder
        self._channel = channel

    @property
    def may_read(self) -> bool:
        """Whether the archive has items, the archive may get items of a former owner, or memory has lost items that the
        archive does not have.
        """
        recorder = self._recorder
        return bool(recorder.segments or recorder.lost_items or recorder.former.are_expected)

    @property
    def span(self) -> ArchiveSpan:
        """The times of the archived items. Before the first write the archive begins with the next seq to write."""
        recorder = self._recorder
        return recorder.span if recorder.segments else span_of((), recorder.archived_to)

    @property
    def _expected_span(self) -> ArchiveSpan:
        """The span after the write under way. Before the first write: the lost items that this write may save."""
        span, backlog = self.span, self._channel.backlog
        if span.oldest is not None or not backlog.at_risk or backlog.lost_times is None:
            return span
        return ArchiveSpan(*backlog.lost_times, is_cut=span.is_cut, begins_anew=span.begins_anew)

    @property
    def kept_from(self) -> int:
        """The lowest seq of an item in the archive or in memory. Without items: the next seq to archive."""
        segments, held = self._recorder.segments, next(iter(self._channel.accepted_from(0)), None)
        archived_from = segments[0].first_seq if segments else self._recorder.archived_to
        return archived_from if held is None else min(archived_from, held.first_seq)

    def includes(self, query: Query, now: int) -> bool:
        """Whether a read may need items that only the archive has."""
        if not self.may_read:
            return False
        held, _ = self._channel.look(now)
        within = resolved_now(held, self._expected_span, query, now)
        if within is None:
            return False
        is_older = self._expects_older(held.newest_collected, query)
        return is_older or needs_archive(held, self._expected_span, query, within)

    def includes_in_group(self, query: Query, horizon: Horizon, now: int) -> bool:
        """Whether a read through a group may need items that only the archive has."""
        if not self.may_read:
            return False
        held, _ = self._channel.look(now)
        is_older = self._expects_older(held.newest_collected, query)
        return is_older or reaches_archive(held, self._expected_span, query, horizon, now)

    def _expects_older(self, newest_collected: int | None, query: Query) -> bool:
        """Whether a bound of the query is OLDEST, and files of a former owner with older items may still come."""
        bounds = query.interval.start.meta, query.interval.end.meta
        return newest_collected is not None and MetaTime.OLDEST in bounds and self._recorder.former.are_expected

    def resolved_start(self, query: Query, now: int) -> tuple[int, int | None] | None:
        """The instant at which a subscription begins, and the first seq that it gets from the archive, or None if
        memory has all its items. `query`: its interval is the start. None: no item is known.
        """
        held, _ = self._channel.look(now)
        within = resolved_now(held, self._expected_span, query, now)
        if within is None:
            return None
        if held.newest_collected is None or within.start > held.newest_collected:
            return within.start, None
        return within.start, self._first_archived_seq((within.start, 0))

    def _first_archived_seq(self, low: ItemKey) -> int | None:
        """The first seq in the archive of an item that may have a key from `low` on, also of a missing item."""
        end_seq, seqs = 0, list[int]()
        for one in self._recorder.segments:
            if one.low is not None and one.high is not None:
                if one.high >= low:  # the missing items before the segment may have times from the start on, too
                    seqs.append(end_seq if end_seq and one.low > low else one.first_seq)
                end_seq = one.end_seq
        seqs += [self._recorder.archived_to] if self._recorder.lost_items else []
        return min(seqs, default=None)
