"""Decides when items leave a channel (paper, section 3.4): by age, count, bytes or consumption. Pure.

Consumption takes the oldest items, in order, as soon as no consumer has still to consume them. A consumed item in the
middle stays until the items before it go. If it went first, the span of the item before it would grow. With
`max_age_unconsumed` the age depends on the slowest live consumer. Items that all live consumers have consumed go at
max_age. The others go later, at max_age_unconsumed at the latest.

`clock` is the host's clock. The time model's `now` is the later of the clock and the newest item's time. But items age
by the clock alone. So a producer whose clock is ahead does not shorten the other producers' window.
"""

from __future__ import annotations

from stampede_rt_channel_host.core.channel.consumption import Consumers
from stampede_rt_channel_host.core.channel.front import Going, before
from stampede_rt_channel_host.core.channel.held_items import AGE, BYTES, CONSUMPTION, COUNT
from stampede_rt_channel_host.core.channel.holdings import Holdings
from stampede_rt_channel_host.core.channel.index import FIRST_KEY, ItemKey
from stampede_rt_channel_host.core.channel.limits import ChannelLimits
from stampede_rt_channel_host.core.channel.run import ITEM_OVERHEAD_BYTES, Slice

SLICES_USED_UP_MAX = 64
"""The most slices that one call frees by consumption, so that a consumer that catches up delays no other caller."""
ENTRIES_PER_LOOK = 8
"""The most index entries or ranges of seqs that one step of `learn_gone` looks at."""
SLICES_AGED_MAX = 256
"""The most slices that one call checks for items that a consumer has still to consume, if age depends on that."""
CONSUMERS_ASKED_MAX = 512
"""After this number of looks at single consumers, one call takes no further slice."""


