"""Gives a reader each item of one channel once, when the cut makes it visible (paper, section 3.3). Pure.

A follower is done with all items before its cut that have a seq below its `next_seq`. A step takes it to a later cut.
The step brings the items between the two cuts. It also brings the late items: items before the former cut that the
channel accepted after the former step began.
"""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from itertools import islice

from stampede_rt.values.model import Reason
from stampede_rt_channel_host.core.channel import ChannelCore, DeliveredSlice, Pieces, Slice, pieces
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, ItemKey
from stampede_rt_channel_host.core.group.loss_counter import LOOKED_AT_MAX, LossCounter, newest_gone, split_at
from stampede_rt_channel_host.core.merging import Merge


@dataclass(frozen=True, kw_only=True, slots=True)
class Loss:
    """Items that the reader should have got, and that the channel no longer has. Their times are before `before`.

    The host knows of `items` lost items. If `is_exact`, no other item is lost, and all lost items have seqs from
    `first_seq` to `last_seq`, both inclusive. Otherwise further items may be lost. `reason` says how they were lost.
    """

    before: int
    items: int
    is_exact: bool
    reason: Reason
    first_seq: int
    last_seq: int


@dataclass(frozen=True, kw_only=True, slots=True)
class StepPart:
    """A part of a step: first the late items in `late`, then the newly visible items in `slices`.

    Reads could already return the late items before the step. All items of a step are in the order (time, seq), from
    part to part, so a reader can resume after any part. `is_last`: this part ends the step. Only this part
    may have a `loss`: items that the step should have brought and cannot bring.
    """

    slices: list[DeliveredSlice] = field(default_factory=list)
    late: list[DeliveredSlice] = field(default_factory=list)
    is_last: bool
    loss: Loss | None = None


