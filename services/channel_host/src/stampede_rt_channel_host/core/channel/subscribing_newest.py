"""The cursors of subscriptions to the newest item of a channel (paper, section 4.1: push). Pure."""

from __future__ import annotations

from stampede_rt.values.seq_starts import given_between
from stampede_rt_channel_host.core.channel.former_incarnations import LostPlaces
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, ItemKey
from stampede_rt_channel_host.core.channel.run import Slice
from stampede_rt_channel_host.core.channel.subscribing import lost_gap
from stampede_rt_channel_host.core.channel.values import DeliveredSlice, Gap, SavedCursor


class NewestCursor:
    """The position of a subscription to the newest item.

    `ChannelCore.subscribe_newest` makes the cursor, and `ChannelCore.latest` moves it. `delivered` counts the items
    given to the reader. `skipped` counts the other items of the subscription, as of the last `latest`. `next_seq` is
    the channel's next seq at that time.
    """

    __slots__ = ("_base_seq", "_before", "_low", "delivered", "losses", "next_seq", "skipped")

    def __init__(self, low: ItemKey, base_seq: int, losses: LostPlaces = (), before: int = 0) -> None:
        self._low = low  # only items at or above this key belong to the subscription
        self._base_seq = base_seq  # all items from this seq on belong to the subscription
        self._before = before  # the number of items with lower seqs that belong to it
        self.losses = losses  # the losses that the reader does not know yet
        self.delivered = 0
        self.skipped = 0
        self.next_seq = base_seq - before

    def saved(self, incarnation: int) -> SavedCursor:
        """The cursor from which another subscription continues. It has the former incarnation until the reader knows of
        the loss.
        """
        incarnation = self.losses[0].incarnation if self.losses else incarnation
        return SavedCursor(incarnation=incarnation, next_seq=self.next_seq, low=self._low)

    def take_loss(self) -> Gap | None:
        """The gap of a loss that the reader does not know yet; None if there is no such loss."""
        losses, self.losses = self.losses, ()
        return lost_gap(losses[-1].next_seq) if losses else None

    def take(self, held: Holdings) -> DeliveredSlice | None:
        """The newest item, if it is later than the last item taken; otherwise None."""
        part = next(held.slices_down(self._low), None)
        newest = None if part is None else Slice(part.run, part.hi - 1, part.hi)
        if newest is not None:
            self._low = newest.last_time, newest.end_seq
            self.delivered += 1
        self.next_seq = held.next_seq
        # After a resumption the newest item may have been accepted before `_base_seq`: then `delivered` counts it, but
        # the difference of the seqs does not.
        accepted = self._before + given_between(self._base_seq, held.next_seq)
        self.skipped = max(0, accepted - self.delivered)
        return None if newest is None else DeliveredSlice(newest, None)


def resume_newest(held: Holdings, saved: SavedCursor, losses: LostPlaces = ()) -> NewestCursor:
    """A cursor that continues a saved subscription with items later than its last item."""
    return NewestCursor(saved.low or FIRST_KEY, min(saved.next_seq, held.next_seq), losses)


def open_newest(held: Holdings, low: ItemKey | None, after: ItemKey | None) -> NewestCursor:
    """A cursor that begins with the newest item after the key `after`, or at or above the key `low`.

    If both are None, the cursor begins with the next item that is later than all held items.
    """
    if after is not None:
        return NewestCursor((after[0], after[1] + 1), after[1] + 1)
    if low is not None:
        return NewestCursor(low, held.next_seq, before=held.items - held.items_below(low))
    last = next(held.slices_down(), None)
    return NewestCursor(FIRST_KEY if last is None else (last.last_time, last.end_seq), held.next_seq)
