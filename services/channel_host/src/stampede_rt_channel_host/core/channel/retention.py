"""When items go (paper, section 3.4): by age, by count, by bytes, by consumption. Pure.

Consumption takes the oldest items, one after the other, as far as nobody holds them back any more: one in the middle
stays until those before it go, since without it the span of the item before would grow. `max_age_unconsumed` lets the
age follow the slowest live consumer: what all of these have consumed goes at max_age, the rest later, at that at most.

`clock` is the host's clock; `now` in the docstrings of the time model is the later of it and the newest item's time,
but items age by the clock alone, so that a producer whose clock runs ahead shortens nobody's window.
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
"""The most slices that one call frees by consumption. A consumer that catches up after a long delay stalls nobody."""
ENTRIES_PER_LOOK = 8
SLICES_AGED_MAX = 256
"""Of so many slices one call asks whether all consumers have consumed them, where ageing depends on that."""
CONSUMERS_ASKED_MAX = 512
"""After so many looks at single consumers one call asks of no further slice."""


class Retention:
    """Applies limits to holdings. `consumers` is None where the limits count no consumption: nothing is kept then."""

    __slots__ = (
        "_consumed_to", "_has_more_to_age", "_has_more_to_ask", "_has_more_used_up", "_held", "_unknown_from",
        "_unknown_to", "consumers", "limits",
    )  # fmt: skip

    def __init__(self, limits: ChannelLimits, held: Holdings) -> None:
        self._held = held
        self._has_more_to_age = self._has_more_to_ask = self._has_more_used_up = False
        # Consumers that were there at that count of arrivals have consumed the items of one bucket that are below it.
        self._consumed_to: tuple[ItemKey, int] = FIRST_KEY, 0
        self._unknown_from = self._unknown_to = 1  # consumers do not know which seqs in between are gone
        self.consumers: Consumers | None = None
        self.set_limits(limits)

    def set_limits(self, limits: ChannelLimits) -> None:
        """Other limits from now on. If they are the first that count consumption, `learn_gone` walks the index once."""
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
        """Let consumers know what was collected, of about so many slices; True if there is more."""
        consumers, held = self.consumers, self._held
        if consumers is None:
            return False
        if held.tell_gone(slices_max):
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
        """There may be more to collect at once, which the next call does."""
        return self._has_more_to_age or self._has_more_to_ask or self._has_more_used_up

    def apply_time(self, clock: int) -> None:
        """Apply the passing of time: end leases, and collect buckets that are too old or not held back any more."""
        if self.consumers is None:
            self.age_out(clock)
            return
        self.consumers.expire(clock)
        self.age_out(clock)
        while self.use_up(clock) and self.age_out(clock):
            pass  # a bucket may end sooner without what was used up, and then lays bare what is behind it

    def cutoff(self, clock: int) -> int | None:
        """Buckets whose last span ended at or before this instant go, unless a live consumer has yet to consume them;
        none goes earlier."""
        age = self.limits.max_age_nanos
        return None if age is None else clock - age

    @property
    def age_of_new(self) -> int | None:
        """The max_age that holds for an item that nobody has consumed yet."""
        longest = self.limits.max_age_unconsumed_nanos
        owed = longest is not None and self.consumers is not None and self.consumers.live
        return longest if owed else self.limits.max_age_nanos

    def age_out(self, clock: int) -> bool:
        """Collect the buckets that are past the age: whole ones, never the newest. True if there were any."""
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
        """The time of the first bucket that age leaves. Span ends ascend with the buckets, so one bucket decides."""
        oldest = self._held.oldest
        bucket = self._held.floor_time(cutoff - self._held.overlap_nanos)
        if bucket is None:  # where items overlap, the oldest bucket may have begun before the cutoff and stay
            return None if oldest is None or oldest > cutoff else oldest
        following = self._held.next_time(bucket)
        if following is None or self._held.bucket_end(bucket, following) > cutoff:
            return bucket
        return following

    def _prolonged(self, bound: int, cutoff: int) -> int:
        """The first bucket that age leaves if it may take those before `bound`: one that is owed stays until `cutoff`
        has passed it, and so do all behind it. Looks at what goes and one slice more; at very many in several calls."""
        owed = self._first_owed(self._age_bound(cutoff), bound)
        return bound if owed is None else owed

    def _first_owed(self, start: int | None, end: int) -> int | None:
        """The time of the first item from `start` on, and before `end`, that a live consumer has yet to consume; or, of
        very many that none has, how far it has looked. In a very large bucket the next call goes on where it stopped.
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
        """The time of the first bucket from there on, which is the time of one; None: the oldest."""
        oldest = self._held.oldest
        assert oldest is not None, "nothing ages where nothing is held"
        return oldest if start is None else max(start, oldest)

    def _asked_as_far_as(self, time: int, first: int) -> int:
        """A bucket goes as a whole: nothing goes before the first one is looked through."""
        self._has_more_to_age = time > first
        self._has_more_to_ask = time == first
        return time

    def ask_on(self) -> None:
        """Go on asking whether all consumers have consumed a very large oldest bucket, if that is not known yet."""
        if self._has_more_to_ask:
            self._age_of_oldest()

    def _age_of_oldest(self) -> int | None:
        """The max_age that holds for the oldest bucket as it is."""
        longest, oldest = self.limits.max_age_unconsumed_nanos, self._held.oldest
        self._has_more_to_ask = False
        if longest is None or oldest is None or self._first_owed(oldest, oldest + 1) is None:
            return self.limits.max_age_nanos
        return longest

    def next_due(self) -> int | None:
        """When time alone next takes something, or a consumer's place; None: never, if nothing else happens."""
        held, age = self._held, self._age_of_oldest()
        following = None if held.oldest is None else held.next_time(held.oldest)
        if age is None or held.oldest is None or following is None:
            return self._lease_end()
        return self._or_lease_end(held.bucket_end(held.oldest, following) + age)

    def _lease_end(self) -> int | None:
        """When the next lease ends of a consumer that may hold items back."""
        return None if self.consumers is None or not self._held.items else self.consumers.next_lease_end

    def _or_lease_end(self, instant: int) -> int:
        end = self._lease_end()
        return instant if end is None else min(instant, end)

    def use_up(self, clock: int) -> bool:
        """Collect the oldest items that all consumers have consumed, a bounded part. True if there were any.

        Looks at what goes and one slice more, and frees what went, so that it costs the same for each item however many
        go together. With no consumer left to hold anything back all go but the newest bucket: by it the next one finds
        in.
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
        """All places were taken, and all their leases have ended."""
        consumers = self.consumers
        if consumers is None or self.limits.consumers is None:
            return False
        return not consumers.untaken and not consumers.live

    def drop_excess(self, clock: int) -> None:
        """Collect the oldest items above the limits, if that is what a full channel does."""
        held, limits = self._held, self.limits
        if not limits.drops_oldest:
            return
        if limits.max_items is not None and held.items > limits.max_items:
            held.outdate(held.front_of_items(held.items - limits.max_items), COUNT, clock)
        if held.charged_bytes > limits.max_bytes:
            held.outdate(held.front_of_bytes(held.charged_bytes - limits.max_bytes), BYTES, clock)

    def has_room(self, items: int, payload_bytes: int) -> bool:
        """So many more items fit without anything going."""
        held, limits = self._held, self.limits
        within_items = limits.max_items is None or held.items + items <= limits.max_items
        return within_items and held.charged_bytes + payload_bytes + items * ITEM_OVERHEAD_BYTES <= limits.max_bytes

    def has_room_as_if_put(self, time: int, payload_bytes: int, clock: int) -> bool:
        """One item at `time` fits, judged as if it were in: it may end the oldest bucket's span, which then goes."""
        if self.has_room(1, payload_bytes):
            return True
        freed_items, freed_bytes = self._freed_by(time, payload_bytes, clock)
        return freed_items > 0 and self.has_room(1 - freed_items, payload_bytes - freed_bytes)

    def _freed_by(self, time: int, payload_bytes: int, clock: int) -> tuple[int, int]:
        """Items and payload bytes that would be collected because an item at `time` comes in.

        By age: only the bucket before it gets another end, and only the oldest bucket can go first. By consumption: if
        nobody holds anything back, all before the newest bucket goes.
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
        """Collect the oldest bucket, whose age an item has waited for that is in now."""
        oldest = self._held.oldest
        following = None if oldest is None else self._held.next_time(oldest)
        if following is not None:
            self._held.outdate(self._held.front_before(following), AGE, clock)

    def makes_no_room_at(self, time: int) -> bool:
        """All that is held is the newest bucket, to which an item at `time` belongs: it never grows too old, and
        nobody consumes it."""
        return self.limits.consumers is None and self._held.oldest == self._held.newest == time

    def retry_at(self, time: int, own_end: int | None) -> int | None:
        """When time next makes room for an item at `time`; `own_end` is its end by duration, if any.

        Judged as if the item were in, but not later than time takes something without it, which may be sooner if it
        would belong to the oldest bucket. None: only another put, or consumption, can bring that about.
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
    """Takes what `going` takes, of so many slices, and of fewer where it has to look at very many consumers;
    `held_back` if it was asked for more."""

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