class CutFollower:
    """The position of one reader in one channel of a group. If `cut` is None, no item was visible to the reader yet.

    For each step the caller calls `begin(cut)` with a cut not before the last one, and then `take` until a part is the
    last of the step. `under_way`: a step has begun, and its last part was not taken yet.
    """

    def __init__(
        self,
        channel: ChannelCore,
        cut: int | None,
        now: int,
        *,
        next_seq: int | None = None,
        incarnation: int | None = None,
        archived: bool = False,
    ) -> None:
        """Begin at the cut. With `next_seq`, continue from the cut and `next_seq` that a reader kept.

        `incarnation` is the channel's incarnation when the reader kept the cut and `next_seq`. If the channel has
        another incarnation now, the first step reports a loss, and all present items count as late or new. If
        `incarnation` is None, the follower does not compare. `archived`: the caller finds collected items in an
        archive.
        """
        held, _ = channel.look(now)
        self._channel = channel
        self._unreported: Loss | None = None
        self.cut = cut
        self.under_way = False
        self._target: ItemKey = FIRST_KEY
        self._seq_end = 0
        self._range_start: ItemKey = FIRST_KEY  # the present step has given the newly visible items below this key
        self._looked_up_to = 0  # the present step has searched the seqs below this one for late items
        self._late = Merge(_order)  # the found late items that are not given yet, in the order (time, seq)
        self._is_searched = False  # the search for late items is over
        self._late_rest: Slice | None = None  # the rest of a slice that was taken in part
        # Numbers of items in the present step, for `LossCounter.mark_read`. "above": not before the former cut;
        # "below": before it. "came": accepted since the former step began; "given": in a part that `take` has returned.
        self._came_above = self._given_above = self._given_below = 0
        if incarnation is not None and incarnation != channel.incarnation:
            self._unreported = _lost_with_host(channel, cut)
            next_seq = 1
        elif next_seq is not None and not archived and _reaches(held, cut):
            self._unreported = _collected(channel, held, 0, 1, is_exact=False)
        self._loss_counter = LossCounter(held, _key(cut), channel.next_seq if next_seq is None else next_seq)

    @property
    def next_seq(self) -> int:
        """The reader is done with the items before the cut that have a lower seq than this. It can resume from here."""
        return self._loss_counter.next_seq

    def lowest_owed_seq(self, now: int) -> int:
        """A seq such that the reader is done with every item of a lower seq, whatever its time.

        Looks at a bounded number of items, so the seq may be lower than necessary.
        """
        held, _ = self._channel.look(now)
        return self._loss_counter.lowest_owed(held)

    def may_show_items(self, cut: int) -> bool:
        """Whether a step to `cut` may bring items."""
        if self.under_way or self.cut is None or cut > self.cut:
            return True
        return cut == self.cut and self._channel.next_seq != self.next_seq

    def is_held(self, now: int) -> bool:
        """Whether memory has all items that the next step may bring. False if there are too many items to check."""
        held, _ = self._channel.look(now)
        end = self._channel.next_seq
        return not _reaches(held, self.cut) and held.held_up_to(self.next_seq, end, LOOKED_AT_MAX) >= end

    def unheld_rest(self, now: int) -> tuple[ItemKey, int, int] | None:
        """The rest of the present step, if memory has lost some of its items; otherwise None.

        Returns the key below which the reader has all items, the step's cut, and the end of its seqs. Returns None also
        if there are late items to take first.
        """
        held, _ = self._channel.look(now)
        is_whole = held.floor <= self._range_start or not _reaches(held, self._range_start[0])
        if is_whole or not self._is_searched or self._late_rest is not None:
            return None
        return self._range_start, self._target[0], self._seq_end

    def begin(self, cut: int) -> None:
        """Begin a step. Items before `cut` that the channel accepts from now on are late: the next step brings them."""
        assert not self.under_way, "finish the present step first"
        assert self.cut is None or cut >= self.cut, "a cut never moves back"
        self.under_way = True
        self._target = _key(cut)
        self._seq_end = self._channel.next_seq
        self._range_start = _key(self.cut)
        self._looked_up_to, self._late, self._is_searched = self.next_seq, Merge(_order), False
        self._came_above = self._given_above = self._given_below = 0

    def emptying(self) -> Pieces[None]:
        """Free the late items that a step has found, in pieces. The caller must not use the follower afterwards."""
        return self._late.emptying()

    def take(self, now: int, limit_bytes: int) -> StepPart:
        """The next part of the step: about `limit_bytes` (payload and overhead) and a bounded number of slices.

        If there were many items to look at, a part may be empty although the step continues.
        """
        assert self.under_way, "begin a step first"
        held, _ = self._channel.look(now)
        if not self._look_for_late(held):
            return StepPart(is_last=False)
        late, left_bytes, done = self._take_late(held, limit_bytes)
        slices: list[DeliveredSlice] = []
        if done:
            slices, left_bytes, done = self._take_range(held, left_bytes, pieces.STEPS_PER_PIECE - len(late))
        if left_bytes <= 0 or not done:
            return StepPart(slices=slices, late=late, is_last=False)
        return StepPart(slices=slices, late=late, is_last=True, loss=self._finish(held))

    def _take_range(self, held: Holdings, left_bytes: int, steps: int) -> tuple[list[DeliveredSlice], int, bool]:
        """Give newly visible items that the channel had when the step began.

        Returns the items, the rest of the limit `left_bytes`, and whether the step has no more such items.
        """
        taken: list[DeliveredSlice] = []
        for part in held.slices(self._range_start, self._target):
            if left_bytes <= 0 or steps <= 0:
                return taken, left_bytes, False
            given = part
            if part.run.first_seq < self._seq_end:
                given = part.within(left_bytes)
                taken.append(self._deliver(held, given))
                self._given_above += given.items
                left_bytes -= given.charge_bytes
            self._range_start = given.last_time, given.end_seq
            steps -= 1
        return taken, left_bytes, True

    def _look_for_late(self, held: Holdings) -> bool:
        """Search some of the newly accepted items for late ones, in seq order. Returns True if the search is over."""
        if self._is_searched:
            return True
        found = held.slices_by_seq(self._looked_up_to, self._seq_end)
        new_parts = [*islice(found, pieces.STEPS_PER_PIECE)]
        parts = [split_at(part, _key(self.cut)) for part in new_parts]
        self._came_above += sum(above.items for _, above in parts)
        self._late.add(sorted((below for below, _ in parts if below.items), key=_order))
        if len(new_parts) == pieces.STEPS_PER_PIECE:
            self._looked_up_to = new_parts[-1].end_seq
            return False
        self._is_searched = True
        return True

    def _take_late(self, held: Holdings, left_bytes: int) -> tuple[list[DeliveredSlice], int, bool]:
        """Give found late items that are still held. Returns the same three values as `_take_range`."""
        taken: list[DeliveredSlice] = []
        for _ in range(pieces.STEPS_PER_PIECE):
            if left_bytes <= 0:
                return taken, left_bytes, False
            part = self._late_rest or next(self._late, None)
            if part is None:
                return taken, left_bytes, True
            self._late_rest = None
            _, rest = split_at(part, held.floor)
            if rest.items:
                given = rest.within(left_bytes)
                taken.append(self._deliver(held, given))
                self._given_below += given.items
                left_bytes -= given.charge_bytes
                self._late_rest = Slice(rest.run, given.hi, rest.hi) if given.hi < rest.hi else None
        return taken, left_bytes, False

    def _deliver(self, held: Holdings, part: Slice) -> DeliveredSlice:
        """The slice for delivery. An item at or after the cut ends no span, because no reader may see it yet."""
        following = held.next_time(part.last_time)
        hidden = following is not None and following >= self._target[0]
        return DeliveredSlice(part, None if hidden else following)

    def _finish(self, held: Holdings) -> Loss | None:
        """End the step. Returns the loss that it reports, or None."""
        first_seq = self._loss_counter.lowest_seq
        lost = self._loss_counter.mark_read(
            held,
            self._target,
            self._seq_end,
            given_above=self._given_above,
            given_below=self._given_below,
            came_above=self._came_above,
        )
        self.under_way = False
        self.cut = self._target[0]
        loss = _collected(self._channel, held, lost, first_seq) if lost else None
        unreported, self._unreported = self._unreported, None
        return loss if unreported is None else _joined(unreported, loss)


