"""The items of a recorded channel: the items of a window of its archive, and after them the items in memory. Pure."""

from __future__ import annotations

from collections.abc import Sequence

from stampede_rt.values.seq_starts import given_between
from stampede_rt_channel_host.core.archive.segment import Segment
from stampede_rt_channel_host.core.archive.window import ArchiveWindow
from stampede_rt_channel_host.core.channel.channel_snapshot import HoldingsSnapshot
from stampede_rt_channel_host.core.channel.held_items import ARCHIVE
from stampede_rt_channel_host.core.channel.index import ChannelIndex
from stampede_rt_channel_host.core.channel.index_snapshot import IndexSnapshot
from stampede_rt_channel_host.core.channel.item_keys import LAST_KEY, ItemKey


class ArchiveSpan:
    """The facts that an archive keeps in memory.

    `oldest` and `newest` are times, or None if the archive is empty. `is_cut`: the archive has dropped items before the
    oldest one. `begins_anew`: it begins with an owner that did not know the seqs of the former owners, so it does not
    show whether it has dropped items.
    """

    __slots__ = ("begins_anew", "is_cut", "newest", "oldest")

    def __init__(self, oldest: int | None, newest: int | None, *, is_cut: bool, begins_anew: bool = False) -> None:
        self.oldest = oldest
        self.newest = newest
        self.is_cut = is_cut
        self.begins_anew = begins_anew

    def has_dropped(self, lost_before: int | None, lost_from: int | None) -> bool:
        """Whether the archive has dropped items before the oldest one, as far as the host can know.

        `lost_before`, `lost_from`: the channel's (see `QueryReader`). With `lost_from` the archive had items of the
        former owners. If all items before `lost_before` may be lost, reads say LOST for them.
        """
        tells_loss = lost_before is not None and lost_from is None
        return self.is_cut or (self.begins_anew and not tells_loss)


def span_of(segments: Sequence[Segment], begin: int = 1) -> ArchiveSpan:
    """The times between which the segments have items. `begin`: the first seq of an archive without segments."""
    lows = [one.low[0] for one in segments if one.low is not None]
    highs = [one.high[0] for one in segments if one.high is not None]
    first_seq = segments[0].first_seq if segments else begin
    is_cut = given_between(1, first_seq) > 0
    begins_anew = first_seq > 1 and not is_cut
    return ArchiveSpan(min(lows, default=None), max(highs, default=None), is_cut=is_cut, begins_anew=begins_anew)


def earliest(one: int | None, other: int | None) -> int | None:
    """The earlier of two times. None stands for a missing time."""
    return one if other is None else other if one is None else min(one, other)


def latest(one: int | None, other: int | None) -> int | None:
    """The later of two times. None stands for a missing time."""
    return one if other is None else other if one is None else max(one, other)


class RecordedItems:
    """Items of an archive and of memory as reads see them (`ReadableItems`). The archive has the items below `border`.

    `held` are the items in memory at one moment. The caller must not use this object after it has closed the moment.
    """

    collected_by = ARCHIVE

    def __init__(self, held: HoldingsSnapshot, span: ArchiveSpan, window: ArchiveWindow, *, has_dropped: bool) -> None:
        """`has_dropped`: see `ArchiveSpan.has_dropped`."""
        self._held = held
        self._window = window
        self._items: ChannelIndex = window.items
        self.border = held.floor
        self.overlap_nanos = held.overlap_nanos
        self.oldest = earliest(held.oldest, span.oldest)
        self.newest = latest(held.newest, span.newest)
        kept_from = held.frontier if span.oldest is None else span.oldest
        self.frontier = kept_from if has_dropped else None
        self.gone_before = None if self.frontier is None else self.frontier + self.overlap_nanos

    @property
    def end(self) -> ItemKey:
        """A key above the keys of all visible items."""
        return LAST_KEY if self._window.end is None else self._window.end

    def snapshot(self) -> IndexSnapshot:
        """A snapshot of the items of the window and of the items in memory."""
        snapshot = self._held.snapshot()
        snapshot.begin_with(self._items, self.border, self._window.following)
        return snapshot

    def next_time(self, time: int) -> int | None:
        """The time of the next bucket after `time`, or None if there is none."""
        found = [self._items.next_time(time), self._window.following, self._held.next_time(time)]
        return min((one for one in found if one is not None and one > time), default=None)

    def last_time_up_to(self, time: int) -> int | None:
        """The time of the last visible bucket at or before `time`, or None if there is none.

        This bucket may be the first one of the next window.
        """
        following = self._window.following
        if self._window.end is not None and following is not None and following <= time:
            return following
        held = None if self._window.end is not None else self._held.last_time_up_to(time)
        return self._items.last_time_up_to(time) if held is None else held
