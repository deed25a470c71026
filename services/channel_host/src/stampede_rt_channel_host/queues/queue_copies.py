"""The replicas that this host holds of queues of other hosts. They serve no caller before this host is the owner."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Iterator

from stampede_rt.errors import Overloaded
from stampede_rt_channel_host.channels.limits.memory import Charge, MemoryBudget
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.core.channel import Pieces
from stampede_rt_channel_host.core.queue import JOURNAL_BYTES_MAX, QueueCore, QueueHandoff, QueueLimits, QueueStep
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues.queue_content import KeptQueue, QueueContent
from stampede_rt_channel_host.queues.refusals import display_name

logger = logging.getLogger(__name__)

COPIES_MAX = 10_000
COPY_JOURNAL_BYTES_MAX = 4 * 2**20  # the steps that a copy keeps for other replicas, in case it becomes the owner


class QueueCopy:
    """A replica of one queue. `owner_epoch`: the epoch of the owner that sent the last step."""

    def __init__(self, record: RecordedQueue, core: QueueCore, next_step: int, charge: Charge) -> None:
        """`charge`: the memory of the copy."""
        self.record = record
        self.charge = charge
        self.core = core
        self.journal = core.journal(next_step)
        self.journal.bytes_max = COPY_JOURNAL_BYTES_MAX
        self.owner_epoch = record.epoch
        self.last_message_nanos = time.monotonic_ns()  # when the owner last sent a message, by a steady clock

    def emptying(self) -> Pieces[None]:
        """Free the memory, in pieces."""
        yield from self.journal.stopping()
        yield from self.core.emptying()


class QueueCopies:
    """The replicas of one host, by queue. `may_serve`, `now` and `scheduler`: as in `QueueStore`."""

    def __init__(
        self, memory: MemoryBudget, now: Callable[[], int], may_serve: Callable[[], bool], scheduler: PieceScheduler
    ) -> None:
        self._memory = memory
        self._scheduler = scheduler
        self._now = now
        self._may_serve = may_serve
        self._copies: dict[bytes, QueueCopy] = {}

    def __iter__(self) -> Iterator[QueueCopy]:
        return iter([*self._copies.values()])

    def __len__(self) -> int:
        return len(self._copies)

    def of(self, queue_id: bytes) -> QueueCopy | None:
        """The copy of the queue; None if there is none."""
        return self._copies.get(queue_id)

    def restored(self, record: RecordedQueue, state: QueueHandoff) -> QueueCore:
        """The core of a copy with this state. A thread may do this work."""
        return QueueCore.restored(
            QueueLimits.of(record.policy),
            state,
            self._now(),
            incarnation=record.incarnation,
            name=display_name(record),
            may_serve=self._may_serve,
        )

    def begin(self, record: RecordedQueue, core: QueueCore, next_step: int) -> QueueCopy:
        """Keep a new copy. It replaces a former one. Raises Overloaded if there is no room for it."""
        self.check_number()
        self.drop(record.queue_id)
        charge = self._memory.charge_for(record.created_by)
        charge.claim(core.footprint_bytes)
        return self._added(record, QueueCopy(record, core, next_step, charge))

    def keep(self, record: RecordedQueue, kept: KeptQueue) -> None:
        """Keep the queue that has moved away as a copy.

        This never fails, because the directory has the copy as in sync. The copy takes over the memory of the queue.
        """
        self.drop(record.queue_id)
        charge = self._memory.charge_for(record.created_by)
        copy = self._added(record, QueueCopy(record, kept.core, kept.next_step, charge))
        copy.last_message_nanos = kept.held_nanos

    def check_number(self) -> None:
        """Raises Overloaded if this host has COPIES_MAX replicas of queues."""
        if len(self._copies) >= COPIES_MAX:
            raise Overloaded(f"this host has {COPIES_MAX} replicas of queues, the limit; use another host")

    def _added(self, record: RecordedQueue, copy: QueueCopy) -> QueueCopy:
        self._copies[record.queue_id] = copy
        copy.charge.set(copy.core.footprint_bytes)
        return copy

    def apply(self, copy: QueueCopy, step: QueueStep, ago_nanos: int) -> None:
        """Repeat a step of the owner. Raises InvalidArgument if the step does not fit."""
        copy.journal.apply(step, self._now() - ago_nanos)

    def note_message(self, copy: QueueCopy, record: RecordedQueue) -> None:
        """Note that the owner has sent a message of the copy's feed. `record`: the queue as the owner knows it."""
        copy.record, copy.owner_epoch, copy.last_message_nanos = record, record.epoch, time.monotonic_ns()
        copy.charge.set(copy.core.footprint_bytes + copy.journal.size_bytes)

    def note_feed(self, queue_id: bytes) -> None:
        """Note that a feed of the owner begins with the present copy, if there is one."""
        copy = self._copies.get(queue_id)
        if copy is not None:
            copy.last_message_nanos = time.monotonic_ns()

    def with_silent_owner(self, seconds: float) -> list[QueueCopy]:
        """The copies whose owners were silent for this time."""
        latest = time.monotonic_ns() - int(seconds * 1e9)
        return [copy for copy in self if copy.last_message_nanos < latest]

    def inherit(self, record: RecordedQueue) -> QueueContent | None:
        """The content of the queue, which this host owns from now on. None if it has no copy of this incarnation.

        The leases do not count the time in which no host served the queue.
        """
        copy = self._copies.get(record.queue_id)
        if copy is None or copy.record.incarnation != record.incarnation:
            self.drop(record.queue_id)
            return None
        del self._copies[record.queue_id]
        copy.charge.set(0)
        copy.journal.bytes_max = JOURNAL_BYTES_MAX
        copy.core.postpone(time.monotonic_ns() - copy.last_message_nanos)
        extra = {"event": "queue_continued", "queue": display_name(record), "steps": copy.journal.next_step - 1}
        logger.info("this host goes on with a queue of which it had a replica", extra=extra)
        return QueueContent(copy.core, copy.journal, is_replicated=False)

    def drop_silent(self, copy: QueueCopy, last_message_nanos: int) -> None:
        """Drop the copy, unless its owner has sent something after `last_message_nanos`: then the owner may count on
        the copy.
        """
        queue_id = copy.record.queue_id
        if self._copies.get(queue_id) is copy and copy.last_message_nanos == last_message_nanos:
            self.drop(queue_id)

    def drop(self, queue_id: bytes) -> None:
        """Drop the copy, if there is one."""
        copy = self._copies.pop(queue_id, None)
        if copy is not None:
            copy.charge.set(0)
            self._scheduler.begin(copy.emptying())
