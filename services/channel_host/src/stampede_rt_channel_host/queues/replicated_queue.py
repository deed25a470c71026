"""The waits of a hosted queue for its replicas: the host sends answers and deliveries only after the replicas have the
change.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.core.queue import QueueCore, QueueHandoff, TakerState
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues.queue_content import QueueContent, QueueMove
from stampede_rt_channel_host.queues.queue_replication import QueueReplication, waits_for_replicas
from stampede_rt_channel_host.queues.refusals import display_name

LEVEL_SECONDS_MAX = 1.0
ACKNOWLEDGED_CHUNKS_MAX = 64  # a new replica gets this many chunks, with 16,384 deliveries, which take 10 ms


class ReplicatedQueue(ABC):
    """One queue, perhaps with replicas. `replication` is None while the queue waits for no replicas."""

    record: RecordedQueue
    queue: QueueCore
    moving: QueueMove | None
    replication: QueueReplication | None = None
    _now: Callable[[], int]
    _is_stalled = False
    _last_step = 0  # the last step of an earlier `replication`

    @abstractmethod
    def follow_up(self) -> None:
        """Pass the results of a call of the core on, and set the next deadline."""

    @abstractmethod
    def takers(self) -> Collection[TakerState]:
        """The takers with a stream."""

    def replicate(self, content: QueueContent | None = None) -> None:
        """Begin or stop waiting for replicas, as the policy says. `content`: the content with which the queue began
        here.
        """
        policy, replication = self.record.policy, self.replication
        if replication is not None and not waits_for_replicas(policy):
            self._last_step, self.replication = replication.journal.next_step, None
            replication.release()
        elif replication is not None:
            replication.configure(policy)
        elif waits_for_replicas(policy):
            # leaves one number out, so that an earlier copy never continues with these steps
            journal = content.journal if content is not None else None
            journal = journal or self.queue.journal(self._last_step + 2)
            is_replicated = content is None or content.is_replicated
            self.replication = QueueReplication(journal, policy, self.record.epoch, is_replicated=is_replicated)
        elif content is not None and content.journal is not None:
            content.journal.stop()

    def snapshot(self) -> tuple[QueueHandoff, int]:
        """The whole queue for a replica, and the number of its next step."""
        assert self.replication is not None, "the queue has replicas"
        state = self.queue.export(self._now(), ACKNOWLEDGED_CHUNKS_MAX)
        self.follow_up()
        return state, self.replication.journal.next_step

    async def level(self) -> int:
        """Wait until the replicas have the held queue. Returns the number of its next step; 0 without replicas.

        Waits LEVEL_SECONDS_MAX at most. Raises Unavailable if the replicas do not have it by then.
        """
        if self.replication is None:
            return 0
        self.replication.changed(self._now())
        next_step = self.replication.journal.next_step
        if not await self.replication.replicated(next_step, LEVEL_SECONDS_MAX):
            name = display_name(self.record)
            raise Unavailable(
                f"queue {name} needs {self.replication.min_replicas} replicas in sync (min_replicas), so some of "
                f"its messages are at this host only; look at `stampede replicas --queue {name}`, and move it later"
            )
        return next_step

    def once_replicated(self, about: object, action: Callable[[], None]) -> None:
        """Perform `action` as soon as the replicas have the present state; immediately if the queue waits for no
        replicas.
        """
        if self.replication is None:
            action()
        else:
            self.replication.once_replicated(about, action)

    def check_stalled(self) -> None:
        """If the replicas lack a step for too long, take back the messages that no taker has got, before their leases
        end.
        """
        replication = self.replication
        if replication is None or self.moving is not None or replication.is_stalled == self._is_stalled:
            return
        self._is_stalled = replication.is_stalled
        if not self._is_stalled:
            self.queue.resume(self._now())
        else:
            self.queue.pause()
            for taker in self.takers():
                if replication.forget(taker):
                    self.queue.recall(taker, self._now())
        self.follow_up()
