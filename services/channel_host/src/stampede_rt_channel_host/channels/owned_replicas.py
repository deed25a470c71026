"""The replicas of one channel or queue, as its owner keeps them: their flags, their feeds, and the waits for them."""

from __future__ import annotations

import asyncio
from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import Generic, Protocol, TypeVar

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt_channel_host.core.replication import KnownReplica, ReplicaChange, ReplicasInSync, ReplicaState

READY_SECONDS_MAX = 3.0
"""The longest wait of a caller that binds a channel, and of a replica that has to begin anew."""

SAME_TURN_WRITES_MAX = 16
"""The most callers that get their answers in the turn of the event loop in which a replica reports. The others get
them from their tasks."""


class OwnersFeed(Protocol):
    """The feed of one replica, at the owner."""

    def wake(self) -> None:
        """Note that the channel or queue has changed."""

    def end(self, error: StampedeError) -> None:
        """Note that the host no longer feeds the replica over this stream."""

    def take_back(self) -> None:
        """Note that a defect has kept the owner from storing an item or step that it sent ahead. If this feed has sent
        that item or step, the feed ends.
        """


Feed = TypeVar("Feed", bound=OwnersFeed)


class ServingPeriod:
    """A time in which a host serves a channel or queue without a break.

    `ended`: the error with which the period ended; None: it continues. A period also ends when the lease ends. If the
    directory still has the host as the owner when the host renews its lease, the host serves in a new period.
    """

    ended: StampedeError | None = None


