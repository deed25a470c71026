"""Decides when items leave a channel (paper, section 3.4): by age, count, bytes or consumption. Pure.

Consumption collects the oldest items, in order, as soon as no consumer has still to consume them. A consumed item in
the middle stays until the items before it are collected. Otherwise the span of the item before it would grow. A
consumer is live while the lease of its place is valid. An item is owed if a live consumer has still to consume it. With
`max_age_unconsumed` the channel collects an item that is not owed at max_age, and an owed item at max_age_unconsumed.

`clock` is the host's clock. The time model's `now` is the later of the clock and the newest item's time. But items age
by the clock alone. So a producer whose clock is ahead does not shorten the other producers' window.
"""

from __future__ import annotations

from stampede_rt_channel_host.core.channel.archive_backlog import ArchiveBacklog, archived_part, count_leaving, low_of
from stampede_rt_channel_host.core.channel.consumption import CONSUMERS_CHECKED_MAX, BoundedCount, Consumers
from stampede_rt_channel_host.core.channel.earlier_items import EarlierItems
from stampede_rt_channel_host.core.channel.held_items import AGE, BYTES, CONSUMPTION, COUNT
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.item_keys import FIRST_KEY, ItemKey
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.channel.oldest_items import before
from stampede_rt_channel_host.core.channel.retention_steps import (
    BACKLOG_ENTRIES_MAX,
    READS_RETRY_NANOS,
    SLICES_AGED_MAX,
    SLICES_CONSUMED_MAX,
)
from stampede_rt_channel_host.core.channel.run import ITEM_OVERHEAD_BYTES


