"""The waits of a hosted queue for its replicas: the host sends answers and deliveries only after the replicas have the
change.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Sequence
from functools import partial

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.core.channel import Pieces, one_after_another, rest_of
from stampede_rt_channel_host.core.queue import Enqueue, QueueCore, SealRun, TakerState
from stampede_rt_channel_host.core.queue.queue_snapshot import QueueSnapshot
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues import refusals
from stampede_rt_channel_host.queues.queue_content import QueueContent, QueueMove
from stampede_rt_channel_host.queues.queue_copying import QueueCopying
from stampede_rt_channel_host.queues.queue_replication import QueueReplication, waits_for_replicas
from stampede_rt_channel_host.queues.refusals import display_name

REPLICATED_SECONDS_MAX = 1.0
ACKNOWLEDGED_CHUNKS_MAX = 64  # a new replica gets this many chunks, with 16,384 deliveries


class ReplicatedQueue(ABC):
    """One queue, perhaps with replicas. `replication` is None while the queue waits for no replicas."""

    record: RecordedQueue
    queue: QueueCore
    moving: QueueMove | None
    replication: QueueReplication | None = None
    _now: Callable[[], int]
    copying: QueueCopying | None = None
    """The copy for the next owner, while the queue begins to move away."""
    is_kept = False
    """Whether the host keeps the messages as a replica when it gives the queue up."""
    _is_forgotten = False
    _ended_work: Sequence[Pieces[None]] = ()
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
            self._ended_work = [*self._ended_work, *rest_of(replication.journal.stopping())]
        elif replication is not None:
            replication.configure(policy)
        elif waits_for_replicas(policy):
            # The journal leaves one number out, so that an earlier copy never continues with these steps.
            journal = content.journal if content is not None else None
            journal = journal or self.queue.journal(self._last_step + 2)
            is_replicated = content is None or content.is_replicated
            self.replication = QueueReplication(journal, policy, self.record.epoch, is_replicated=is_replicated)
        elif content is not None and content.journal is not None:
            self._ended_work = [*self._ended_work, *rest_of(content.journal.stopping())]

    def take_ended_work(self) -> Pieces[None]:
        """The rest of the work of `replicate`, which frees the steps of a journal. The queue does not need them."""
        work, self._ended_work = [*self._ended_work], ()
        return one_after_another(work)

    def put(self, run: Enqueue) -> None:
        """Let the queue judge and store a run. Sends a run of one message to the replicas as soon as the queue has
        accepted it, if the run has a producer and changes nothing else.

        After the judgement only a defect can keep the queue from storing the message. The next `follow_up` notices this
        (see `QueueReplication.changed`). Raises the errors of `QueueCore.enqueue`.
        """
        replication = self.replication
        if replication is None or len(run.lengths) > 1 or not run.producer_id or run.message_id:
            self.queue.enqueue(run, self._now())
            return
        seal, run.seal = run.seal, partial(self._seal_ahead, run, run.seal, replication)
        try:
            self.queue.enqueue(run, self._now())
        finally:
            run.seal = seal

    def _seal_ahead(
        self, run: Enqueue, seal: SealRun, replication: QueueReplication, first_seq: int, positions: Sequence[int],
        stamped_time: int | None,
    ) -> bytes:  # fmt: skip
        body = seal(first_seq, positions, stamped_time)
        if not self.queue.waiting_takers:  # a taker that waits would get the message in the same step
            put = replication.journal.next_put(run, first_seq, stamped_time, body)
            if put is not None:
                replication.send_ahead(put)
        return body

    def snapshot(self, replication: QueueReplication) -> Pieces[QueueSnapshot]:
        """The whole queue for a replica, as it is when the last piece ends. Raises Unavailable if the queue no longer
        has these replicas.
        """
        return replication.journal.snapshot(partial(self._note_step, replication), ACKNOWLEDGED_CHUNKS_MAX)

    def begin_copying(self) -> QueueCopying:
        """Begin to keep the steps for the next owner. Raises StaleBinding (NOT_HERE) if another move is under way."""
        if self.copying is not None or self.moving is not None:
            raise refusals.is_moving(self.record)
        self.copying = QueueCopying(self.queue, None if self.replication is None else self.replication.journal)
        return self.copying

    def end_copying(self) -> Pieces[None]:
        """End `begin_copying`, in pieces."""
        copying, self.copying = self.copying, None
        if copying is not None:
            yield from copying.ending()

    def copied(self, copying: QueueCopying) -> Pieces[QueueSnapshot]:
        """The whole queue, as it is when the last piece ends. Raises the errors of `check_copying`."""
        return copying.snapshot(partial(self.check_copying, copying))

    def check_copying(self, copying: QueueCopying) -> int:
        """Make a step of all changes. Returns the time.

        Raises Unavailable if the steps of `copying` cannot follow any more, and StaleBinding (NOT_HERE) if the queue
        has left this host.
        """
        if self._is_forgotten:
            raise refusals.is_moving(self.record)
        now = self._now()
        if self.replication is not None:
            self.replication.changed(now)
        copying.changed(now)
        if not copying.is_complete:
            raise refusals.has_lost_steps(self.record)
        return now

    def _note_step(self, replication: QueueReplication) -> int:
        """Make a step of all changes. Returns the time."""
        if self.replication is not replication:
            raise Unavailable(f"queue {display_name(self.record)} no longer waits for its replicas")
        now = self._now()
        replication.changed(now)
        return now

    async def wait_until_replicated(self) -> int:
        """Wait until the replicas have the held queue. Returns the number of its next step; 0 without replicas.

        Waits REPLICATED_SECONDS_MAX at most. Raises Unavailable if the replicas do not have it by then.
        """
        if self.replication is None:
            return 0
        self.replication.changed(self._now())
        next_step = self.replication.journal.next_step
        if not await self.replication.replicated(next_step, REPLICATED_SECONDS_MAX):
            name = display_name(self.record)
            raise Unavailable(
                f"queue {name} needs {self.replication.min_replicas} replicas in sync (min_replicas), so some of "
                f"its messages are at this host only; look at `stampede replicas --queue {name}`, and move it later"
            )
        return next_step

    def once_replicated(self, key: object, action: Callable[[], None]) -> None:
        """Perform `action` as soon as the replicas have the present state; immediately if the queue waits for no
        replicas.
        """
        if self.replication is None:
            action()
        else:
            self.replication.once_replicated(key, action)

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