class Retention:
    """Applies limits to holdings. `consumers` is None if the limits count no consumption."""

    __slots__ = (
        "_consumed_to", "_has_more_to_age", "_has_more_to_ask", "_has_more_used_up", "_held", "_unknown_from",
        "_unknown_to", "consumers", "limits",
    )  # fmt: skip

    def __init__(self, limits: ChannelLimits, held: Holdings) -> None:
        self._held = held
        self._has_more_to_age = self._has_more_to_ask = self._has_more_used_up = False
        # A key, and `Consumers.arrivals` when the key was noted. All consumers of that moment have consumed the items
        # of the key's bucket that lie below the key.
        self._consumed_to: tuple[ItemKey, int] = FIRST_KEY, 0
        self._unknown_from = self._unknown_to = 1  # the consumers do not know which seqs between the two are gone
        self.consumers: Consumers | None = None
        self.set_limits(limits)

    def set_limits(self, limits: ChannelLimits) -> None:
        """Set other limits.

        If they count consumption and the present ones do not, the next calls of `learn_gone` walk the index once.
        """
        self.limits = limits
        self._held.overlap_nanos = limits.overlap_nanos
        places = limits.consumer_places
        if not places:
            self.consumers = None
            self._held.tell(None)
            self._has_more_to_age = self._has_more_to_ask = self._has_more_used_up = False
        elif self.consumers is None:
            self.consumers = Consumers(places)
            self._consumed_to = FIRST_KEY, 0
            self._unknown_from, self._unknown_to = 1, self._held.next_seq
            self._held.tell(self.consumers.let_go)
        else:
            self.consumers.resize(places)

    def learn_gone(self, slices_max: int) -> bool:
        """Tell the consumers of about `slices_max` collected slices. Returns True if more are left."""
        consumers, held = self.consumers, self._held
        if consumers is None:
            return False
        if held.report_gone(slices_max):
            return True
        seq, end = self._unknown_from, self._unknown_to
        for _ in range(max(1, slices_max // 4) if seq < end else 0):
            first = held.seq_from(seq, end, ENTRIES_PER_LOOK)
            seq = consumers.let_go_some(seq, first, ENTRIES_PER_LOOK)
            if seq == first:
                seq = held.held_up_to(first, end, ENTRIES_PER_LOOK)
            if seq >= end:
                break
        self._unknown_from = seq
        return seq < end

    @property
    def has_more(self) -> bool:
        """Whether more items may be ready for collection. The next call collects them."""
        return self._has_more_to_age or self._has_more_to_ask or self._has_more_used_up

    def apply_time(self, clock: int) -> None:
        """Apply the passing of time: end leases, and collect buckets that are too old or consumed."""
        if self.consumers is None:
            self.age_out(clock)
            return
        self.consumers.expire(clock)
        self.age_out(clock)
        while self.use_up(clock) and self.age_out(clock):
            pass  # without the consumed items the bucket's span may end sooner, and then the next bucket may be due

    def cutoff(self, clock: int) -> int | None:
        """The channel collects buckets whose last span ended at or before this instant, except those that a live
        consumer has still to consume.

        It collects no other bucket by age.
        """
        age = self.limits.max_age_nanos
        return None if age is None else clock - age

    @property
    def age_of_new(self) -> int | None:
        """The max_age of an item that no consumer has consumed yet."""
        longest = self.limits.max_age_unconsumed_nanos
        owed = longest is not None and self.consumers is not None and self.consumers.live
        return longest if owed else self.limits.max_age_nanos

    def age_out(self, clock: int) -> bool:
        """Collect the buckets that are too old, as whole buckets, never the newest. Returns True if there were any."""
        cutoff = self.cutoff(clock)
        held = self._held
        self._has_more_to_age = False
        if cutoff is None or held.oldest is None or held.oldest > cutoff or held.oldest == held.newest:
            return False
        bound = self._age_bound(cutoff)
        if bound is not None and self.limits.max_age_unconsumed_nanos is not None:
            bound = self._prolonged(bound, clock - self.limits.max_age_unconsumed_nanos)
        if bound is None:
            return False
        front = held.front_before(bound)
        held.outdate(front, AGE, clock)
        return front.items > 0

    def _age_bound(self, cutoff: int) -> int | None:
        """The time of the first bucket that is not too old.

        Span ends ascend with the buckets, so one bucket decides.
        """
        oldest = self._held.oldest
        bucket = self._held.floor_time(cutoff - self._held.overlap_nanos)
        if bucket is None:  # with overlap the oldest bucket may have begun before the cutoff and stay
            return None if oldest is None or oldest > cutoff else oldest
        following = self._held.next_time(bucket)
        if following is None or self._held.bucket_end(bucket, following) > cutoff:
            return bucket
        return following

    def _prolonged(self, bound: int, cutoff: int) -> int:
        """The time of the first bucket that stays, if the buckets before `bound` are past max_age.

        A bucket that a consumer has still to consume stays until `cutoff` passes it, and so do all later buckets.
        Checks the buckets that go and one slice more. A very long check takes several calls.
        """
        owed = self._first_owed(self._age_bound(cutoff), bound)
        return bound if owed is None else owed

    def _first_owed(self, start: int | None, end: int) -> int | None:
        """The time of the first item from `start` up to `end`, exclusive, that a live consumer has still to consume.

        None: there is no such item. After very many consumed items the search returns the time that it reached. In a
        very large bucket the next call continues the search at the same place.
        """
        consumers = self.consumers
        assert consumers is not None, "limits that ask for it count consumption"
        self._has_more_to_ask = False
        if not consumers.live:
            return None
        bucket, asked_before = self._bucket_from(start), consumers.looked_at
        known, arrivals = self._consumed_to
        is_known = known[0] == bucket and arrivals == consumers.arrivals
        for at, part in enumerate(self._held.slices(known if is_known else (bucket, 0), (end, 0))):
            asked = consumers.looked_at - asked_before
            if at >= SLICES_AGED_MAX or asked >= CONSUMERS_ASKED_MAX:
                return self._asked_as_far_as(part.first_time, bucket)
            done = consumers.done_with(part)
            if part.run.times[part.lo + max(0, done - 1)] == bucket:
                self._consumed_to = (bucket, part.first_seq + done), consumers.arrivals
            if done < part.items:
                return part.run.times[part.lo + done]
        return None

    def _bucket_from(self, start: int | None) -> int:
        """The later of `start` and the oldest bucket's time. `start`: a bucket's time; None: the oldest bucket's."""
        oldest = self._held.oldest
        assert oldest is not None, "the caller has checked that the channel holds items"
        return oldest if start is None else max(start, oldest)

    def _asked_as_far_as(self, time: int, first: int) -> int:
        """Note that the check reached `time`, and return it.

        A bucket goes as a whole, so nothing goes while the first bucket is only partly checked.
        """
        self._has_more_to_age = time > first
        self._has_more_to_ask = time == first
        return time

    def ask_on(self) -> None:
        """Continue to check whether all consumers have consumed a very large oldest bucket, if that is unknown."""
        if self._has_more_to_ask:
            self._age_of_oldest()

    def _age_of_oldest(self) -> int | None:
        """The max_age that holds for the oldest bucket at present."""
        longest, oldest = self.limits.max_age_unconsumed_nanos, self._held.oldest
        self._has_more_to_ask = False
        if longest is None or oldest is None or self._first_owed(oldest, oldest + 1) is None:
            return self.limits.max_age_nanos
        return longest

    def next_due(self) -> int | None:
        """The instant at which time alone next collects an item or ends a consumer's lease; None: there is none."""
        held, age = self._held, self._age_of_oldest()
        following = None if held.oldest is None else held.next_time(held.oldest)
        if age is None or held.oldest is None or following is None:
            return self._lease_end()
        return self._or_lease_end(held.bucket_end(held.oldest, following) + age)

    def _lease_end(self) -> int | None:
        """The next lease end of a consumer that may keep items."""
        return None if self.consumers is None or not self._held.items else self.consumers.next_lease_end

    def _or_lease_end(self, instant: int) -> int:
        end = self._lease_end()
        return instant if end is None else min(instant, end)

    def use_up(self, clock: int) -> bool:
        """Collect the oldest items that all consumers have consumed, a bounded part. Returns True if there were any.

        Looks at the items that go and one slice more, and frees the items. So the cost of each item is the same,
        however many go together. If no consumer keeps anything, all items but the newest bucket go, because a
        new consumer begins with the newest item.
        """
        self._has_more_used_up = False
        consumers, held = self.consumers, self._held
        if consumers is None or self.limits.consumers is None or consumers.untaken or held.newest is None:
            return False
        going = _AtMost(SLICES_USED_UP_MAX, consumers.done_with if consumers.live else before(held.newest), consumers)
        front = held.front(going)
        self._has_more_used_up = going.held_back
        if front.items:
            held.outdate(front, CONSUMPTION, clock)
            held.free(SLICES_USED_UP_MAX)
        return front.items > 0

    @property
    def _nobody_holds(self) -> bool:
        """Whether all places were taken, and all their leases have ended."""
        consumers = self.consumers
        if consumers is None or self.limits.consumers is None:
            return False
        return not consumers.untaken and not consumers.live

    def drop_excess(self, clock: int) -> None:
        """Collect the oldest items beyond the limits, if the policy of a full channel is to drop them."""
        held, limits = self._held, self.limits
        if not limits.drops_oldest:
            return
        if limits.max_items is not None and held.items > limits.max_items:
            held.outdate(held.front_of_items(held.items - limits.max_items), COUNT, clock)
        if held.charged_bytes > limits.max_bytes:
            held.outdate(held.front_of_bytes(held.charged_bytes - limits.max_bytes), BYTES, clock)

    def has_room(self, items: int, payload_bytes: int) -> bool:
        """Whether `items` more items fit in without the collection of others."""
        held, limits = self._held, self.limits
        within_items = limits.max_items is None or held.items + items <= limits.max_items
        return within_items and held.charged_bytes + payload_bytes + items * ITEM_OVERHEAD_BYTES <= limits.max_bytes

    def has_room_as_if_put(self, time: int, payload_bytes: int, clock: int) -> bool:
        """Whether one item at `time` fits in.

        If the item ends the oldest bucket's span early enough, that bucket is collected first and makes room.
        """
        if self.has_room(1, payload_bytes):
            return True
        freed_items, freed_bytes = self._freed_by(time, payload_bytes, clock)
        return freed_items > 0 and self.has_room(1 - freed_items, payload_bytes - freed_bytes)

    def _freed_by(self, time: int, payload_bytes: int, clock: int) -> tuple[int, int]:
        """The items and payload bytes that would be collected because an item at `time` comes in.

        By age: the item changes only the end of the bucket before it, and only the oldest bucket can go first. By
        consumption: if no consumer keeps anything, all items before the newest bucket go, perhaps the item at
        `time` itself.
        """
        held = self._held
        if self._nobody_holds and held.newest is not None and time != held.newest:
            return (held.items, held.payload_bytes) if time > held.newest else (1, payload_bytes)
        age = self._age_of_oldest()
        if age is None or held.oldest is None or held.oldest >= time:
            return 0, 0
        following = held.next_time(held.oldest)
        if (following is not None and following <= time) or held.bucket_end(held.oldest, time) > clock - age:
            return 0, 0
        bucket = held.front_before(held.oldest + 1)
        return bucket.items, bucket.payload_bytes

    def release_oldest(self, clock: int) -> None:
        """Collect the oldest bucket, after the put of the item that needed its room."""
        oldest = self._held.oldest
        following = None if oldest is None else self._held.next_time(oldest)
        if following is not None:
            self._held.outdate(self._held.front_before(following), AGE, clock)

    def makes_no_room_at(self, time: int) -> bool:
        """Whether only the bucket at `time` is held, so that no wait makes room for an item at `time`.

        The newest bucket never grows too old, and the channel counts no consumption.
        """
        return self.limits.consumers is None and self._held.oldest == self._held.newest == time

    def retry_at(self, time: int, own_end: int | None) -> int | None:
        """When the passing of time next makes room for an item at `time`. `own_end` is its end by duration, if any.

        This is the earlier of two instants: when the channel with the item collects something, and when the channel
        without it does. The second may be earlier if the item would belong to the oldest bucket. None: only another put
        or a consumption makes room.
        """
        instants = (self._due_as_if_put(time, own_end), self.next_due())
        return min((one for one in instants if one is not None), default=None)

    def _due_as_if_put(self, time: int, own_end: int | None) -> int | None:
        held, age = self._held, self.age_of_new
        if self._nobody_holds and held.newest is not None and time > held.newest:
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


class _AtMost:
    """Counts like `going`, but in a bounded number of slices, and in fewer slices if it checks very many consumers.

    `held_back`: the count stopped at one of these limits.
    """

    __slots__ = ("_asked_to", "_consumers", "_going", "_left", "held_back")

    def __init__(self, slices: int, going: Going, consumers: Consumers) -> None:
        self._going = going
        self._left = slices
        self._consumers = consumers
        self._asked_to = consumers.looked_at + CONSUMERS_ASKED_MAX
        self.held_back = False

    def __call__(self, part: Slice) -> int:
        self._left -= 1
        self.held_back = self._left < 0 or self._consumers.looked_at >= self._asked_to
        return 0 if self.held_back else self._going(part)
