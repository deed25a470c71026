"""The replicas of one queue at its owner: its steps, their feeds, and the answers that wait for replicas."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable
from typing import Protocol

from stampede_rt.errors import StampedeError
from stampede_rt.v1 import channel_pb2
from stampede_rt.values.queueing import QueuePolicy
from stampede_rt_channel_host.channels.owned_replicas import OwnedReplicas, OwnersFeed
from stampede_rt_channel_host.core.queue import AheadPut, QueueJournal
from stampede_rt_channel_host.core.replication import ReplicasInSync, ReplicaState

STALLED_NANOS = 1_000_000_000
"""If the replicas lack a step for this time, the queue delivers no message until the replicas have the step."""
Action = Callable[[], None]


class QueueFeed(OwnersFeed, Protocol):
    """The feed of one replica."""

    next_step: int
    """The next step that the feed sends."""

    def send_ahead(self, put: AheadPut) -> None:
        """Send a put that the queue is about to store, if the replica lacks nothing else. Raises nothing."""


def waits_for_replicas(policy: QueuePolicy) -> bool:
    """Whether a queue with this policy answers its callers only after its replicas have the changes."""
    return policy.ack == "replica"


class QueueReplication(OwnedReplicas[QueueFeed]):
    """The replicas of one queue. The rule is the same as for channels, with the steps of the queue in place of items.

    Acks of puts, deliveries, and results of settlements wait as actions until the replicas have the step
    (`once_replicated`). So a replica that takes over knows everything that any caller has seen.
    """

    def __init__(
        self, journal: QueueJournal, policy: QueuePolicy, epoch: int, *, is_replicated: bool = False,
        steady_nanos: Callable[[], int] = time.monotonic_ns,
    ) -> None:  # fmt: skip
        """`epoch`: the epoch of the queue. `is_replicated`: the replicas in sync have all steps up to now."""
        in_sync = ReplicasInSync(journal.next_step, _least(policy), is_replicated=is_replicated)
        super().__init__(in_sync, epoch, steady_nanos)
        self.journal = journal
        self.reports: dict[bytes, tuple[int, int]] = {}  # by host: the time of its last report, and its place
        self._waiting: deque[tuple[int, object, Action]] = deque()
        self._behind_since: int | None = None
        self._ahead: AheadPut | None = None  # is sent, and not a step yet

    @property
    def is_fully_replicated(self) -> bool:
        """Whether all steps are replicated."""
        return self.replicated_next >= self.journal.next_step

    @property
    def is_stalled(self) -> bool:
        """Whether the replicas have lacked a step for STALLED_NANOS."""
        return self._behind_since is not None and self._steady_nanos() - self._behind_since > STALLED_NANOS

    def configure(self, policy: QueuePolicy) -> None:
        """Take over another policy."""
        self._in_sync.min_replicas = _least(policy)
        self.keeper_wakeup.set()

    def changed(self, now: int) -> None:
        """Make a step of the changes of the queue, if there are any, and send it to the replicas.

        If the step is not the put that was sent ahead, because of a defect, the replicas with that put begin anew.
        """
        if self.journal.note(now, self._ahead):
            if self._ahead is not None and not self.journal.has_made(self._ahead):
                self.take_back()
            self._ahead = None
            self._in_sync.put(self.journal.next_step)
            for feed in self._feeds.values():
                feed.wake()
            self.release_replicated()

    def send_ahead(self, put: AheadPut) -> None:
        """Send a put to the replicas. The queue is about to store it, and nothing else before the next `changed`."""
        self._ahead = put
        for feed in self._feeds.values():
            feed.send_ahead(put)

    def once_replicated(self, key: object, action: Action) -> None:
        """Perform `action` as soon as the present state of the queue is replicated. `forget(key)` drops it."""
        if self.is_fully_replicated and not self._waiting:
            action()
        else:
            self._waiting.append((self.journal.next_step, key, action))

    def forget(self, key: object) -> bool:
        """Drop the actions that were noted for `key`. Returns whether it dropped any."""
        kept = deque(one for one in self._waiting if one[1] is not key)
        has_dropped, self._waiting = len(kept) < len(self._waiting), kept
        return has_dropped

    def statuses(self) -> list[channel_pb2.FedCopyStatus]:
        """The replicas that this host feeds. `waiting` counts steps."""
        now, nothing = self._steady_nanos(), (0, 1)
        return [
            channel_pb2.FedCopyStatus(
                host_id=host_id,
                waiting=self.journal.next_step - self.reports.get(host_id, nothing)[1],
                heard_ago_nanos=now - self.reports.get(host_id, (now, 1))[0],
                replica=True,
                in_sync=state is ReplicaState.IN,
            )
            for host_id, state in self.states().items()
        ]

    def add(self, host_id: bytes, feed: QueueFeed) -> None:
        """Note the feed of a replica."""
        self._feeds[host_id] = feed

    def report(self, host_id: bytes, feed: QueueFeed, next_place: int) -> None:
        """Note that the replica at the end of this feed has all steps before `next_place`."""
        if self._feeds.get(host_id) is feed:
            self.reports[host_id] = self._steady_nanos(), min(next_place, self.journal.next_step)
            # A diverged replica that reports steps has begun anew: its feed does not continue.
            self.diverged_host_ids.discard(host_id)
        super().report(host_id, feed, next_place)

    def release(self) -> None:
        """Perform all waiting actions, because the queue no longer waits for replicas."""
        self._in_sync.min_replicas = 0
        self.know([])

    def own_again(self, epoch: int) -> None:
        """Note that this host is the owner again, at `epoch`. The queue had moved away, and its new owner was lost.

        The new owner may have sent steps to the other replicas, and this host does not know these steps.
        """
        self._in_sync.own_again()
        self.since_epoch = epoch
        self.keeper_wakeup.set()

    def end(self, error: StampedeError) -> None:
        """End the waits, and drop the waiting actions. The feeds continue."""
        self._waiting.clear()
        super().end(error)

    def release_replicated(self) -> None:
        """Perform the actions whose steps are replicated, and forget steps that no replica needs."""
        before, replicated = self._behind_since, self.replicated_next
        while self._waiting and self._waiting[0][0] <= replicated:
            self._waiting.popleft()[2]()
        self.journal.forget(min((replicated, *(feed.next_step for feed in self._feeds.values()))))
        if self.is_fully_replicated:
            self._behind_since = None
        elif before is None or self._progress < replicated:
            self._behind_since = self._steady_nanos()
        self._progress = replicated
        self.wake_waits()

    _progress = 0


def _least(policy: QueuePolicy) -> int:
    return 1 if policy.min_replicas is None else policy.min_replicas
