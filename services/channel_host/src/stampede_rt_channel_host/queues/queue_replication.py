"""The replicas of one queue at its owner: its steps, their feeds, and the answers that wait for replicas."""

from __future__ import annotations

import asyncio
import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import channel_pb2
from stampede_rt.values.queueing import QueuePolicy
from stampede_rt_channel_host.core.queue import QueueJournal
from stampede_rt_channel_host.core.replication import KnownReplica, ReplicaChange, ReplicasInSync, ReplicaState

READY_SECONDS_MAX = 3.0  # the longest wait of a replica that must begin anew, until the log has cleared its flag
STALLED_NANOS = 1_000_000_000
"""If the replicas lack a step for this time, the queue delivers no message until the replicas have the step."""
Action = Callable[[], None]


class QueueFeed(Protocol):
    """The feed of one replica."""

    next_step: int
    """The next step that the feed sends."""

    def wake(self) -> None:
        """Note that the queue has a new step."""


def waits_for_replicas(policy: QueuePolicy) -> bool:
    """Whether a queue with this policy answers its callers only after its replicas have the changes."""
    return policy.ack == "replica"


class QueueReplication:
    """The replicas of one queue. The rule is that of channels, with the steps of the queue in place of items.

    Acks of puts, deliveries, and results of settlements wait as actions until the replicas have the step
    (`once_replicated`). So a replica that takes over knows everything that any caller has seen.
    """

    ended: StampedeError | None = None
    not_replicated = 0
    """The messages of puts that ended with NOT_REPLICATED."""

    def __init__(
        self, journal: QueueJournal, policy: QueuePolicy, epoch: int, *, is_replicated: bool = False,
        steady_nanos: Callable[[], int] = time.monotonic_ns,
    ) -> None:  # fmt: skip
        """`epoch`: the queue's. `is_replicated`: the replicas in sync have all steps up to now."""
        self.journal = journal
        self.since_epoch = epoch
        """This host has been the owner since this epoch."""
        self._steady_nanos = steady_nanos
        self._in_sync = ReplicasInSync(journal.next_step, _least(policy), is_replicated=is_replicated)
        self._feeds: dict[bytes, QueueFeed] = {}
        self.heard: dict[bytes, tuple[int, int]] = {}  # by host: the time of its last report, and its place
        self._waiting: deque[tuple[int, object, Action]] = deque()
        self._behind_since: int | None = None
        self._changed = asyncio.Event()
        self.news = asyncio.Event()
        """Set when the keeper of the replicas has work to do."""

    @property
    def replicated_next_seq(self) -> int:
        """All steps before this one are replicated."""
        return self._in_sync.replicated

    @property
    def is_known(self) -> bool:
        """Whether the owner knows the directory's replicas."""
        return self._in_sync.is_known

    @property
    def min_replicas(self) -> int:
        """The least number of replicas in sync. With fewer, no step counts as replicated."""
        return self._in_sync.min_replicas

    @property
    def start(self) -> int:
        """The next step when this host became the owner."""
        return self._in_sync.start

    @property
    def is_level(self) -> bool:
        """Whether all steps are replicated."""
        return self.replicated_next_seq >= self.journal.next_step

    @property
    def is_stalled(self) -> bool:
        """Whether the replicas have lacked a step for STALLED_NANOS."""
        return self._behind_since is not None and self._steady_nanos() - self._behind_since > STALLED_NANOS

    def configure(self, policy: QueuePolicy) -> None:
        """Take over another policy."""
        self._in_sync.min_replicas = _least(policy)
        self.news.set()

    def changed(self, now: int) -> None:
        """Make a step of the changes of the queue, if there are any, and send it to the replicas."""
        if self.journal.note(now):
            self._in_sync.put(self.journal.next_step)
            for feed in self._feeds.values():
                feed.wake()
            self._go_on()

    def once_replicated(self, about: object, action: Action) -> None:
        """Perform `action` once the present state of the queue is replicated. `forget` drops it."""
        if self.is_level and not self._waiting:
            action()
        else:
            self._waiting.append((self.journal.next_step, about, action))

    def forget(self, about: object) -> bool:
        """Drop the actions that were noted for `about`. Returns whether there were any."""
        kept = deque(one for one in self._waiting if one[1] is not about)
        has_dropped, self._waiting = len(kept) < len(self._waiting), kept
        return has_dropped

    def know(self, replicas: list[KnownReplica]) -> None:
        """Take over the replicas that the directory has."""
        self._in_sync.know(replicas, self._steady_nanos())
        self._go_on()

    def states(self) -> dict[bytes, ReplicaState]:
        """The state of each replica, by its host."""
        return self._in_sync.states()

    def statuses(self) -> list[channel_pb2.FedCopyStatus]:
        """The replicas that this host feeds. `waiting` counts steps."""
        now, nothing = self._steady_nanos(), (0, 1)
        return [
            channel_pb2.FedCopyStatus(
                host_id=host_id,
                waiting=self.journal.next_step - self.heard.get(host_id, nothing)[1],
                heard_ago_nanos=now - self.heard.get(host_id, (now, 1))[0],
                replica=True,
                in_sync=state is ReplicaState.IN,
            )
            for host_id, state in self.states().items()
        ]

    def changes(self) -> list[ReplicaChange]:
        """The flags that the directory must set or clear now."""
        return self._in_sync.changes(self._steady_nanos())

    def confirm(self, change: ReplicaChange) -> None:
        """Note that the directory's log has the change."""
        self._in_sync.confirm(change)
        self._go_on()

    def is_fed(self, host_id: bytes) -> bool:
        """Whether the replica at this host has a feed."""
        return host_id in self._feeds

    async def begin_anew(self, host_id: bytes) -> bool:
        """Wait until the replica at this host may lose its copy, READY_SECONDS_MAX at most. Returns whether it may."""
        try:
            async with asyncio.timeout(READY_SECONDS_MAX):
                while not self._in_sync.drop(host_id, self._steady_nanos()) and self.ended is None:
                    self.news.set()
                    await self._changed.wait()
        except TimeoutError:
            return False
        return self.ended is None

    def add(self, host_id: bytes, feed: QueueFeed) -> None:
        """Note the feed of a replica."""
        self._feeds[host_id] = feed

    def discard(self, host_id: bytes, feed: QueueFeed) -> None:
        """Forget an ended feed. Idempotent."""
        if self._feeds.get(host_id) is feed:
            del self._feeds[host_id]
            self.news.set()

    def report(self, host_id: bytes, feed: QueueFeed, next_step: int) -> None:
        """Note that the replica at the end of this feed has all steps before `next_step`."""
        if self._feeds.get(host_id) is feed:
            now, place = self._steady_nanos(), min(next_step, self.journal.next_step)
            self.heard[host_id] = now, place
            self._in_sync.report(host_id, place, now)
            if self._in_sync.states().get(host_id) is ReplicaState.OUT:
                self.news.set()
            self._go_on()

    def copies(self, next_step: int) -> int:
        """The number of hosts that have all steps before `next_step`, and may become the owner."""
        return self._in_sync.copies(next_step)

    async def replicated(self, next_step: int, seconds_max: float | None) -> bool:
        """Wait until all steps before `next_step` are replicated, or the host gives the queue up.

        Waits `seconds_max` at most; None: without a limit. Returns whether they are replicated.
        """
        try:
            async with asyncio.timeout(seconds_max):
                while self.replicated_next_seq < next_step and self.ended is None:
                    await self._changed.wait()
        except TimeoutError:
            pass
        return self.replicated_next_seq >= next_step

    def release(self) -> None:
        """Perform all waiting actions, because the queue no longer waits for replicas."""
        self._in_sync.min_replicas = 0
        self.know([])
        self.journal.stop()

    def end(self, error: StampedeError) -> None:
        """End the waits: the host stops serving the queue. It may serve it again later (`resume`)."""
        self.ended = error
        self._waiting.clear()
        self._wake()

    def resume(self) -> None:
        """Note that the host serves the queue again."""
        self.ended = None
        self.news.set()

    def _go_on(self) -> None:
        """Perform the actions whose steps are replicated, and forget steps that no replica needs."""
        before, replicated = self._behind_since, self.replicated_next_seq
        while self._waiting and self._waiting[0][0] <= replicated:
            self._waiting.popleft()[2]()
        self.journal.forget(min((replicated, *(feed.next_step for feed in self._feeds.values()))))
        if self.is_level:
            self._behind_since = None
        elif before is None or self._progress < replicated:
            self._behind_since = self._steady_nanos()
        self._progress = replicated
        self._wake()

    _progress = 0

    def _wake(self) -> None:
        changed, self._changed = self._changed, asyncio.Event()
        changed.set()


def _least(policy: QueuePolicy) -> int:
    return 1 if policy.min_replicas is None else policy.min_replicas
