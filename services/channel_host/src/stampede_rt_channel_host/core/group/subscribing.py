"""Subscriptions through a group: items in the order in which they become visible (paper, section 3.3). Pure."""

from __future__ import annotations

from dataclasses import replace

from stampede_rt.errors import InvalidArgument
from stampede_rt.values.timeline import MIN_INSTANT, Bound
from stampede_rt_channel_host.core.channel import (
    ChannelCore,
    DeliveredSlice,
    Gap,
    Pieces,
    Position,
    SavedCursor,
    Slice,
    SubscriptionBatch,
)
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, SEQ_END, ItemKey
from stampede_rt_channel_host.core.group.following import CutFollower, Loss
from stampede_rt_channel_host.core.group.recorded_steps import RecordedStep
from stampede_rt_channel_host.core.group.visible import Horizon, VisibleHoldings, VisibleQueryReader

STEP_BYTES_MAX = 2**20
"""A reader of the newest item gets only the number of the other items. The host counts them in parts of about this many
bytes.
"""
PARTS_PER_TAKE = 8
"""The most parts of counted items that one `VisibleNewestCursor.take` takes."""


class VisibleAllCursor:
    """A subscription to all items of a channel, each once.

    The items between two cuts come in the order (time, seq). Late items come with the next step (see `StepPart`).

    With `start`, visible items from that bound on come first. With `after`, the subscription begins with all items that
    are later in time or in seq than the stated item. If producers put items out of order, it may then repeat some
    items, but it leaves none out. A subscription with a `saved` cursor continues without a gap or a repetition.
    """

    def __init__(
        self,
        channel: ChannelCore,
        horizon: Horizon,
        now: int,
        *,
        start: Bound | None = None,
        start_exclusive: bool = False,
        after: Position | None = None,
        saved: SavedCursor | None = None,
        archived: bool = False,
    ) -> None:
        """Begin a subscription. `archived`: the caller takes `unheld_step`, and finds its items in an archive.

        Raises InvalidArgument if both `start` and `after` are given, if `after` has no seq, or if `saved` comes from a
        subscription without a group. Raises IncarnationLost if `after` or `saved` is of another incarnation.
        """
        self._channel = channel
        self._gap: Gap | None = None
        self.delivered = 0
        self.dropped = 0
        cut, next_seq = horizon.cut, None
        if saved is not None:
            kept = _kept_cut(channel, horizon, now, saved)
            cut = None if cut is None else min(cut, kept)
            next_seq = min(saved.next_seq, channel.next_seq)
        elif after is not None:
            time, seq = _resume(channel, horizon, now, start, after)
            cut = None if cut is None else min(cut, time + 1)
            next_seq = min(seq + 1, channel.next_seq)
        elif start is not None and cut is not None:
            low = VisibleQueryReader(channel, horizon, now).resolve_bound(start, now)
            cut = cut if low is None else min(cut, low + start_exclusive)
        self._follower = CutFollower(channel, cut, now, next_seq=next_seq, archived=archived)
        self._got_to = self._follower.next_seq if start is None else 0  # see `RecordedStep`

    def unheld_step(self, horizon: Horizon, now: int) -> RecordedStep | None:
        """The next step, or the rest of the present one, if memory does not have all of it; otherwise None.

        The caller performs the step, and then calls `skip_to`.
        """
        follower = self._follower
        if self._gap is not None or horizon.cut is None or not follower.may_show_items(horizon.cut):
            return None
        if not follower.under_way:
            if follower.is_held(now):
                return None
            end = self._channel.next_seq
            return RecordedStep(follower.cut, horizon.cut, follower.next_seq, end, got_to=self._got_to)
        rest = follower.unheld_rest(now)
        if rest is None:
            return None
        key, target, seq_end = rest
        return RecordedStep(follower.cut, target, seq_end, seq_end, got_to=self._got_to, done_below=key)

    def skip_to(self, step: RecordedStep, now: int) -> None:
        """Note that the reader has all items of this step."""
        self.dropped += step.dropped
        self._got_to = step.end_got_to
        self._follower = CutFollower(self._channel, step.target, now, next_seq=step.seq_end, archived=True)

    @property
    def saved(self) -> SavedCursor | None:
        """The cursor from which another subscription continues, or None while a step is under way."""
        if self._follower.under_way:
            return None
        cut = self._follower.cut
        return SavedCursor(
            incarnation=self._channel.incarnation,
            next_seq=self._follower.next_seq,
            cut=MIN_INSTANT if cut is None else cut,
        )

    def lowest_owed_seq(self, now: int) -> int:
        """See `CutFollower.lowest_owed_seq`."""
        return self._follower.lowest_owed_seq(now)

    def emptying(self) -> Pieces[None]:
        """See `CutFollower.emptying`."""
        return self._follower.emptying()

    def take(self, horizon: Horizon, now: int, limit_bytes: int) -> SubscriptionBatch:
        """The next part of the subscription, of about `limit_bytes`.

        A gap comes after the items of its step. If the part is empty and `more` is not set, wait for a later cut or a
        late item.
        """
        follower = self._follower
        while self._gap is None and horizon.cut is not None and follower.may_show_items(horizon.cut):
            if not follower.under_way:
                follower.begin(horizon.cut)
            step = follower.take(now, limit_bytes)
            self._gap = None if step.loss is None else _gap(step.loss)
            slices = step.late + step.slices
            if slices:
                self.delivered += sum(one.slice.items for one in slices)
                self._got_to = max(self._got_to, *(one.slice.end_seq for one in slices))
                return SubscriptionBatch(slices=slices)
            if not step.is_last:
                return SubscriptionBatch(more=True)
        gap, self._gap = self._gap, None
        self.dropped += gap.items if gap else 0
        return SubscriptionBatch(gap=gap)