class OwnedReplicas(ABC, Generic[Feed]):
    """The replicas of one channel or queue. A "place" is a seq of a channel, or the number of a step of a queue."""

    not_replicated = 0
    """The number of items or messages whose puts ended with NOT_REPLICATED."""

    def __init__(self, in_sync: ReplicasInSync, epoch: int, steady_nanos: Callable[[], int]) -> None:
        """`epoch`: the epoch of the channel or queue."""
        self.since_epoch = epoch
        """This host has been the owner since this epoch."""
        self.period = ServingPeriod()
        self._is_last_period = False
        self._in_sync = in_sync
        self._steady_nanos = steady_nanos
        self._feeds: dict[bytes, Feed] = {}
        self._changed = asyncio.Event()
        self._wait_count = 0  # the number of calls of `wait_until` that wait now
        self._watchers: dict[Callable[[bool], None], None] = {}
        self.diverged_host_ids: set[bytes] = set()
        """The hosts of the replicas that may hold an item or step that this owner lacks. They must begin anew."""
        self.keeper_wakeup = asyncio.Event()
        """Wakes the keeper of the replicas, because it has work to do."""

    @abstractmethod
    def release_replicated(self) -> None:
        """Release the answers and items that have waited for replicas, as far as the replicas have them now."""

    @property
    def replicated_next(self) -> int:
        """Everything before this place is replicated."""
        return self._in_sync.replicated

    @property
    def start(self) -> int:
        """The next place when this host became the owner."""
        return self._in_sync.start

    @property
    def min_replicas(self) -> int:
        """The least number of replicas in sync. With fewer, nothing counts as replicated."""
        return self._in_sync.min_replicas

    @property
    def is_known(self) -> bool:
        """Whether the owner knows the directory's replicas."""
        return self._in_sync.is_known

    def know(self, replicas: list[KnownReplica]) -> None:
        """Take over the replicas that the directory has.

        Ends the feeds of removed replicas, also if the directory has added them again: a report that comes late over
        such a feed is about items that the host may have dropped.
        """
        for host_id in self._in_sync.know(replicas, self._steady_nanos()):
            if (feed := self._feeds.pop(host_id, None)) is not None:
                feed.end(Unavailable("the directory has removed the replica, or has added it again"))
        self.release_replicated()

    def states(self) -> dict[bytes, ReplicaState]:
        """The state of each replica, by its host."""
        return self._in_sync.states()

    def changes(self) -> list[ReplicaChange]:
        """The flags that the directory must set or clear now."""
        return self._in_sync.changes(self._steady_nanos())

    def confirm(self, change: ReplicaChange) -> None:
        """Note that the directory's log has the change."""
        self._in_sync.confirm(change)
        self.release_replicated()

    def copies(self, next_place: int) -> int:
        """The number of hosts that hold everything before `next_place`, and may become the owner."""
        return self._in_sync.copies(next_place)

    def is_fed(self, host_id: bytes) -> bool:
        """Whether the replica at this host has a feed."""
        return host_id in self._feeds

    def discard(self, host_id: bytes, feed: Feed) -> None:
        """Forget an ended feed. Idempotent."""
        if self._feeds.get(host_id) is feed:
            del self._feeds[host_id]
            self.keeper_wakeup.set()

    def report(self, host_id: bytes, feed: Feed, next_place: int) -> None:
        """Note that the replica at the end of this feed holds everything before `next_place`."""
        if self._feeds.get(host_id) is feed:
            self._in_sync.report(host_id, next_place, self._steady_nanos())
            if self._in_sync.is_out(host_id):
                self.keeper_wakeup.set()
            self.release_replicated()

    def take_back(self) -> None:
        """End the feeds that sent an item or step ahead that the owner, because of a defect, has not stored."""
        for feed in [*self._feeds.values()]:
            feed.take_back()

    async def begin_anew(self, host_id: bytes) -> bool:
        """Wait until the replica at this host may lose its items, READY_SECONDS_MAX at most. Returns whether it may."""
        period = self.period
        return await self.wait_until(lambda: self._drop(host_id), READY_SECONDS_MAX) and period.ended is None

    def _drop(self, host_id: bytes) -> bool:
        has_dropped = self._in_sync.drop(host_id, self._steady_nanos())
        if not has_dropped:
            self.keeper_wakeup.set()
        return has_dropped

    async def replicated(self, next_place: int, seconds_max: float | None, period: ServingPeriod | None = None) -> bool:
        """Wait until everything before `next_place` is replicated; see `wait_until`."""
        return await self.wait_until(lambda: self.replicated_next >= next_place, seconds_max, period)

    async def wait_until(
        self, condition: Callable[[], bool], seconds_max: float | None, period: ServingPeriod | None = None
    ) -> bool:
        """Wait until `condition` holds, or `period` ends (None: the present one). Returns whether the condition holds.

        Waits `seconds_max` at most; None: without a limit.
        """
        period = period or self.period
        self._wait_count += 1
        try:
            async with asyncio.timeout(seconds_max):
                while not condition() and period.ended is None:
                    await self._changed.wait()
        except TimeoutError:
            pass
        finally:
            self._wait_count -= 1
        return condition()

    def end(self, error: StampedeError) -> None:
        """End the waits: the host stops serving the channel or queue, for ever or until it has its lease again."""
        self.period.ended = error
        if not self._is_last_period:
            self.period = ServingPeriod()
        self.wake_waits()

    def close(self) -> None:
        """Note that the host will never serve the channel or queue again.

        After `end` each wait ends immediately. Idempotent.
        """
        self._is_last_period = True

    def watch(self, look: Callable[[bool], None]) -> None:
        """Until `unwatch`, call `look` after each change for which answers may wait. `look` must not wait.

        The argument of `look` says whether it may write a message in this turn of the event loop.
        """
        self._watchers[look] = None

    def unwatch(self, look: Callable[[bool], None]) -> None:
        """Stop the calls of `look`. Idempotent."""
        self._watchers.pop(look, None)

    def wake_waits(self) -> None:
        """Let all calls of `wait_until` and all watchers test their conditions."""
        if self._wait_count:
            changed, self._changed = self._changed, asyncio.Event()
            changed.set()
        for at, look in enumerate([*self._watchers]):
            look(at < SAME_TURN_WRITES_MAX)
