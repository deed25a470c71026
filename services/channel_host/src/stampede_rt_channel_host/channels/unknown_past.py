"""Decides which reads a host can answer after it took a channel over while the object store was unreachable."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt.errors import Unavailable
from stampede_rt.values.seq_starts import start_of
from stampede_rt.values.timeline import Match, MetaTime, ResolvedInterval
from stampede_rt_channel_host.archive.clean_stop import CleanStop
from stampede_rt_channel_host.archive.recorder import ChannelRecorder
from stampede_rt_channel_host.archive.segment_files import OpenedArchive
from stampede_rt_channel_host.channels.restored_channel import loss_after, lost_since
from stampede_rt_channel_host.core.archive import Segment, reaches, resolved_now, span_of
from stampede_rt_channel_host.core.archive.recorded_items import earliest
from stampede_rt_channel_host.core.channel import ChannelCore, Query
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.group import Horizon


class UnknownPast:
    """Says which reads have to wait until the host knows which items the store has.

    The former owners accepted all their items before the host took the channel over. The times of these items are
    therefore less than `max_future` after the take-over, and the host has all items with later times. With `is_fresh`
    the channel began here without items, at the first seq of its epoch. Otherwise the host had the channel before the
    channel was recorded, and knows which items have left its memory.
    """

    def __init__(self, channel: ChannelCore, epoch: int, found: OpenedArchive) -> None:
        """`found`: the files on the disk.

        If they include the note of a clean stop, the last items on the disk are known.
        """
        self.is_fresh = channel.next_seq == 1
        self._channel, self._first_seq, self._stop = channel, start_of(epoch), found.stop
        self._lost_before = channel.lost_before or 0
        self._since = self._lost_before
        self._newest: int | None = None  # the latest time of the known items on the disk
        self._is_listed = False
        if self.is_fresh:
            self._begin(found)
        self._since += ChannelLimits.of(channel.policy).max_future_nanos

    def _begin(self, found: OpenedArchive) -> None:
        """Let the channel begin without items in memory."""
        stop, next_seq, advance = found.stop, self._first_seq, None
        loss: tuple[int | None, int | None] = (None, self._channel.lost_before)
        if stop is not None and found.own is not None:
            self._newest, self._first_seq, self._since = stop.newest, found.own.first_seq, found.own.accepted
            loss = (stop.lost_from, stop.lost_before)
            advance = stop.advance if stop.incarnation == self._channel.incarnation else None
        self._channel.restore((), after=self._newest, next_seq=next_seq, loss=loss, advance=advance)

    def check(self, recorder: ChannelRecorder, query: Query, now: int, horizon: Horizon | None = None) -> None:
        """Raise Unavailable if the answer of a read may have items that only the store has.

        `horizon`: the horizon of the group through which to read.
        """
        if self.hides(recorder, query, now, horizon):
            raise self.error()

    def error(self) -> Unavailable:
        """The error of a read that needs the store."""
        return Unavailable(
            f"the host has taken channel {self._channel.name} over while the object store of its archive was "
            "unreachable, so it does not know yet which earlier items the store has; read again when the store is "
            'back, or read with within="memory"'
        )

    def move_error(self) -> Unavailable:
        """The error of a move. A new owner would not know that the store has earlier items, so this host refuses."""
        return Unavailable(
            f"the host has taken channel {self._channel.name} over while the object store of its archive was "
            "unreachable, so it does not know yet which earlier items the store has, and a new owner would not show "
            "them; move the channel when this host reaches the store",
            metadata={"channel": self._channel.name},
        )

    def hides(self, recorder: ChannelRecorder, query: Query, now: int, horizon: Horizon | None = None) -> bool:
        """Whether the answer of a read may have items that only the store has."""
        held, _ = self._channel.look(now)
        known = [one for one in recorder.segments if one.first_seq >= self._first_seq]
        oldest = earliest(held.oldest, span_of((*known,)).oldest)
        if horizon is not None:
            if horizon.cut is None:
                return False
            now = min(now, horizon.cut)
        within = resolved_now(held, recorder.span, query, now)
        if within is None or MetaTime.OLDEST in (query.interval.start.meta, query.interval.end.meta):
            return True
        last = within.end - within.end_exclusive
        last = last if horizon is None or horizon.cut is None else min(last, horizon.cut - 1)
        if not self.is_fresh:
            return reaches(held, min(within.start, last))
        is_begun = oldest is not None and oldest <= min(within.start, last)
        lasting = held.overlap_nanos if query.match is Match.SPAN else 0  # an item of a former owner may last so long
        if within.start >= self._since + lasting and (is_begun or query.match is not Match.SPAN):
            return False
        return not self._has_latest(held, query, within, last)

    def _has_latest(self, held: Holdings, query: Query, within: ResolvedInterval, last: int) -> bool:
        """Whether a read of the latest item up to `last` finds it in memory, or is sure to find it on the disk."""
        if not (query.newest_first and query.limit == 1 and query.after is None):
            return False
        found = held.last_time_up_to(last)
        if found is None and self._newest is not None and self._newest <= last:
            found = self._newest
        return found is not None and found >= max(within.start, self._since)

    def listed(self, stop: CleanStop | None) -> None:
        """Note that a listing has shown which items the store has. `stop`: the clean stop of the last owner."""
        self._is_listed = True
        self._stop = self._stop or stop

    def is_over(self, recorder: ChannelRecorder, now: int) -> bool:
        """Whether the host knows all items now. If so, only the archive has the earlier items from now on."""
        if not (self._is_listed and self.is_fresh):
            return self._is_listed
        former = tuple(one for one in recorder.segments if one.end_seq <= self._first_seq)
        edge, loss, stop = span_of(former).newest, self._loss(former), self._stop
        if edge is not None and self._newest is not None:
            edge = max(edge, self._newest)
        if edge is None:
            if stop is not None:
                self._channel.take_losses(self._channel.losses._replace(before=loss[1], since=loss[0]))
            return True
        return self._channel.leave_to_archive(edge, loss, now)

    def _loss(self, former: Sequence[Segment]) -> tuple[int | None, int | None]:
        """Two instants. Items of the former owners may be lost at or after the first one, and before the second one."""
        stop, since = self._stop, lost_since(former)
        if stop is None:
            return since, self._lost_before
        end_seq = max((one.end_seq for one in former), default=1)
        lost_from, lost_before = loss_after(stop, since, end_seq)
        if lost_from is None and self._newest is not None:  # this host stopped before it knew the former items
            lost_from = since
        return lost_from, lost_before
