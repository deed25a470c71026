"""Decides which items of an offer a channel accepts (paper, sections 3.2 and 3.4). Pure.

A put of a run has the same result as one put for each item, all at one instant. So `Acceptance` stores one item,
applies retention, and then judges the next item. If it is certain that one step for the whole run has the same result,
`Acceptance` stores the whole run in one step.
"""

from __future__ import annotations

from array import array
from collections.abc import Mapping, Sequence

from stampede_rt.errors import ChannelFull, InFuture, ItemTooLarge, StampedeError, TooOld
from stampede_rt.values.timeline import MAX_INSTANT, format_duration
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.limits import BLOCK
from stampede_rt_channel_host.core.channel.retention import Retention
from stampede_rt_channel_host.core.channel.run import (
    ABSENT,
    ITEM_OVERHEAD_BYTES,
    ColumnRun,
    Run,
    TimeSpan,
    make_run,
    pack,
)
from stampede_rt_channel_host.core.channel.values import Offer, PutOutcome, Rejection, Seal

# the reasons of refusals that `Counters.rejected` counts
REASONS = ("TOO_OLD", "IN_FUTURE", "ITEM_TOO_LARGE", "CHANNEL_FULL", "MALFORMED_RUN", "OVERLOADED")


class Acceptance:
    """Judges offers, stores the accepted items in the holdings, and counts the refused items.

    `advance` is the highest instant of an advance so far, or None if there was no advance.
    """

    __slots__ = ("_channel", "_held", "_rejected", "_retention", "advance")

    def __init__(self, held: Holdings, retention: Retention, name: str) -> None:
        self._held = held
        self._retention = retention
        self._channel = f"channel {name!r}" if name else "the channel"
        self.advance: int | None = None
        self._rejected: dict[str, int] = {}  # nearly all channels refuse nothing, and so keep no zeros

    def put(self, offer: Offer, clock: int, seal: Seal) -> PutOutcome:
        """Accept or refuse each item, until one has to wait for room (see `PutOutcome`).

        Afterwards the channel may hold more than its limits allow. The caller must then collect the oldest items.
        """
        stamp, times = None, offer.times
        if times is None:
            stamp = self.stamp(clock)
            span = TimeSpan(stamp, stamp)
            times = array("q", (stamp,)) * len(offer.lengths)
        else:
            span = offer.span
        payload_bytes = sum(offer.lengths)
        if self._fits_in_one_step(offer.lengths, payload_bytes, span, clock):
            body = seal(self._held.next_seq, None, stamp)
            run = make_run(self._held.next_seq, times, offer.durations, offer.lengths, body, span)
            self._held.store(run, payload_bytes, span)
            return PutOutcome(run=run, stamped_time=stamp)
        return _ItemByItem(self, self._held, self._retention, offer, times, clock).run(stamp, seal)

    def stamp(self, clock: int) -> int:
        """The time for items that have none: NOW, or the least time that the channel accepts, if this is later."""
        now = clock if self._held.newest is None else max(clock, self._held.newest)
        return max(now, self._least_time())

    def _fits_in_one_step(self, lengths: Sequence[int], payload_bytes: int, span: TimeSpan, clock: int) -> bool:
        """Whether the channel accepts every item, and retention after the last item has the same result as retention
        after each item. `span`: the span of the times of these items.

        If all items are later than the cutoff of max_age, none of them is outdated, and none of them moves a bucket's
        end to or below the cutoff. `_drops_the_same` tests the other limits.
        """
        held, limits = self._held, self._retention.limits
        items = len(lengths)
        largest, cutoff = max(lengths), self._retention.cutoff(clock)
        low, high, _ = span
        if high > clock + limits.max_future_nanos or (cutoff is not None and low <= cutoff):
            return False
        if largest > limits.max_item_bytes or largest + ITEM_OVERHEAD_BYTES > limits.max_bytes:
            return False
        if low < self._least_time():
            return False
        if self._retention.has_room(items, payload_bytes):
            return True
        self._retention.apply_time(clock)
        if self._retention.has_room(items, payload_bytes):
            return True
        may_drop = limits.drops_oldest and held.items > 0 and self._retention.consumers is None
        return may_drop and self._drops_the_same(items, payload_bytes, low)

    def _least_time(self) -> int:
        """The least time that an accepted item may have."""
        collected, advance = self._held.newest_collected, self.advance
        least = -MAX_INSTANT - 1 if collected is None else collected
        return least if advance is None else max(least, advance)

    def _drops_the_same(self, items: int, payload_bytes: int, low: int) -> bool:
        """Whether one step for the whole run drops the same items as a step for each item, with equal ends of spans.

        There are two conditions. First, only one of max_items and max_bytes drops items. Second, the bucket after the
        dropped items is held already and begins at or before all new items, so that no new item ends a dropped span
        earlier. The second condition is certain if the new items come in order and no item of the newest bucket is
        dropped.
        """
        held, limits = self._held, self._retention.limits
        comes_in_order = held.newest is not None and low >= held.newest
        if comes_in_order and items == 1:  # one item needs one step in any case, and the newest item is never dropped
            return True
        excess_items = 0 if limits.max_items is None else held.items + items - limits.max_items
        excess_bytes = held.charged_bytes + payload_bytes + items * ITEM_OVERHEAD_BYTES - limits.max_bytes
        if excess_items > 0 and excess_bytes > 0:
            return False
        if comes_in_order and held.reaches_no_newest(excess_items, excess_bytes):
            return True
        oldest = held.oldest_by_count(excess_items) if excess_items > 0 else held.oldest_by_bytes(excess_bytes)
        bound = held.time_after(oldest)
        return bound is not None and bound <= low

    def refuse(self, index: int, error: StampedeError) -> Rejection:
        """Count a refused item, and return its rejection."""
        self.count_rejected(error.reason, 1)
        return Rejection(index, error)

    def count_rejected(self, reason: str, items: int) -> None:
        """Count items that the channel, or its caller, refused for `reason`."""
        self._rejected[reason] = self._rejected.get(reason, 0) + items

    def inherit_rejected(self, rejected: Mapping[str, int]) -> None:
        """Continue the counts of another owner."""
        self._rejected = {reason: items for reason, items in rejected.items() if items}

    @property
    def rejected(self) -> dict[str, int]:
        """The number of refused items for each reason."""
        return dict.fromkeys(REASONS, 0) | self._rejected

    @property
    def refused_items(self) -> int:
        """The number of all refused items."""
        return sum(self._rejected.values())

    def full(self, in_vain: bool = False) -> ChannelFull:
        """The error of an item for which there is no room. `in_vain`: no wait would make room for the item."""
        limits, held = self._retention.limits, self._held
        when = "when consumers have consumed some" if limits.consumers else "when the oldest have grown too old"
        if in_vain:
            when = "with a later time, because the held items are as new as this one, and the newest never grow too old"
        elif limits.consumers is None and limits.max_age_nanos is None:
            when = "later"
        return ChannelFull(
            f"{self._channel} is full: it holds {held.items} items charged with {held.charged_bytes} bytes, of at most "
            f"{limits.max_items or 'any number of'} items and {limits.max_bytes} bytes; put {when}, or raise its limits"
        )

    def fault(self, time: int, duration: int, length: int, clock: int, *, is_stamp: bool) -> StampedeError | None:
        """The error with which the channel refuses an item, however much room there is, or None.

        `is_stamp`: the time is from `stamp`, and not from the producer.
        """
        limits = self._retention.limits
        if length > limits.max_item_bytes or length + ITEM_OVERHEAD_BYTES > limits.max_bytes:
            return ItemTooLarge(
                f"an item of {length} bytes is too large for {self._channel}, which takes at most "
                f"{min(limits.max_item_bytes, limits.max_bytes - ITEM_OVERHEAD_BYTES)}; split it, or raise the limits"
            )
        if time > clock + limits.max_future_nanos:
            return self._in_future(time, clock, is_stamp=is_stamp)
        return self._too_old(time, duration, length, clock)

    def _in_future(self, time: int, clock: int, *, is_stamp: bool) -> InFuture:
        ahead = f"{format_duration(time - clock)} ahead of the host's clock"
        most = f"takes at most {format_duration(self._retention.limits.max_future_nanos)} (max_future)"
        text = f"an item is {ahead}; {self._channel} {most}: set the producer's clock"
        if is_stamp:
            text = (
                f"the newest item or the advance of {self._channel} is {ahead}, and an item without a time would "
                f"be, too; it {most}: set the clock of the host's machine and start the host again, or put with a time"
            )
        return InFuture(text, metadata=_offset(time, clock))

    def _too_old(self, time: int, duration: int, length: int, clock: int) -> TooOld | None:
        """The error of an item that is too old, or None if the item is not too old."""
        why = self._below_promises(time) or self._outdated(time, duration, length, clock)
        if why is None:
            return None
        age = format_duration(clock - time)
        return TooOld(
            f"an item is {age} behind the host's clock and too old for {self._channel}: {why}; put sooner, set the "
            "producer's clock, or widen the channel's limits",
            metadata=_offset(time, clock),
        )

    def _below_promises(self, time: int) -> str | None:
        """A text that names the advance or the collected items that refuse an item at `time`, or None if none do."""
        if self.advance is not None and time < self.advance:
            return f"an advance has promised that nothing before {self.advance} comes"
        collected = self._held.newest_collected
        if collected is not None and time < collected:
            return f"items up to {collected} are collected already"
        return None

    def _outdated(self, time: int, duration: int, length: int, clock: int) -> str | None:
        """A text that says which limit would collect the item right after its acceptance, or None if no limit would."""
        held, limits, age = self._held, self._retention.limits, self._retention.age_of_new
        following = held.next_time(time) if held.oldest is None or time >= held.oldest else held.oldest
        if age is not None and following is not None:
            own_end = held.counted_end(time, None if duration == ABSENT else time + duration, following)
            if max(own_end, held.bucket_end(time, following)) <= clock - age:
                return f"its span ended before the last {format_duration(age)} (max_age)"
        if limits.drops_oldest and limits.max_items is not None:
            excess_items = held.items + 1 - limits.max_items
            if excess_items > 0 and (held.oldest is None or time < held.oldest):
                return f"{limits.max_items} later items are held (max_items)"
        excess_bytes = held.charged_bytes + length + ITEM_OVERHEAD_BYTES - limits.max_bytes
        if limits.drops_oldest and excess_bytes > 0 and not self._precede(time, excess_bytes):
            return f"later items fill its {limits.max_bytes} bytes (max_bytes)"
        return None

    def _precede(self, time: int, charged_bytes: int) -> bool:
        """Whether the held items at or before `time` are charged with at least `charged_bytes`."""
        last = self._held.oldest_by_bytes(charged_bytes).last
        return last is not None and last.last_time <= time