def _order(part: Slice) -> ItemKey:
    return part.first_time, part.first_seq


def _key(cut: int | None) -> ItemKey:
    return FIRST_KEY if cut is None else (cut, 0)


def _reaches(held: Holdings, cut: int | None) -> bool:
    """Whether the channel has collected items at or after the cut."""
    gone = newest_gone(held)
    return gone is not None and (cut is None or gone >= cut)


def _lost_with_host(channel: ChannelCore, cut: int | None) -> Loss:
    """The loss of a reader whose cut is of an earlier incarnation."""
    before = max((one for one in (cut, channel.oldest) if one is not None), default=0)
    detail = "the channel's host was lost with items that the group had not shown"
    return Loss(before=before, items=0, is_exact=False, reason=Reason("LOST", detail), first_seq=1, last_seq=1)


def _joined(unreported: Loss, since: Loss | None) -> Loss:
    """Join two losses into one. `unreported` came before the reader returned, and `since` came with its first step
    afterwards.
    """
    if since is None:
        return unreported
    before, last_seq = max(unreported.before, since.before), max(unreported.last_seq, since.last_seq)
    return replace(unreported, before=before, items=since.items, last_seq=last_seq)


def _collected(channel: ChannelCore, held: Holdings, items: int, first_seq: int, *, is_exact: bool = True) -> Loss:
    """The loss of `items` items that retention collected, from `first_seq` on."""
    gone = newest_gone(held)
    before = channel.newest if gone is None else gone
    return Loss(
        before=0 if before is None else before + 1,
        items=items,
        is_exact=is_exact,
        reason=Reason("COLLECTED", "retention collected items before the group had shown them to this reader"),
        first_seq=first_seq,
        last_seq=max(first_seq, channel.next_seq - 1),
    )
