"""The needs of blocked gets, and how far new items reach. A change polls only the gets that it may release. Pure.

A new item may release a get if the item's time, or under the match mode `span` its span, reaches the get's interval.
The channel also releases a get when it has passed the interval. A poll of a get looks at all visible items. So if the
get stays blocked, later changes poll it only for items that come, or become visible, after that poll.
"""

from __future__ import annotations

from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, LAST_KEY, SEQ_END
from stampede_rt_channel_host.core.channel.run import ABSENT

if TYPE_CHECKING:
    from stampede_rt_channel_host.core.channel.channel import ChannelCore
    from stampede_rt_channel_host.core.channel.holdings import Holdings

BEFORE_ALL, AFTER_ALL = FIRST_KEY[0], LAST_KEY[0]
"""An instant before the times of all items, and one after them."""
_BUCKET_PARTS_MAX = 16
"""If a bucket has more slices, `_bucket_end` does not look at its spans."""


class Needs(NamedTuple):
    """The events that may release a get. A field is None if its kind of event does not release the get.

    `passed`: the channel passes this instant: an item, an advance or the frontier reaches it. `time`: an item comes
    with this time or a later time. `end`: an item comes whose span lasts until this instant or longer.
    """

    passed: int | None = None
    time: int | None = None
    end: int | None = None


class Reach(NamedTuple):
    """How far a channel and its new items reach. An item is new if it came, or became visible, after the last `Reach`.

    A field is None if there is no such instant. `passed`: the latest instant that the channel has passed. `time`: the
    latest time of a new item. `end`: the latest span end of a new item. An instant may be too late, which only costs an
    extra poll. It is never too early.
    """

    passed: int | None
    time: int | None
    end: int | None


class ReachTracker:
    """Computes the `Reach` of a channel, or of its part before a cut, for the gets that wait at the channel.

    Each call looks at the items that came after the last call.
    """

    def __init__(self, channel: ChannelCore) -> None:
        self._channel = channel
        self._seen_seq = 1
        self._cut = AFTER_ALL

    def begin(self, cut: int = AFTER_ALL) -> None:
        """Note that the polls of all gets have seen the present items before the cut."""
        self._seen_seq, self._cut = self._channel.next_seq, cut

    def reach(self, now: int, cut: int = AFTER_ALL) -> Reach:
        """The reach of the channel, and of the items that came, or became visible, after the last call.

        Items at or after `cut` are not visible.
        """
        held, _ = self._channel.look(now)
        before, time = self._cut, self._newly_visible(held, cut)
        self.begin(cut)
        newest = held.newest if cut == AFTER_ALL else held.last_time_up_to(cut - 1)
        end = None
        if time is not None or cut != before:
            end = self._end(held, time, newest, min(now, cut), has_moved=cut != before)
        if before == BEFORE_ALL != cut:
            time = cut  # the group's first cut: it may release each get that needs an earlier time
        return Reach(self._passed(held, cut), time, end)

    def _passed(self, held: Holdings, cut: int) -> int | None:
        """The latest instant that the channel has passed: a visible item, an advance or the frontier has reached it."""
        marks = [mark for mark in (held.newest, self._channel.advanced_to, held.newest_consumed) if mark is not None]
        passed = [min(max(marks), cut)] if marks else []
        return max([*passed, *([] if held.frontier is None else [held.frontier])], default=None)

    def _newly_visible(self, held: Holdings, cut: int) -> int | None:
        """The latest time of an item that came, or became visible, after the last call; or None."""
        found = []
        for part in held.slices_by_seq(self._seen_seq, self._channel.next_seq):
            if part.first_time < cut:
                found.append(min(part.last_time, cut - 1))
        shown = held.last_time_up_to(cut - 1) if cut > self._cut else None
        if shown is not None and shown >= self._cut:
            found.append(shown)
        return max(found, default=None)

    def _end(self, held: Holdings, time: int | None, newest: int | None, now: int, *, has_moved: bool) -> int | None:
        """The reach of the new items' spans, and, if the cut has moved, of the newest visible item's span."""
        if newest is None:
            return time
        if held.overlap_nanos:
            return max(_bucket_end(held, newest, now), newest + held.overlap_nanos)
        if has_moved or (time is not None and time >= newest):
            return held.newest_end(now) if newest == held.newest else _bucket_end(held, newest, now)
        following = None if time is None else held.next_time(time)
        return newest if following is None else following


def _bucket_end(held: Holdings, time: int, now: int) -> int:
    """The latest span end of the bucket at `time`, as if no later bucket ended the spans.

    Returns AFTER_ALL for a large bucket, without a look at each item.
    """
    end = time
    parts = list(islice(held.slices((time, 0), (time, SEQ_END)), _BUCKET_PARTS_MAX + 1))
    if len(parts) > _BUCKET_PARTS_MAX or sum(part.items for part in parts) > 256:
        return AFTER_ALL
    for part in parts:
        durations = part.run.durations
        for duration in (ABSENT,) if durations is None else durations[part.lo : part.hi]:
            end = max(end, now if duration == ABSENT else time + duration)
    return end