def _offset(time: int, clock: int) -> dict[str, str]:
    """Metadata of errors: how far the item's time is ahead of the host's clock, and the clock."""
    return {"offset_nanos": str(time - clock), "host_time_unix_nano": str(clock)}


class _ItemByItem:
    """Stores the accepted items of one offer in one run, item by item."""

    def __init__(
        self,
        acceptance: Acceptance,
        held: Holdings,
        retention: Retention,
        offer: Offer,
        times: Sequence[int],
        clock: int,
    ) -> None:
        self._acceptance, self._held, self._retention = acceptance, held, retention
        self._offer, self._times, self._clock = offer, times, clock
        self._columns: tuple[list[int], list[int], list[int]] = ([], [], [])
        times_in, durations_in, lengths_in = self._columns
        self._run = ColumnRun(
            held.next_seq, times_in, None if offer.durations is None else durations_in, lengths_in, b""
        )
        self._kept: list[int] = []

    def run(self, stamp: int | None, seal: Seal) -> PutOutcome:
        """Judge one item after the other, and store the accepted ones, until an item has to wait."""
        rejections: list[Rejection] = []
        waiting = retry_at = None
        for index, time in enumerate(self._times):
            duration = ABSENT if self._offer.durations is None else self._offer.durations[index]
            length = self._offer.lengths[index]
            self._retention.apply_time(self._clock)
            fault = self._acceptance.fault(time, duration, length, self._clock, is_stamp=stamp is not None)
            as_if = self._as_if_put_at(time)
            if fault is None and not self._has_room(min(as_if, time), length):
                in_vain = self._retention.makes_no_room_at(as_if)
                if self._retention.limits.on_full == BLOCK and not in_vain:
                    waiting = index
                    retry_at = self._retention.retry_at(as_if, None if duration == ABSENT else as_if + duration)
                    break
                fault = self._acceptance.full(in_vain)
            if fault is None:
                self._take(index, time, duration, length)
            else:
                rejections.append(self._acceptance.refuse(index, fault))
        return PutOutcome(
            run=self._finish(stamp, seal), stamped_time=stamp, rejections=rejections, waiting=waiting, retry_at=retry_at
        )

    def _as_if_put_at(self, time: int) -> int:
        """The time at which an item counts as put while it waits for room.

        This is the item's own time. For an item without a time it is the start of the wait, or the instant after the
        newest item if this is later. The channel gives such an item its time only when it accepts the item. The newest
        bucket never ages, so an item that counted as part of that bucket would wait for ever.
        """
        if self._offer.times is not None:
            return time
        since = self._clock if self._offer.since is None else self._offer.since
        newest = self._held.newest
        return since if newest is None else max(since, newest + 1)

    def _has_room(self, time: int, length: int) -> bool:
        """Whether the channel has room for the item, or makes room by dropping the oldest items."""
        limits = self._retention.limits
        return limits.drops_oldest or self._retention.has_room_as_if_put(time, length, self._clock)

    def _take(self, index: int, time: int, duration: int, length: int) -> None:
        """Add an accepted item to the run, store it, and apply retention."""
        for column, value in zip(self._columns, (time, duration, length), strict=True):
            column.append(value)
        self._kept.append(index)
        self._held.store_item(self._run, len(self._kept) - 1, length)
        self._retention.apply_time(self._clock)
        self._retention.drop_excess(self._clock)
        if self._offer.since is not None and not (
            self._retention.limits.drops_oldest or self._retention.has_room(0, 0)
        ):
            self._retention.release_oldest(self._clock)

    def _finish(self, stamp: int | None, seal: Seal) -> Run | None:
        """Turn the columns into arrays, and set the body of the run. Returns None if no item was accepted."""
        if not self._kept:
            return None
        run = self._run
        run.times, run.lengths = pack(run.times), pack(run.lengths)
        run.durations = None if run.durations is None else pack(run.durations)
        all_kept = len(self._kept) == len(self._times)
        run.body = seal(run.first_seq, None if all_kept else self._kept, stamp)
        self._held.count_body(run)
        return run
