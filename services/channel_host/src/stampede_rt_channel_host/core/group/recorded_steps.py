"""Steps of a subscription through a group, with items that are only in an archive. Pure.

The caller reads the pages of a step through the group, with a `Horizon` at the step's `target`, and gives them to the
step.
"""

from __future__ import annotations

from bisect import bisect_right
from collections import deque
from collections.abc import Callable, Iterable, Sequence

from stampede_rt.values.model import Reason
from stampede_rt.values.seq_starts import given_between
from stampede_rt.values.timeline import MIN_INSTANT, Bound, Interval, Match
from stampede_rt_channel_host.core.channel import (
    DeliveredSlice,
    Gap,
    Position,
    Query,
    ReadAnswer,
    Slice,
    SubscriptionBatch,
)
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, ItemKey
from stampede_rt_channel_host.core.channel.owed_ranges import Range
from stampede_rt_channel_host.core.group.loss_counter import split_at

_LOST = Reason("LOST", "the archive lacks items that the group would have shown: they were never archived, or damaged")
_REMOVED = Reason("COLLECTED", "the limits of the archive removed items before the group had shown them to this reader")


class RecordedStep:
    """One step of one reader, from the cut `cut` to the cut `target`.

    It brings the items between the two cuts, with seqs below `seq_end`, in the order (time, seq). Before these it
    brings the late items: items before `cut` with seqs from `next_seq` on. Order of use: while `late` is a range, load
    these seqs and call `take_late`. Then, while `is_read` is False, read `query` and call `take_page`. After each call
    take `batch` until it is empty. The reader has got no item with the seq `got_to` or a later one; 0: it has got no
    item yet, and began in the past.
    """

    def __init__(
        self,
        cut: int | None,
        target: int,
        next_seq: int,
        seq_end: int,
        *,
        got_to: int,
        done_below: ItemKey = FIRST_KEY,
    ) -> None:
        """`done_below`: the reader has the items of this step below this key."""
        self.target, self.seq_end, self.got_to = target, seq_end, got_to
        self.late: Range | None = (next_seq, seq_end) if next_seq < seq_end else None
        self.is_read = cut is not None and cut >= target
        self._dropped = self._removed = 0
        self._unfound = 0  # the seqs in `late` that neither memory nor the archive has
        self._late_end = 1  # the seq after the latest late item
        self._begin = cut
        self._after = Position(done_below[0], done_below[1] - 1) if done_below > (cut or FIRST_KEY[0], 0) else None
        self._waiting: deque[DeliveredSlice] = deque()

    @property
    def query(self) -> Query:
        """The query of the next page. Its interval ends before `target`."""
        start = MIN_INSTANT if self._begin is None else self._begin
        interval = Interval(Bound(None, start), Bound(None, self.target), end_exclusive=True)
        return Query(interval=interval, match=Match.START, after=self._after)

    def take_late(
        self, found: Iterable[Slice], next_time: Callable[[int], int | None], end_seq: int, kept_from: int
    ) -> None:
        """Take the late items, which are the items of `found` before `cut`.

        `found` has all items whose seqs are in `late` and less than `end_seq`. `next_time` returns the time of the next
        bucket after a time. `kept_from`: see `take_page`.
        """
        assert self.late is not None, "there are late items to find"
        first, end = self.late[0], min(self.late[1], end_seq)
        low = FIRST_KEY if self._begin is None else (self._begin, 0)
        among = [_with_seqs(one, first, end) for one in found]
        kept = sum(_with_seqs(one, kept_from, end).items for one in among)
        self._unfound += max(0, given_between(max(first, kept_from), end) - kept)
        late = [split_at(one, low)[0] for one in among]
        for part in sorted((one for one in late if one.items), key=lambda one: (one.first_time, one.first_seq)):
            following = next_time(part.last_time)
            hidden = following is not None and following >= self.target
            self._waiting.append(DeliveredSlice(part, None if hidden else following))
            self._late_end = max(self._late_end, part.end_seq)
        self.late = (end, self.late[1]) if end < self.late[1] else None

    def take_page(self, answer: ReadAnswer, *, continues: bool, missing_items: int, kept_from: int) -> None:
        """Take a page. `continues`: another page follows. `missing_items`: the number of items of this page that the
        archive lacks. `kept_from`: neither the archive nor memory has an item with a lower seq.

        If another page follows, and this page has items of several times, the step ends before the last of these times.
        So the reader gets a cursor before the next page.
        """
        self._dropped += missing_items
        self.is_read = not continues
        if continues and answer.slices[-1].last_time > answer.slices[0].first_time:
            self.target, self.is_read = answer.slices[-1].last_time, True
        shown = [_with_seqs(split_at(part, (self.target, 0))[0], 0, self.seq_end) for part in answer.slices]
        self._count_removed(shown, min(kept_from, self.seq_end))
        for at, kept in enumerate(shown):
            if kept.items:
                following = _next_time(answer.slices[at:], kept.last_time, kept.hi)
                self._waiting.append(DeliveredSlice(kept, answer.next_time if following is None else following))
        if answer.slices:
            last = answer.slices[-1]
            self._after = Position(last.last_time, last.end_seq - 1)

    def _count_removed(self, slices: Sequence[Slice], kept_from: int) -> None:
        """Count the items that were removed before the reader got them. All their seqs are less than `kept_from`."""
        if self.got_to:
            given = sum(_with_seqs(one, self.got_to, kept_from).items for one in slices)
            removed = max(0, given_between(self.got_to, kept_from) - given)
            self._dropped, self._removed = self._dropped + removed, self._removed + removed
            self.got_to = max(self.got_to, kept_from)
        self.got_to = max(self.got_to, *(one.end_seq for one in slices if one.items), 0)

    def batch(self, limit_bytes: int) -> SubscriptionBatch:
        """The next items for the reader, of about `limit_bytes`. Empty if the step needs more items, or is over."""
        slices: list[DeliveredSlice] = []
        while self._waiting and limit_bytes > 0:
            part, following = self._waiting.popleft()
            given = part.within(limit_bytes)
            if given.hi < part.hi:
                rest = Slice(part.run, given.hi, part.hi)
                self._waiting.appendleft(DeliveredSlice(rest, following))
                within = _next_time([rest], given.last_time, given.hi)
                following = following if within is None else within
            slices.append(DeliveredSlice(given, following))
            limit_bytes -= given.charge_bytes
        return SubscriptionBatch(slices=slices)

    @property
    def is_over(self) -> bool:
        """Whether the step has brought all its items."""
        return self.is_read and self.late is None and not self._waiting

    @property
    def dropped(self) -> int:
        """The number of items that the archive lacks, or that its limits have removed.

        The times of lost items are not known, and so it is not known which of them were late. Therefore all lost items
        with seqs in `late` count, even if some of them would belong to a later step.
        """
        return max(self._dropped, self._unfound)

    @property
    def gap(self) -> Gap | None:
        """The items that the step did not bring."""
        if not self.dropped:
            return None
        reason = _LOST if self.dropped > self._removed else _REMOVED
        return Gap(first_seq=1, last_seq=max(1, self.seq_end - 1), items=self.dropped, reason=reason)

    @property
    def end_got_to(self) -> int:
        """The value of `got_to` after the step. It takes the late items into account."""
        return max(self.got_to, self._late_end)


def _with_seqs(part: Slice, first: int, end: int) -> Slice:
    """The items of a slice with seqs from `first` up to `end`, exclusive; perhaps an empty slice."""
    lo, hi = max(part.lo, first - part.run.first_seq), min(part.hi, end - part.run.first_seq)
    return Slice(part.run, lo, max(lo, hi))


def _next_time(slices: Sequence[Slice], time: int, lo: int) -> int | None:
    """The first time after `time` in slices of ascending times. `lo`: the row of the first slice to begin at."""
    for at, one in enumerate(slices):
        times = one.run.times
        found = bisect_right(times, time, one.lo if at else max(one.lo, min(lo, one.hi)), one.hi)
        if found < one.hi:
            return times[found]
    return None
