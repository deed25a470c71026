"""The oracle's channel: items, spans, acceptance and retention."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field

from stampede_rt.values.model import Policy
from stampede_rt.values.timeline import MAX_INSTANT
from tests.oracle.consumers import OracleConsumers
from tests.oracle.instants import Instants

OVERHEAD_BYTES = 64
CONSUMERS_MAX = 1024


@dataclass(frozen=True, order=True)
class Item:
    """An item. Items are ordered by time and then by seq. `duration` None: the item is valid until the next item."""

    time: int
    seq: int
    duration: int | None = field(compare=False)
    length: int = field(compare=False)


@dataclass(frozen=True)
class RefusedItem:
    reason: str


@dataclass(frozen=True)
class MustWait:
    """The verdict that a put has to wait.

    At the instant `retry_at`, age or the end of a lease makes room. None: neither of them ever makes room.
    """

    retry_at: int | None


Verdict = Item | RefusedItem | MustWait


class OracleChannel:
    """One channel: the sorted list of the held items, and counts of all other items.

    `consumers` has the consumer places, if the policy counts consumption: the number of places that `consumers` states,
    or, with `max_age_unconsumed` alone, the most places that a host allows. `age` applies the present time in this
    order: leases end; buckets become too old; the oldest items that no place holds back leave. `age` repeats this until
    no more items leave.
    """

    def __init__(self, policy: Policy, lost_before: int | None = None) -> None:
        """`lost_before`: the instant at which this incarnation began, if an earlier incarnation was lost."""
        self.policy = policy
        self.lost_before = lost_before
        self.held: list[Item] = []
        self.log: dict[int, Item] = {}
        self.collected = {"age": 0, "count": 0, "bytes": 0, "consumption": 0}
        self.collected_times: list[int] = []
        self.collected_ends: list[int] = []
        reasons = ("TOO_OLD", "IN_FUTURE", "ITEM_TOO_LARGE", "CHANNEL_FULL", "MALFORMED_RUN", "OVERLOADED")
        self.rejected = dict.fromkeys(reasons, 0)
        self.advanced_to: int | None = None
        self.consumed_times: list[int] = []
        # the time of the last collection, or the latest time of the items that consumption then collected
        self.frontier_max = 0
        self.consumers: OracleConsumers | None = None
        self._count_consumers()

    def _count_consumers(self) -> None:
        places = self.policy.consumers or (CONSUMERS_MAX if self.policy.max_age_unconsumed_nanos else 0)
        if not places:
            self.consumers = None
        elif self.consumers is None:
            self.consumers = OracleConsumers(places)
        else:
            self.consumers.resize(places)

    @property
    def max_age(self) -> int | None:
        """The channel's age limit. It is ten seconds if the policy states no limit at all."""
        stated = (self.policy.max_age_nanos, self.policy.max_items, self.policy.max_bytes, self.policy.consumers)
        return 10_000_000_000 if stated == (None,) * 4 else self.policy.max_age_nanos

    @property
    def max_bytes(self) -> int:
        return 256 * 1024 * 1024 if self.policy.max_bytes is None else self.policy.max_bytes

    @property
    def max_future(self) -> int:
        return 1_000_000_000 if self.policy.max_future_nanos is None else self.policy.max_future_nanos

    @property
    def drops_oldest(self) -> bool:
        return self.policy.on_full in (None, "drop_oldest")

    @property
    def newest(self) -> int | None:
        return self.held[-1].time if self.held else None

    @property
    def oldest(self) -> int | None:
        return self.held[0].time if self.held else None

    @property
    def overlap(self) -> int:
        return self.policy.overlap_nanos or 0

    @property
    def gone_before(self) -> int | None:
        """The instant that no span of a collected item passes.

        With overlap, each collected item may have lasted for the overlap. A collected item of a bucket that is held in
        part lasts until the next bucket.
        """
        if self.frontier is None:
            return None
        if self.oldest in self.collected_times:
            following = min((item.time for item in self.held if item.time != self.oldest), default=MAX_INSTANT)
            return max(following, self.oldest + self.overlap)
        return max([self.frontier, *(time + self.overlap for time in self.collected_times)])

    @property
    def frontier(self) -> int | None:
        """The latest span end of a collected item, but at most the time of the oldest held item.

        If no item is held, the frontier is at most `frontier_max`.
        """
        if not self.collected_ends:
            return None
        bounds = [item.time for item in self.held] or [self.frontier_max]
        return min(max(self.collected_ends), *bounds)

    def now(self, clock: int) -> int:
        """The later of the clock and the newest item's time."""
        return clock if self.newest is None else max(clock, self.newest)

    def end(self, item: Item) -> int | None:
        """The end of the item's span: the earlier of time + duration and the next later item's time. None: the item is
        the newest, and its span is open.

        The next item does not end the span of an item with a duration before the overlap has passed.
        """
        following = min((other.time for other in self.held if other.time > item.time), default=None)
        if item.duration is None:
            return following
        own = item.time + item.duration
        return own if following is None else min(own, max(following, item.time + self.overlap))

    def span(self, item: Item, clock: int) -> Instants:
        """The instants of the item's span, half-open.

        The span of an item without extent is its one instant. The span of an open newest item includes now.
        """
        end = self.end(item)
        if end is None:
            return Instants(item.time, self.now(clock))
        if end == item.time:
            return Instants(item.time, item.time)
        return Instants(item.time, end, high_closed=False)

    def known_end(self, item: Item, clock: int) -> int:
        end = self.end(item)
        return self.now(clock) if end is None else end

    def counted_end(self, item: Item, clock: int) -> int:
        """The instant from which the item's age counts.

        With overlap, each item counts as if it had the longest possible span.
        """
        if not self.overlap:
            return self.known_end(item, clock)
        following = min((other.time for other in self.held if other.time > item.time), default=None)
        end = self.known_end(item, clock) if following is None else following
        return max(end, item.time + self.overlap)

    def put(self, time: int, duration: int | None, length: int, clock: int, since: int | None = None) -> Verdict:
        """Put one item: accept it, refuse it, or let it wait.

        `since`: the item has no time of its own, and has waited since then. It is judged as if it had been put at
        `since`, or just after the newest item if that is later, because it will get such a time. If the acceptance of
        the item makes the oldest bucket too old, the channel collects this bucket to make room.
        """
        self.age(clock)
        as_if_time = time if since is None else max([since, *(item.time + 1 for item in self.held)])
        waiting = Item(as_if_time, len(self.log) + 1, duration, length)
        item = Item(time, len(self.log) + 1, duration, length)
        reason = self._refusal(item, clock)
        if reason is None and not self.drops_oldest and not self._fits(min(waiting, item), clock):
            in_vain = self.policy.consumers is None and self.oldest == self.newest == waiting.time
            if self.policy.on_full == "block" and not in_vain:
                return MustWait(self._retry_at(waiting))
            reason = "CHANNEL_FULL"
        if reason is not None:
            self.rejected[reason] += 1
            return RefusedItem(reason)
        self.log[item.seq] = item
        self._insert(item)
        self.retain(clock)
        if since is not None and not self.drops_oldest and not self._within_limits():
            self._collect([one for one in self.held if one.time == self.oldest], "age", clock)
        return item

    def _refusal(self, item: Item, clock: int) -> str | None:
        largest = 16 * 1024 * 1024 if self.policy.max_item_bytes is None else self.policy.max_item_bytes
        if item.length > largest or item.length + OVERHEAD_BYTES > self.max_bytes:
            return "ITEM_TOO_LARGE"
        if item.time > clock + self.max_future:
            return "IN_FUTURE"
        below_advance = self.advanced_to is not None and item.time < self.advanced_to
        if below_advance or any(item.time < time for time in self.collected_times):
            return "TOO_OLD"
        return "TOO_OLD" if self._would_go_immediately(item, clock) else None

    def _as_if_put(self, item: Item) -> OracleChannel:
        trial = copy.copy(self)
        trial.held, trial.collected = list(self.held), dict(self.collected)
        trial.collected_times, trial.collected_ends = list(self.collected_times), list(self.collected_ends)
        trial.consumed_times = list(self.consumed_times)
        trial._insert(item)
        return trial

    def _would_go_immediately(self, item: Item, clock: int) -> bool:
        """Whether age, count or bytes would collect the item as soon as it was accepted. Consumption does not count."""
        trial = self._as_if_put(item)
        trial.grow_old(clock)
        trial.drop_excess(clock)
        return item not in trial.held

    def _fits(self, item: Item, clock: int) -> bool:
        """Whether the channel is within its limits after it has accepted the item and collected the too old items."""
        trial = self._as_if_put(item)
        trial.age(clock)
        return trial._within_limits()

    def _within_limits(self) -> bool:
        return len(self.held) <= (self.policy.max_items or len(self.held)) and self.bytes() <= self.max_bytes

    def _retry_at(self, item: Item) -> int | None:
        """The instant at which a put of the item should be tried again; None: never by itself.

        It is the earliest instant at which a lease ends, or at which age makes room, with or without the item in the
        channel. If no place holds items back and the item would be the newest, it is the item's own time.
        """
        instants = [self._as_if_put(item).next_due(), self.next_due()]
        if self._nobody_holds and self.newest is not None and item.time > self.newest:
            instants[0] = item.time
        return min((one for one in instants if one is not None), default=None)

    @property
    def _nobody_holds(self) -> bool:
        places = self.consumers
        return places is not None and self.policy.consumers is not None and not places.untaken and not places.live

    def next_due(self) -> int | None:
        """The next instant at which age collects the oldest bucket, or a lease ends that may hold items back.

        None: never.
        """
        instants = []
        if self.max_age is not None and self.oldest != self.newest:
            ends = [self.counted_end(item, 0) for item in self.held if item.time == self.oldest]
            instants.append(max(ends) + self._age_of(self.oldest))
        lease_end = self.consumers.next_lease_end() if self.consumers and self.held else None
        return min([*instants, *([] if lease_end is None else [lease_end])], default=None)

    def _age_of(self, time: int | None) -> int:
        """The age limit of a bucket:

        `max_age_unconsumed` if a consumer with a lease owes an item of the bucket, else `max_age`.
        """
        longest, shortest = self.policy.max_age_unconsumed_nanos, self.max_age
        assert shortest is not None
        if longest is None or self.consumers is None:
            return shortest
        return longest if any(self.consumers.owed(item.seq) for item in self.held if item.time == time) else shortest

    def bytes(self) -> int:
        return sum(item.length + OVERHEAD_BYTES for item in self.held)

    def _insert(self, item: Item) -> None:
        self.held = sorted([*self.held, item])

    def retain(self, clock: int) -> None:
        """Apply age, then the limits of count and bytes, and age again, because the oldest items are now others."""
        self.age(clock)
        self.drop_excess(clock)
        self.age(clock)

    def drop_excess(self, clock: int) -> None:
        if not self.drops_oldest:
            return
        while self.policy.max_items is not None and len(self.held) > self.policy.max_items:
            self._collect(self.held[:1], "count", clock)
        while self.bytes() > self.max_bytes:
            self._collect(self.held[:1], "bytes", clock)

    def age(self, clock: int) -> None:
        """Apply the present time: end leases, and collect the items that are too old or consumed."""
        if self.consumers is not None:
            self.consumers.expire(clock)
        left = None
        while left != len(self.held):  # items that leave for one reason may let others leave for the other reason
            left = len(self.held)
            self.grow_old(clock)
            self.use_up(clock)

    def grow_old(self, clock: int) -> None:
        """Collect from the oldest bucket on each bucket whose last span end is at least its age limit ago.

        The newest bucket stays. With `max_age_unconsumed`, a bucket with an owed item has that limit, and the buckets
        after it stay, too.
        """
        while self.max_age is not None and self.oldest != self.newest:
            bucket = [item for item in self.held if item.time == self.oldest]
            if max(self.counted_end(item, clock) for item in bucket) > clock - self._age_of(self.oldest):
                return
            self._collect(bucket, "age", clock)

    def use_up(self, clock: int) -> None:
        """Collect from the oldest item on each item that no place holds back.

        If no consumer has a lease, the newest bucket stays, so that the next consumer can start there.
        """
        places = self.consumers
        if places is None or self.policy.consumers is None or places.untaken:
            return
        while self.held and not places.owed(self.held[0].seq) and (places.live or self.oldest != self.newest):
            self._collect(self.held[:1], "consumption", clock)

    def consume(self, consumer_id: int, seqs: list[int], clock: int, lease: int) -> int | None:
        """Consume items.

        Returns how many of them the consumer owed; None: no place is free. A lease of 0 gives the place up.
        """
        self.age(clock)
        assert self.consumers is not None
        known = any(place.consumer_id == consumer_id for place in self.consumers.live)
        if not lease and not seqs and not known:
            return 0
        newest = max(self.held, default=None)
        place = self.consumers.place_for(consumer_id, len(self.log) + 1 if newest is None else newest.seq)
        if place is None:
            return None
        owed = {item.seq for item in self.held if place.owes(item.seq)} & set(seqs)
        place.consumed |= set(seqs)
        place.until, place.ended = clock + lease, not lease
        self.age(clock)
        return len(owed)

    def _times(self) -> set[int]:
        return {item.time for item in self.held}

    def _collect(self, items: list[Item], cause: str, clock: int) -> None:
        self.frontier_max = self.now(clock)
        if cause == "consumption":
            self.frontier_max = max(item.time for item in items)
            self.consumed_times += [item.time for item in items]
        else:
            self.collected_ends += [
                max(self.known_end(item, clock), item.time + max(1, self.overlap)) for item in items
            ]
            self.collected_times += [item.time for item in items]
        self.collected[cause] += len(items)
        self.held = [item for item in self.held if item not in items]

    def advance(self, instant: int, clock: int) -> bool:
        """Advance the channel. Returns False if the instant is further in the future than an item may be."""
        if instant > clock + self.max_future:
            return False
        self.advanced_to = instant if self.advanced_to is None else max(self.advanced_to, instant)
        return True

    def configure(self, policy: Policy, clock: int) -> None:
        """Apply the old policy up to now, and then the new policy."""
        self.age(clock)
        self.policy = policy
        self._count_consumers()
        self.retain(clock)