class Retention:
    """Applies limits to holdings. `consumers` is None if the limits have no consumer places."""

    __slots__ = (
        "_consumed_to", "_earlier", "_has_more_consumed", "_has_more_to_age", "_held", "_owed_check_goes_on",
        "_retry_after_reads", "consumers", "limits", "unarchived",
    )  # fmt: skip

    def __init__(self, limits: ChannelLimits, held: Holdings) -> None:
        self._held = held
        self._has_more_to_age = self._owed_check_goes_on = self._has_more_consumed = False
        self._retry_after_reads: int | None = None  # while consumption waits for long reads: the time of the next check
        # A key, and `PlaceTable.arrivals` when the key was noted. All consumers with a place at that moment have
        # consumed the items of the key's bucket that lie below the key.
        self._consumed_to: tuple[ItemKey, int] = FIRST_KEY, 0
        self._earlier: EarlierItems | None = None  # None: all earlier items are noted, or there are no consumers
        self.consumers: Consumers | None = None
        self.unarchived: ArchiveBacklog | None = None  # set for a recorded channel: only max_bytes collects these items
        self.set_limits(limits)

    def set_limits(self, limits: ChannelLimits) -> None:
        """Set other limits.

        If the new limits have consumer places and the present limits have none, the next calls of `report_collected`
        scan the index once.
        """
        self.limits = limits
        self._held.overlap_nanos = limits.overlap_nanos
        places = limits.consumer_places
        if not places:
            self.consumers = None
            self._held.report_gone_to(None)
            self._has_more_to_age = self._owed_check_goes_on = self._has_more_consumed = False
            self._retry_after_reads = None
        elif self.consumers is None:
            self.consumers = Consumers(places)
            self._consumed_to = FIRST_KEY, 0
            self._earlier = EarlierItems(self._held, self._held.next_seq)
            self._held.report_gone_to(self.consumers.note_collected)
        else:
            self.consumers.table.resize(places)
            self.consumers.changes += 1

    def report_collected(self, slices_max: int) -> bool:
        """Tell the consumers of about `slices_max` collected slices. Returns True if more are left."""
        consumers = self.consumers
        if consumers is None or self._held.report_gone(slices_max):
            return consumers is not None
        if self._earlier is not None and not self._earlier.report_to(consumers, max(1, slices_max // 4)):
            self._earlier = None
        return self._earlier is not None

    @property
    def has_more(self) -> bool:
        """Whether an earlier call stopped at a bound of its work, so that more items may be ready for collection."""
        return self._has_more_to_age or self._owed_check_goes_on or self._has_more_consumed

    def apply_time(self, clock: int) -> None:
        """Apply the passing of time: end leases, and collect buckets that are too old or consumed."""
        if self.consumers is None:
            self.age_out(clock)
            return
        self.consumers.table.expire(clock)
        self.age_out(clock)
        while self.collect_consumed(clock) and self.age_out(clock):
            pass  # without the consumed items, the oldest bucket may end sooner, and so may now be too old

    def cutoff(self, clock: int) -> int | None:
        """By age, the channel collects only buckets whose last span ended at or before this instant.

        Of these it keeps the buckets that a live consumer has still to consume, until `max_age_unconsumed`. None if
        there is no limit of age.
        """
        age = self.limits.max_age_nanos
        return None if age is None else clock - age

    @property
    def age_of_new(self) -> int | None:
        """The limit of age of an item that no consumer has consumed yet: max_age_unconsumed if a consumer is live."""
        longest = self.limits.max_age_unconsumed_nanos
        owed = longest is not None and self.consumers is not None and self.consumers.table.live
        return longest if owed else self.limits.max_age_nanos

    def age_out(self, clock: int) -> bool:
        """Collect the buckets that are too old, always whole buckets, and never the newest bucket.

        Returns True if an item was collected.
        """
        cutoff = self.cutoff(clock)
        held = self._held
        self._has_more_to_age = False
        if cutoff is None or held.oldest is None or held.oldest > cutoff or held.oldest == held.newest:
            return False
        bound = self._age_bound(cutoff)
        if bound is not None and self.limits.max_age_unconsumed_nanos is not None:
            bound = self._prolonged(bound, clock - self.limits.max_age_unconsumed_nanos)
        kept = low_of(self.unarchived)
        if bound is None or (kept is not None and kept[0] <= held.oldest):
            return False
        oldest = held.oldest_before(bound if kept is None else min(bound, kept[0]))
        held.outdate(oldest, AGE, clock)
        return oldest.items > 0

    def _age_bound(self, cutoff: int) -> int | None:
        """The time of the first bucket that is not too old. May be None if this is the oldest bucket.

        A later bucket never ends earlier, so the search looks at the spans of one bucket only.
        """
        oldest = self._held.oldest
        bucket = self._held.last_time_up_to(cutoff - self._held.overlap_nanos)
        if bucket is None:  # with overlap the oldest bucket may have begun before the cutoff and stay
            return None if oldest is None or oldest > cutoff else oldest
        following = self._held.next_time(bucket)
        if following is None or self._held.bucket_end(bucket, following) > cutoff:
            return bucket
        return following

    def _prolonged(self, bound: int, cutoff: int) -> int:
        """The time of the first bucket that stays, if the buckets before `bound` are past max_age.

        A bucket with an owed item stays as long as its last span ends after `cutoff`. All buckets after it stay, too.
        The method checks the buckets to collect and one slice more. A very long check takes several calls.
        """
        owed = self._first_owed(self._age_bound(cutoff), bound)
        return bound if owed is None else owed

    def _first_owed(self, start: int | None, end: int) -> int | None:
        """The time of the first owed item from `start` up to `end`, exclusive, or None if there is no owed item.

        After very many consumed items the search stops, and returns the time that it has reached. If it has stopped
        within a very large bucket, the next call continues there.
        """
        consumers = self.consumers
        assert consumers is not None, "limits that ask for it count consumption"
        self._owed_check_goes_on = False
        if not consumers.table.live:
            return None
        bucket, checked_before = self._bucket_from(start), consumers.looked_at
        known, arrivals = self._consumed_to
        is_known = known[0] == bucket and arrivals == consumers.table.arrivals
        for at, part in enumerate(self._held.slices(known if is_known else (bucket, 0), (end, 0))):
            checks = consumers.looked_at - checked_before
            if at >= SLICES_AGED_MAX or checks >= CONSUMERS_CHECKED_MAX:
                return self._stop_owed_check(part.first_time, bucket)
            done = consumers.done_with(part)
            if part.run.times[part.lo + max(0, done - 1)] == bucket:
                self._consumed_to = (bucket, part.first_seq + done), consumers.table.arrivals
            if done < part.items:
                return part.run.times[part.lo + done]
        return None

    def _bucket_from(self, start: int | None) -> int:
        """The later of `start`, which is the time of a bucket, and the oldest bucket's time. `start` may be None."""
        oldest = self._held.oldest
        assert oldest is not None, "the caller has checked that the channel holds items"
        return oldest if start is None else max(start, oldest)

    def _stop_owed_check(self, time: int, first: int) -> int:
        """Note that the check stopped at `time`, and return `time`. `first` is the time of the first checked bucket.

        The channel collects whole buckets only, so it collects nothing while the first bucket is only partly checked.
        """
        self._has_more_to_age = time > first
        self._owed_check_goes_on = time == first
        return time

    def continue_owed_check(self) -> None:
        """Continue the check whether a very large oldest bucket has an owed item, if a call has stopped this check."""
        if self._owed_check_goes_on:
            self._age_of_oldest()

    def _age_of_oldest(self) -> int | None:
        """The limit of age that holds for the oldest bucket at present: max_age or max_age_unconsumed."""
        longest, oldest = self.limits.max_age_unconsumed_nanos, self._held.oldest
        self._owed_check_goes_on = False
        if longest is None or oldest is None or self._first_owed(oldest, oldest + 1) is None:
            return self.limits.max_age_nanos
        return longest

    def next_due(self) -> int | None:
        """The instant at which the passing of time next makes an item too old or ends a consumer's lease, or None.

        Returns an earlier instant if consumption waits for long reads.
        """
        held, age = self._held, self._age_of_oldest()
        following = None if held.oldest is None else held.next_time(held.oldest)
        instants = [self._retry_after_reads, self._lease_end()]
        kept = low_of(self.unarchived)
        # The oldest item cannot leave by age before the archive has it.
        waits = kept is not None and held.oldest is not None and kept[0] <= held.oldest
        if age is not None and held.oldest is not None and following is not None and not waits:
            instants.append(held.bucket_end(held.oldest, following) + age)
        return min((one for one in instants if one is not None), default=None)

    def _lease_end(self) -> int | None:
        """The next end of a consumer's lease, or None if no lease keeps items."""
        return None if self.consumers is None or not self._held.items else self.consumers.table.next_lease_end

    def _or_lease_end(self, instant: int) -> int:
        """The earlier of `instant` and the next lease end."""
        end = self._lease_end()
        return instant if end is None else min(instant, end)

    def collect_consumed(self, clock: int) -> bool:
        """Collect and free the oldest items that all consumers have consumed, at most SLICES_CONSUMED_MAX slices.

        Returns True if an item was collected. Looks at the items to collect and one slice more. So the cost of each
        item is the same, however many are collected together. If all leases have ended, collects all items except the
        newest bucket, because a new consumer begins with the newest item. Respects BACKLOG_ENTRIES_MAX.
        """
        self._has_more_consumed, self._retry_after_reads = False, None
        consumers, held = self.consumers, self._held
        if consumers is None or self.limits.consumers is None or consumers.table.untaken or held.newest is None:
            return False
        if held.has_outdated(BACKLOG_ENTRIES_MAX):
            self._has_more_consumed = held.has_backlog_of(1)
            self._retry_after_reads = None if self._has_more_consumed else clock + READS_RETRY_NANOS
            return False
        count = consumers.done_with if consumers.table.live else before(held.newest)
        bounded = BoundedCount(SLICES_CONSUMED_MAX, count, consumers)
        oldest = held.oldest_items(bounded)
        self._has_more_consumed = bounded.held_back
        if oldest.items:
            held.outdate(oldest, CONSUMPTION, clock)
            held.free(SLICES_CONSUMED_MAX)
        return oldest.items > 0

    @property
    def _no_place_holds(self) -> bool:
        """Whether every place was taken, and every lease has ended."""
        consumers = self.consumers
        if consumers is None or self.limits.consumers is None:
            return False
        return not consumers.table.untaken and not consumers.table.live

    def drop_excess(self, clock: int) -> None:
        """Collect the oldest items above max_items and max_bytes, if the policy is to drop them (on_full)."""
        held, limits = self._held, self.limits
        if not limits.drops_oldest:
            return
        if limits.max_items is not None and held.items > limits.max_items:
            oldest = archived_part(held, held.oldest_by_count(held.items - limits.max_items), self.unarchived)
            held.outdate(oldest, COUNT, clock)
        if held.charged_bytes > limits.max_bytes:
            oldest = held.oldest_by_bytes(held.charged_bytes - limits.max_bytes)
            count_leaving(self.unarchived, oldest)
            held.outdate(oldest, BYTES, clock)

    def has_room(self, items: int, payload_bytes: int) -> bool:
        """Whether the channel has room for `items` more items without the collection of other items."""
        held, limits = self._held, self.limits
        within_items = limits.max_items is None or held.items + items <= limits.max_items
        return within_items and held.charged_bytes + payload_bytes + items * ITEM_OVERHEAD_BYTES <= limits.max_bytes

    def has_room_as_if_put(self, time: int, payload_bytes: int, clock: int) -> bool:
        """Whether the channel has room for one item at `time`, now or as a result of its put.

        The put may end the oldest bucket's span so early that this bucket is too old. Its collection then makes room.
        """
        if self.has_room(1, payload_bytes):
            return True
        freed_items, freed_bytes = self._freed_by(time, payload_bytes, clock)
        return freed_items > 0 and self.has_room(1 - freed_items, payload_bytes - freed_bytes)

    def _freed_by(self, time: int, payload_bytes: int, clock: int) -> tuple[int, int]:
        """The number and payload bytes of the items that the channel would collect because of a put of an item at
        `time`.

        By age it may collect the oldest bucket, if the new item ends this bucket's span. By consumption, if all leases
        have ended, it collects all items before the newest bucket, perhaps the new item itself.
        """
        held = self._held
        if self._no_place_holds and held.newest is not None and time != held.newest:
            return (held.items, held.payload_bytes) if time > held.newest else (1, payload_bytes)
        age = self._age_of_oldest()
        if age is None or held.oldest is None or held.oldest >= time:
            return 0, 0
        following = held.next_time(held.oldest)
        if (following is not None and following <= time) or held.bucket_end(held.oldest, time) > clock - age:
            return 0, 0
        bucket = held.oldest_before(held.oldest + 1)
        return bucket.items, bucket.payload_bytes

    def release_oldest(self, clock: int) -> None:
        """Collect the oldest bucket, after the put of an item that needed the bucket's room."""
        oldest = self._held.oldest
        following = None if oldest is None else self._held.next_time(oldest)
        if following is not None:
            self._held.outdate(self._held.oldest_before(following), AGE, clock)

    def makes_no_room_at(self, time: int) -> bool:
        """Whether only the bucket at `time` is held, so that no wait makes room for an item at `time`.

        The newest bucket never grows too old, and the channel counts no consumption.
        """
        return self.limits.consumers is None and self._held.oldest == self._held.newest == time

    def retry_at(self, time: int, own_end: int | None) -> int | None:
        """The instant at which the passing of time next makes room for an item at `time`.

        `own_end` is the item's time plus its duration, or None. The method finds the next collection twice: as if the
        channel had the item, and without it. It returns the earlier instant. The second collection may be earlier if
        the item would belong to the oldest bucket. Returns None if only another put or a consumption makes room.
        """
        instants = (self._due_as_if_put(time, own_end), self.next_due())
        return min((one for one in instants if one is not None), default=None)

    def _due_as_if_put(self, time: int, own_end: int | None) -> int | None:
        """The instant of the next collection or lease end if the channel had the item, or None."""
        held, age = self._held, self.age_of_new
        if self._no_place_holds and held.newest is not None and time > held.newest:
            return time
        if age is None or held.oldest is None:
            return self._lease_end()
        if time < held.oldest:
            return self._or_lease_end(held.counted_end(time, own_end, held.oldest) + age)
        following = held.next_time(held.oldest)
        if time == held.oldest:
            if following is None:
                return self._lease_end()
            own = held.counted_end(time, own_end, following)
            return self._or_lease_end(max(held.bucket_end(held.oldest, following), own) + age)
        end = held.bucket_end(held.oldest, time if following is None else min(time, following))
        return self._or_lease_end(end + (self._age_of_oldest() or age))
