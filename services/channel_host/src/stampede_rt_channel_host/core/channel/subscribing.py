"""The cursors of subscriptions to a channel, and the items that come next (paper, section 4.1: push). Pure."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import chain, islice

from stampede_rt.values.model import Reason
from stampede_rt.values.seq_starts import given_between, is_start
from stampede_rt_channel_host.core.channel import pieces
from stampede_rt_channel_host.core.channel.former_incarnations import LostPlaces
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.item_keys import ItemKey
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.channel.owed_ranges import Range, owed_ranges
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.channel.run import Slice
from stampede_rt_channel_host.core.channel.shared_batches import SharedBatch, SharedBatches
from stampede_rt_channel_host.core.channel.values import DeliveredSlice, Gap, SavedCursor, SubscriptionBatch

GAP_ENTRIES_MAX = 1024
"""The most outdated entries that one call looks at.

So a reader that is far behind does not delay other callers. Such a reader gets several gaps.
"""


_NOTHING = SubscriptionBatch()


class AllCursor:
    """The position of a subscription in seq order.

    `ChannelCore.subscribe_all` makes the cursor, and `ChannelCore.since` moves it. `delivered` counts the items given
    to the reader so far, `dropped` the items reported in gaps. An owed item is one that the reader still has to get.
    """

    __slots__ = ("_begun_seq", "_live_seq", "_low", "_owed", "_owed_before", "delivered", "dropped", "losses")

    def __init__(
        self, owed: Iterator[Range], live_seq: int, low: ItemKey | None = None, begun_seq: int = 0,
        losses: LostPlaces = (),
    ) -> None:  # fmt: skip
        """Make the cursor.

        `owed` are the ranges of owed seqs below `live_seq`, ascending. All seqs from `live_seq` on are owed, too. Of
        the items with seqs below `begun_seq`, only items at or above the key `low` belong to the subscription.
        `losses`: the losses of items that the reader does not know yet, at their places.
        """
        self._owed_before = owed
        self._live_seq = live_seq
        self._low = low
        self._begun_seq = begun_seq
        self._owed = next(owed, None)
        self.losses = losses
        self.delivered = 0
        self.dropped = 0

    @property
    def next_seq(self) -> int:
        """All lower seqs were delivered, reported in a gap, or do not belong to this subscription."""
        return self._live_seq if self._owed is None else self._owed[0]

    def belongs(self, time: int, seq: int) -> bool:
        """Whether an item with an owed seq belongs to the subscription."""
        return self._low is None or seq >= self._begun_seq or (time, seq) >= self._low

    def saved(self, incarnation: int) -> SavedCursor:
        """The cursor from which another subscription continues. It has the former incarnation until the reader knows of
        the loss. If the archive shows the loss, it has a seq below the loss instead.
        """
        next_seq = self.next_seq
        if self.losses and self.losses[0].incarnation == incarnation:
            next_seq = min(next_seq, self.losses[0].next_seq - 1)
        incarnation = self.losses[0].incarnation if self.losses else incarnation
        if self._low is None or next_seq >= self._begun_seq:
            return SavedCursor(incarnation=incarnation, next_seq=next_seq)
        return SavedCursor(incarnation=incarnation, next_seq=next_seq, low=self._low, live_seq=self._begun_seq)

    def owed(self, next_seq: int) -> Range | None:
        """The first range of owed seqs, or None if no seq is owed. `next_seq` is the seq of the next accepted item."""
        if self._owed is None and next_seq > self._live_seq:
            self._owed, self._live_seq = (self._live_seq, next_seq), next_seq
        # The range is the last one, and it ends at the first new seq: add the new seqs to it.
        elif self._owed is not None and self._owed[1] == self._live_seq:
            self._owed, self._live_seq = (self._owed[0], next_seq), next_seq
        return self._owed

    def owed_before_loss(self, next_seq: int) -> Range | None:
        """Return the owed seqs before the next loss that the reader does not know yet."""
        owed = self.owed(next_seq)
        if owed is None or not self.losses:
            return owed
        end = self.losses[0].next_seq
        return (owed[0], min(owed[1], end)) if owed[0] < end else None

    def take_loss(self) -> Gap | None:
        """The gap of the losses at the present place; None if there is none."""
        if not self.losses:
            return None
        place = self.losses[0].next_seq
        self.losses = tuple(one for one in self.losses if one.next_seq > place)
        return lost_gap(place)

    def mark_done(self, seq: int) -> None:
        """Note that the reader has received or lost all items below `seq`.

        `seq` lies in the first owed range, or is its end.
        """
        assert self._owed is not None, "something is owed"
        end = self._owed[1]
        self._owed = (seq, end) if seq < end else next(self._owed_before, None)

    def pass_next(self, seq: int, items: int) -> None:
        """Note that the reader gets the next accepted items, from this seq on, in another way."""
        self.owed(seq + items)
        self.mark_done(seq + items)
        self.delivered += items


def missing_from(held: Holdings, cursor: AllCursor) -> Range | None:
    """The first owed seqs if memory does not have them; otherwise None. The range may end before the first held seq."""
    owed = cursor.owed(held.next_seq)
    if owed is None:
        return None
    low = held.seq_from(*owed, GAP_ENTRIES_MAX)
    return (owed[0], low) if low > owed[0] else None


def open_all(
    held: Holdings,
    low: ItemKey | None,
    after_seq: int | None,
    archived_from: int | None = None,
    losses: LostPlaces = (),
) -> Pieces[AllCursor]:
    """A cursor that begins with the items accepted after `after_seq`, or with the held items from the key `low` on.

    If both are None, the cursor begins with the next accepted item. `archived_from`: `low` lies below all held items;
    the items with seqs from this one on that memory does not have are in an archive. `losses`: see `AllCursor`.
    """
    next_seq = held.next_seq
    if after_seq is not None:
        owed = [(after_seq + 1, next_seq)] if after_seq + 1 < next_seq else []
        return AllCursor(iter(owed), next_seq, losses=losses)
    if low is None:
        return AllCursor(iter(()), next_seq)
    if archived_from is not None:
        owed = [(archived_from, next_seq)] if archived_from < next_seq else []
        return AllCursor(iter(owed), next_seq, low, next_seq, losses)
    ranges = yield from owed_ranges(held, low)
    return AllCursor(iter(ranges), next_seq, low, next_seq, losses)


def resume_all(
    held: Holdings, saved: SavedCursor, losses: LostPlaces = (), *, is_present: bool = False
) -> Pieces[AllCursor]:
    """A cursor that continues a saved subscription. `losses`: see `AllCursor`. `is_present`: the cursor is of the
    present incarnation.

    If retention has collected items at or above the saved `low`, the host does not know whether they belonged to the
    subscription. Then all seqs from `next_seq` on count as the subscription's, and the missing seqs as collected before
    the reader took them. So the gaps may count too many items, but never too few.
    """
    # newer items have the same seqs as lost items of a former incarnation
    end = losses[0].next_seq if losses and not is_present else held.next_seq
    first, live = min(saved.next_seq, end), min(saved.live_seq, end)
    low = saved.low if first < live else None
    live_from = live
    gone = (held.newest_collected, held.newest_consumed)
    # retention collects items in the order of time
    if low is None or any(time is not None and time >= low[0] for time in gone):
        live_from = first
    next_seq = held.next_seq
    live_ranges = [(live_from, next_seq)] if live_from < next_seq else []
    if low is None:
        return AllCursor(iter(live_ranges), next_seq, low, live, losses)
    ranges = yield from owed_ranges(held, low)
    return AllCursor(chain(ranges.between(first, live_from), live_ranges), next_seq, low, live, losses)


def since(
    held: Holdings, limits: ChannelLimits, cursor: AllCursor, limit_bytes: int, *, joins: bool = False
) -> SubscriptionBatch:
    """The next part of a subscription: a gap if the next items are missing, then slices.

    The slices end before the next gap, or at about `limit_bytes`. Readers at the same place get the same batch.
    `joins`: the reader is a copy of the channel. Its slices are joined (see `_joined`), and have no next times.
    """
    if cursor.losses:
        return _up_to_loss(held, limits, cursor, limit_bytes)
    owed = cursor.owed(held.next_seq)
    if owed is None:
        return _NOTHING
    place, is_last = owed[0], owed[1] == held.next_seq
    if is_last and held.shared_batches is not None:
        shared = held.shared_batches.find((place, joins), limit_bytes)
        if shared is not None:
            cursor.delivered += shared.items
            cursor.mark_done(shared.end_seq)
            return shared.batch
    before = cursor.delivered
    newest = held.index.newest_from(place, held.floor) if limit_bytes > 0 and is_last else None
    if newest is not None and newest.end_seq == owed[1] and (newest.items == 1 or newest.charge_bytes <= limit_bytes):
        # the usual case of a reader who has everything else
        cursor.delivered += newest.items
        cursor.mark_done(owed[1])
        batch = SubscriptionBatch(slices=[DeliveredSlice(newest, held.next_time(newest.last_time))])
    else:
        batch = _next_batch(held, limits, cursor, limit_bytes, joins=joins)
    if is_last and batch.gap is None and batch.slices:
        charge_bytes = sum(one.slice.charge_bytes for one in batch.slices)
        shared = SharedBatch(batch, cursor.delivered - before, charge_bytes, batch.slices[-1].slice.end_seq)
        if held.shared_batches is None:
            held.shared_batches = SharedBatches()
        held.shared_batches.keep((place, joins), limit_bytes, shared)
    return batch


def _up_to_loss(held: Holdings, limits: ChannelLimits, cursor: AllCursor, limit_bytes: int) -> SubscriptionBatch:
    """The next items before the next loss, or the loss if all of them are sent."""
    batch = _next_batch(held, limits, cursor, limit_bytes)
    if not batch.is_empty or limit_bytes <= 0 or cursor.owed_before_loss(held.next_seq) is not None:
        return batch
    return SubscriptionBatch(gap=cursor.take_loss(), more=True)


def _next_batch(
    held: Holdings, limits: ChannelLimits, cursor: AllCursor, limit_bytes: int, *, joins: bool = False
) -> SubscriptionBatch:
    gap: Gap | None = None
    slices: list[DeliveredSlice] = []
    while (owed := cursor.owed_before_loss(held.next_seq)) is not None and limit_bytes > 0:
        low = held.seq_from(*owed, GAP_ENTRIES_MAX)
        if low > owed[0]:
            if slices or gap is not None:
                break
            if missing_items := given_between(owed[0], low):  # otherwise no item has these seqs
                gap = _gap(limits, held, low - missing_items, low - 1)
                cursor.dropped += missing_items
            cursor.mark_done(low)
            continue
        parts = _contiguous(held, *owed)
        for held_part in _joined(parts) if joins else parts:
            part = held_part.within(limit_bytes)
            slices.append(DeliveredSlice(part, None if joins else held.next_time(part.last_time)))
            cursor.delivered += part.items
            cursor.mark_done(part.end_seq)
            limit_bytes -= part.charge_bytes
            if limit_bytes <= 0 or len(slices) >= pieces.STEPS_PER_PIECE:
                return SubscriptionBatch(slices=slices, gap=gap)
        if joins:  # it has looked at as many entries as one step may
            break
    return SubscriptionBatch(slices=slices, gap=gap)


def _contiguous(held: Holdings, low: int, high: int) -> Iterator[Slice]:
    """The held slices from the seq `low` on, up to the first missing seq."""
    for part in held.slices_by_seq(low, high):
        if part.first_seq > low:
            return
        yield part
        low = part.end_seq


def _joined(parts: Iterator[Slice]) -> Iterator[Slice]:
    """The first slices, STEPS_PER_PIECE at most. Joins neighbours that follow each other in one run and in time.

    Items of other runs may lie between them in time. Readers of this channel get them apart, because the ends of their
    spans depend on the items between them. A copy stores the joined items as one run, and has an index of its own.
    """
    run, lo, hi = None, 0, 0
    for part in islice(parts, pieces.STEPS_PER_PIECE):
        if part.run is run and part.lo == hi and run.times[hi - 1] <= part.first_time:
            hi = part.hi
            continue
        if run is not None:
            yield Slice(run, lo, hi)
        run, lo, hi = part
    if run is not None:
        yield Slice(run, lo, hi)


def _gap(limits: ChannelLimits, held: Holdings, first: int, last: int) -> Gap:
    """The gap for the seqs from `first` to `last`, both inclusive."""
    policy = limits.describe(held.last_cause)
    detail = f"the reader was slower than the channel's retention: {policy} collected the items before they were sent"
    return Gap(first_seq=first, last_seq=last, items=last - first + 1, reason=Reason("COLLECTED", detail))


def lost_gap(next_seq: int) -> Gap:
    """The gap for items that were lost with the owner of the channel. Their number is unknown."""
    if is_start(next_seq):
        detail = "the channel's host was lost, and the archive may lack the last items that it had accepted"
    else:
        copied = f"a replica had its items up to seq {next_seq - 1}"
        detail = f"the channel's host was lost, and {copied}; later ones may be lost"
    return Gap(first_seq=next_seq, last_seq=next_seq, items=0, reason=Reason("LOST", detail))