class VisibleNewestCursor:
    """A subscription to the latest visible item by (time, seq). It never gives an item earlier than the last one.

    `skipped` counts the other items that became visible. The subscription begins as one of
    `ChannelCore.subscribe_newest` does.
    """

    def __init__(
        self,
        channel: ChannelCore,
        horizon: Horizon,
        now: int,
        *,
        start: Bound | None = None,
        start_exclusive: bool = False,
        after: Position | None = None,
        saved: SavedCursor | None = None,
    ) -> None:
        """Begin a subscription. Raises the errors of `VisibleAllCursor`."""
        self._channel = channel
        self._last: ItemKey = FIRST_KEY  # only items above this key are given
        self.delivered = 0
        self._meant = 0  # the subscription's items that became visible, as far as they are counted
        self._all = VisibleAllCursor(
            channel, horizon, now, start=start, start_exclusive=start_exclusive, after=after, saved=saved
        )
        if saved is not None:
            time, end_seq = saved.low or FIRST_KEY
            self._last = time, end_seq - 1
        elif after is not None:
            assert after.seq is not None, "VisibleAllCursor refuses a position without a seq"
            self._last = after.time, after.seq
        elif start is None:
            newest = self._newest(horizon, now)
            self._last = FIRST_KEY if newest is None else (newest.last_time, newest.end_seq - 1)
        elif (low := VisibleQueryReader(channel, horizon, now).resolve_bound(start, now)) is not None:
            self._last = (low, SEQ_END) if start_exclusive else (low, -1)

    @property
    def saved(self) -> SavedCursor | None:
        """See `VisibleAllCursor`."""
        kept = self._all.saved
        return None if kept is None else replace(kept, low=(self._last[0], self._last[1] + 1))

    def lowest_owed_seq(self, now: int) -> int:
        """See `VisibleAllCursor`."""
        return self._all.lowest_owed_seq(now)

    @property
    def skipped(self) -> int:
        """The number of the subscription's visible items that the reader did not get, as of the last `take`."""
        return max(0, self._meant - self.delivered)

    def emptying(self) -> Pieces[None]:
        """See `CutFollower.emptying`."""
        return self._all.emptying()

    def take(self, horizon: Horizon, now: int) -> SubscriptionBatch:
        """Take the newest visible item, if it is later than the last item taken. Also counts other items, in parts.

        If the batch has `more` set, call again: there are more items to count.
        """
        newest = self._newest(horizon, now)
        is_news = newest is not None and (newest.last_time, newest.end_seq - 1) > self._last
        more = self._count(horizon, now)
        if newest is None or not is_news:
            return SubscriptionBatch(more=more)
        self._last = newest.last_time, newest.end_seq - 1
        self.delivered += 1
        return SubscriptionBatch(slices=(DeliveredSlice(newest, None),), more=more)

    def _count(self, horizon: Horizon, now: int) -> bool:
        """Count items that have become visible. Returns True if there are more items to count."""
        for _ in range(PARTS_PER_TAKE):
            part = self._all.take(horizon, now, STEP_BYTES_MAX)
            if part.is_empty and not part.more:
                return False
            self._meant += sum(one.slice.items for one in part.slices) + (part.gap.items if part.gap else 0)
        return True

    def _newest(self, horizon: Horizon, now: int) -> Slice | None:
        """The newest visible item as a slice of one item, or None."""
        held, _ = self._channel.look(now)
        part = next(VisibleHoldings(held, horizon.cut).slices_down(), None)
        return None if part is None else Slice(part.run, part.hi - 1, part.hi)


def _kept_cut(channel: ChannelCore, horizon: Horizon, now: int, saved: SavedCursor) -> int:
    """The cut of a saved cursor. Raises InvalidArgument or IncarnationLost if the cursor does not fit the channel."""
    VisibleQueryReader(channel, horizon, now).check_position(Position(0, None, saved.incarnation))
    if saved.cut is None:
        raise InvalidArgument("the cursor comes from a subscription without a group; leave the group out")
    return saved.cut


def _resume(channel: ChannelCore, horizon: Horizon, now: int, start: Bound | None, after: Position) -> tuple[int, int]:
    """The time and seq of the position `after`. Raises an error if a subscription cannot begin there."""
    VisibleQueryReader(channel, horizon, now).check_position(after)
    if start is not None:
        raise InvalidArgument("a subscription has both start and after; give start to begin, after to resume")
    if after.seq is None:
        raise InvalidArgument("a subscription resumes after an item, but the position has no seq; use start instead")
    return after.time, after.seq


def _gap(loss: Loss) -> Gap:
    """The gap of a loss. A loss of unknown size counts as at least one item, so that the reader learns of it."""
    return Gap(first_seq=loss.first_seq, last_seq=loss.last_seq, items=max(1, loss.items), reason=loss.reason)
