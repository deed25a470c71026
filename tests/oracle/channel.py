"""One channel by the book: items, spans, acceptance and retention."""

from __future__ import annotations

import copy
from dataclasses import dataclass, field

from stampede_rt.model import Policy
from tests.oracle.instants import Instants

OVERHEAD_BYTES = 64


@dataclass(frozen=True, order=True)
class Item:
    """An item; they are ordered by time and then by seq. No duration is None: until the next item."""

    time: int
    seq: int
    duration: int | None = field(compare=False)
    length: int = field(compare=False)


@dataclass(frozen=True)
class Refused:
    reason: str


@dataclass(frozen=True)
class Waits:
    """The put has to wait; age makes room next at `retry_at`, or no age ever does."""

    retry_at: int | None


Verdict = Item | Refused | Waits


class OracleChannel:
    """A plain sorted list of held items, and a count for everything that happened to the others."""

    def __init__(self, policy: Policy) -> None:
        self.policy = policy
        self.held: list[Item] = []
        self.log: dict[int, Item] = {}
        self.collected = {"age": 0, "count": 0, "bytes": 0, "consumption": 0}
        self.collected_times: list[int] = []
        self.collected_ends: list[int] = []
        self.rejected = {"TOO_OLD": 0, "IN_FUTURE": 0, "ITEM_TOO_LARGE": 0, "CHANNEL_FULL": 0, "MALFORMED_RUN": 0}
        self.advanced_to: int | None = None

    @property
    def max_age(self) -> int | None:
        """Ten seconds, if no limit at all is stated."""
        stated = (self.policy.max_age_nanos, self.policy.max_items, self.policy.max_bytes)
        return 10_000_000_000 if stated == (None, None, None) else self.policy.max_age_nanos

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
        return max((item.time for item in self.held), default=None)

    @property
    def oldest(self) -> int | None:
        return min((item.time for item in self.held), default=None)

    @property
    def frontier(self) -> int | None:
        """The latest span end that was collected, but never above an item that is still there."""
        if not self.collected_ends:
            return None
        return min([max(self.collected_ends), *(item.time for item in self.held)])

    def now(self, clock: int) -> int:
        """The later of the clock and the newest item."""
        return max([clock, *(item.time for item in self.held)])

    def end(self, item: Item) -> int | None:
        """The earliest of time + duration and the next later item's time; None for an open newest item."""
        ends = [other.time for other in self.held if other.time > item.time]
        if item.duration is not None:
            ends.append(item.time + item.duration)
        return min(ends, default=None)

    def span(self, item: Item, clock: int) -> Instants:
        """Half-open; an instantaneous item is its one instant; an open newest item holds up to and including now."""
        end = self.end(item)
        if end is None:
            return Instants(item.time, self.now(clock))
        if end == item.time:
            return Instants(item.time, item.time)
        return Instants(item.time, end, high_closed=False)

    def known_end(self, item: Item, clock: int) -> int:
        end = self.end(item)
        return self.now(clock) if end is None else end

    def put(self, time: int, duration: int | None, length: int, clock: int, since: int | None = None) -> Verdict:
        """One item, put at once or not at all. One without a time of its own that waits since then is judged as if it
        had been put then; the oldest bucket, which its coming would have outdated by now, makes room for it."""
        self.age(clock)
        as_if_time = time if since is None else max([since, *(item.time for item in self.held)])
        waiting = Item(as_if_time, len(self.log) + 1, duration, length)
        item = Item(time, len(self.log) + 1, duration, length)
        reason = self._refusal(item, clock)
        if reason is None and not self.drops_oldest and not self._fits(waiting, clock):
            if self.policy.on_full == "block":
                return Waits(self._retry_at(waiting))
            reason = "CHANNEL_FULL"
        if reason is not None:
            self.rejected[reason] += 1
            return Refused(reason)
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
        return "TOO_OLD" if self._would_go_at_once(item, clock) else None

    def _as_if_put(self, item: Item) -> OracleChannel:
        trial = copy.copy(self)
        trial.held, trial.collected = list(self.held), dict(self.collected)
        trial.collected_times, trial.collected_ends = list(self.collected_times), list(self.collected_ends)
        trial._insert(item)
        return trial

    def _would_go_at_once(self, item: Item, clock: int) -> bool:
        trial = self._as_if_put(item)
        trial.retain(clock)
        return item not in trial.held

    def _fits(self, item: Item, clock: int) -> bool:
        """Within the limits once age has taken what it takes with the item in."""
        trial = self._as_if_put(item)
        trial.age(clock)
        return trial._within_limits()

    def _within_limits(self) -> bool:
        return len(self.held) <= (self.policy.max_items or len(self.held)) and self.bytes() <= self.max_bytes

    def _retry_at(self, item: Item) -> int | None:
        return self._as_if_put(item).next_age()

    def next_age(self) -> int | None:
        """When age collects the oldest bucket; never, if that is the newest."""
        if self.max_age is None or self.oldest == self.newest:
            return None
        ends = [self.end(item) for item in self.held if item.time == self.oldest]
        return max(end for end in ends if end is not None) + self.max_age

    def bytes(self) -> int:
        return sum(item.length + OVERHEAD_BYTES for item in self.held)

    def _insert(self, item: Item) -> None:
        self.held = sorted([*self.held, item])

    def retain(self, clock: int) -> None:
        """Age, then count, then bytes."""
        self.age(clock)
        if not self.drops_oldest:
            return
        while self.policy.max_items is not None and len(self.held) > self.policy.max_items:
            self._collect(self.held[:1], "count", clock)
        while self.bytes() > self.max_bytes:
            self._collect(self.held[:1], "bytes", clock)

    def age(self, clock: int) -> None:
        """Every bucket but the newest goes whose last span end is max_age ago or more."""
        if self.max_age is None:
            return
        ends = {time: max(self.known_end(i, clock) for i in self.held if i.time == time) for time in self._times()}
        gone = [i for i in self.held if i.time != self.newest and ends[i.time] <= clock - self.max_age]
        self._collect(gone, "age", clock)

    def _times(self) -> set[int]:
        return {item.time for item in self.held}

    def _collect(self, items: list[Item], cause: str, clock: int) -> None:
        self.collected_ends += [self.known_end(item, clock) for item in items]
        self.collected_times += [item.time for item in items]
        self.collected[cause] += len(items)
        self.held = [item for item in self.held if item not in items]

    def advance(self, instant: int) -> None:
        self.advanced_to = instant if self.advanced_to is None else max(self.advanced_to, instant)

    def configure(self, policy: Policy, clock: int) -> None:
        """What the old policy outdated by now is gone; then the new one rules."""
        self.age(clock)
        self.policy = policy
        self.retain(clock)
