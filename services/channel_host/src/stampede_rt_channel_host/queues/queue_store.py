"""The queues of this host.

The host learns a queue from the directory at its first use. It serves no queue without the lease. It drops a queue that
was deleted or that another host owns.
"""

from __future__ import annotations

import asyncio
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from itertools import islice

from sortedcontainers import SortedDict

from stampede_rt.errors import Overloaded, QueueNotFound, StaleBinding, StampedeError
from stampede_rt_channel_host.channels.confirmed_records import confirmed_record
from stampede_rt_channel_host.channels.limits.caller_ids import CallerIds
from stampede_rt_channel_host.channels.limits.creation_shares import CreationShares
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.cluster.identity import HostIdentity
from stampede_rt_channel_host.cluster.queue_directory import QueueDirectory
from stampede_rt_channel_host.cluster.single_flight import SingleFlight
from stampede_rt_channel_host.core.channel import Pieces, batched_keys, one_after_another, rest_of
from stampede_rt_channel_host.core.deadlines import Deadlines
from stampede_rt_channel_host.core.records import RecordedChange, RecordedQueue
from stampede_rt_channel_host.queues import refusals
from stampede_rt_channel_host.queues.arriving_queues import ArrivingQueues
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue
from stampede_rt_channel_host.queues.queue_copies import QueueCopies
from stampede_rt_channel_host.queues.queue_replication import QueueReplication
from stampede_rt_channel_host.queues.queue_totals import add_counts
from stampede_rt_channel_host.queues.refusals import display_name

logger = logging.getLogger(__name__)

QUEUES_MAX = 100_000
QUEUES_PER_PIECE = 128
QUEUES_COMPARED_PER_PIECE = 32  # it takes up to 50 us to log and drop one
RECORDS_PER_PIECE = 64  # it takes 5 to 15 us to decode a record


class QueueStore:
    """Requests get their queue by `use`, which may ask the directory. Each run of an enqueue request gets the queue by
    `find`, which never asks.

    Implements `ChangeFollower`. `lease_held` says whether the host may serve at this moment. `now` is the host's clock.
    `scheduler` does long work in pieces. `on_dead_letters` is called with each queue that has messages to move to its
    dead-letter queue. `takers` remembers which caller uses which taker id.
    """

    def __init__(
        self,
        identity: HostIdentity,
        directory: QueueDirectory,
        memory: MemoryBudget,
        *,
        now: Callable[[], int],
        lease_held: Callable[[], bool],
        scheduler: PieceScheduler,
        on_dead_letters: Callable[[HostedQueue], None],
    ) -> None:
        self.now = now
        self._identity = identity
        self._directory = directory
        self.memory = memory
        self._lease_held = lease_held
        self.scheduler = scheduler
        self._on_dead_letters = on_dead_letters
        self._queues: dict[bytes, HostedQueue] = SortedDict()
        self._single_flight = SingleFlight()
        self._closing: StampedeError | None = None  # the error for all requests as soon as the host shuts down
        self.registrations = 0
        """The number of registrations whose answers have come."""
        self.deadlines: Deadlines[HostedQueue] = Deadlines()
        self.in_use = asyncio.Event()  # set when a queue is first used here
        self._creation_shares = CreationShares(identity.name, "queues", QUEUES_MAX)
        self.takers = CallerIds()  # which caller uses which taker id
        self.copies = QueueCopies(memory, now, self.may_serve, scheduler)
        self.arriving = ArrivingQueues(self.copies, scheduler)
        # called with each queue that begins to wait for replicas
        self.on_replicated: Callable[[HostedQueue], None] = lambda hosted: None
        self.departed: Counter[str] = Counter()
        """The counters of the queues that this host served before, by the names in QueueCounters."""

    def find(self, queue_id: bytes, epoch: int) -> HostedQueue:
        """The queue, for one request. Raises StaleBinding (NOT_HERE, WRONG_EPOCH) or Unavailable (SHUTTING_DOWN)."""
        self.check_may_serve()
        hosted = self._queues.get(queue_id)
        if hosted is None or not hosted.epoch:
            raise refusals.not_here(self._identity.name, queue_id)
        if hosted.moving is not None:
            raise refusals.is_moving(hosted.record)
        if hosted.epoch != epoch:
            raise refusals.wrong_epoch(hosted.record, epoch)
        return hosted

    async def use(self, queue_id: bytes, epoch: int | None) -> HostedQueue:
        """The queue under `epoch` (None: any). Asks the directory first if this host does not know the queue, or knows
        only a lower epoch. Waits for the end of a move, for HELD_SECONDS_MAX at most.

        Raises StaleBinding (NOT_HERE, WRONG_EPOCH, MOVED), QueueNotFound, Overloaded, Unavailable.
        """
        self.check_may_serve()
        held = self._queues.get(queue_id)
        if held is not None and held.moving is not None:
            await held.moving.decided(display_name(held.record))
        if not self._knows(queue_id, epoch):
            async with self._single_flight.about(queue_id):
                if not self._knows(queue_id, epoch):
                    await self._ask(queue_id)
        held = self._queues.get(queue_id)
        return self.find(queue_id, held.epoch if epoch is None and held else epoch or 0)

    def registering(self, records: Iterable[RecordedQueue], *, is_complete: bool) -> Pieces[None]:
        """Process `records`, the queues that the directory names in its answer to a registration, in pieces.

        Meanwhile the host does not hold the lease. If the answer names all queues of the host (`is_complete`), the
        store drops the queues that it does not name. Otherwise the store serves an unnamed queue again only after its
        next `use`.
        """
        self.registrations += 1
        registration = self.registrations
        listed: dict[bytes, RecordedQueue] = {}
        unread = iter(records)
        while part := [*islice(unread, RECORDS_PER_PIECE)]:
            listed.update((record.queue_id, record) for record in part)
            yield
        for ids in batched_keys(self._queues, QUEUES_COMPARED_PER_PIECE):
            left: list[Pieces[None]] = []
            for queue_id in ids:
                hosted = self._queues.get(queue_id)
                if hosted is not None and hosted.registration < registration:  # a newer record may have come meanwhile
                    self._compare(hosted, listed.get(queue_id), left, is_complete=is_complete)
            self.scheduler.begin(one_after_another(left))  # together, because each `begin` may start a task
            yield

    def _compare(
        self, hosted: HostedQueue, record: RecordedQueue | None, left: list[Pieces[None]], *, is_complete: bool
    ) -> None:
        """Adopt `record`, the directory's record of a queue that has not changed here since the registration.

        `record` None: the directory's answer does not name the queue. Then the store drops the queue, and adds the rest
        of that work to `left`. If the answer was not complete, the store asks the directory at the next `use` instead.
        """
        if record is not None:
            self.adopt(record)
        elif is_complete:
            logger.warning(
                "another host has the queue", extra={"event": "queue_moved", "queue": display_name(hosted.record)}
            )
            error = refusals.not_here(self._identity.name, hosted.record.queue_id)
            left += self._drop(hosted.record.queue_id, error)
        else:
            hosted.epoch = 0  # `find` refuses it: the next use asks the directory

    def changed(self, record: RecordedQueue, *, removed: bool) -> None:
        """Process a change of a queue that the directory reports. Ignores queues that this host does not know."""
        hosted = self._queues.get(record.queue_id)
        if hosted is None:
            self._copy_changed(record, removed=removed)
        elif removed:
            self.forget(record.queue_id, refusals.deleted(record))
        elif record.host_id == self._identity.host_id:
            self.adopt(record)
        elif record.epoch > hosted.record.epoch:
            self.forget(record.queue_id, refusals.moved(record))

    def _copy_changed(self, record: RecordedQueue, *, removed: bool) -> None:
        """Process a change of a queue of which this host may hold a replica. The replica may be the owner now."""
        if removed:
            self.copies.drop(record.queue_id)
        elif record.host_id == self._identity.host_id and self.copies.of(record.queue_id) is not None:
            self.adopt(record)

    async def missed(self) -> None:
        """See `ChangeFollower`. Asks the directory about every queue that this host knows."""
        for ids in batched_keys(self._queues, QUEUES_PER_PIECE):
            for queue_id in ids:
                try:
                    await self._ask(queue_id)
                except (QueueNotFound, StaleBinding) as error:
                    logger.info(
                        "this host no longer has the queue",
                        extra={"event": "queue_moved", "queue": queue_id.hex(), "why": str(error)},
                    )

    def changed_in_directory(self, change: RecordedChange) -> None:
        """See `ChangeFollower`."""
        if change.queue is not None:
            self.changed(change.queue, removed=change.removed)

    def fence(self) -> None:
        """End all streams, because the lease has ended. Takers and producers look for the queues at other hosts."""
        self.end_all(refusals.fenced(self._identity.name))

    def close(self) -> None:
        """Refuse all requests from now on with SHUTTING_DOWN."""
        self._closing = refusals.SHUTTING_DOWN

    def end_all(self, error: StampedeError) -> None:
        """End the streams of all takers and the waits of all producers with `error`.

        If there are many, the last ones end later.
        """
        self.scheduler.begin(self._ending(error))

    def _ending(self, error: StampedeError) -> Pieces[None]:
        for ids in batched_keys(self._queues, QUEUES_PER_PIECE):
            for queue_id in ids:
                if (hosted := self._queues.get(queue_id)) is not None:  # if None, the queue has left meanwhile
                    yield from hosted.ending(error)
            yield

    @property
    def count(self) -> int:
        """The number of queues that this host knows."""
        return len(self._queues)

    def in_parts(self) -> Iterator[list[HostedQueue]]:
        """All queues that this host knows, in parts. Queues may come and go between two parts."""
        for ids in batched_keys(self._queues, QUEUES_PER_PIECE):
            yield [self._queues[one] for one in ids if one in self._queues]

    def all(self) -> list[HostedQueue]:
        """All queues that this host knows."""
        return list(self._queues.values())

    def holds(self, hosted: HostedQueue) -> bool:
        """Whether the queue belongs to this host and the host may serve."""
        return self._lease_held() and hosted.moving is None and self.serves(hosted)

    def serves(self, hosted: HostedQueue) -> bool:
        """Whether this object still serves its queue at this host."""
        return self._queues.get(hosted.record.queue_id) is hosted

    def known(self, queue_id: bytes) -> HostedQueue | None:
        """The queue, if it is here, whether it may be served or not."""
        return self._queues.get(queue_id)

    def check_room(self, record: RecordedQueue) -> None:
        """Raises Overloaded if the host has no room for another queue."""
        if len(self._queues) >= QUEUES_MAX:
            raise Overloaded(f"host {self._identity.name} has {QUEUES_MAX} queues, the limit; use another host")
        self._creation_shares.check(record.created_by)

    def may_serve(self) -> bool:
        """Whether the host may serve its queues."""
        return self._closing is None and self._lease_held()

    def check_may_serve(self) -> None:
        """Raises the error of all requests while the host may not serve."""
        if self._closing is not None:
            raise self._closing
        if not self._lease_held():
            raise refusals.fenced(self._identity.name)

    def _knows(self, queue_id: bytes, epoch: int | None) -> bool:
        """Whether the store can answer without the directory.

        For an epoch below the known one the store needs no directory, too, because it refuses the request.
        """
        hosted = self._queues.get(queue_id)
        return hosted is not None and hosted.epoch > 0 and (epoch or 0) <= hosted.epoch

    async def _ask(self, queue_id: bytes) -> None:
        try:
            found = await confirmed_record(self._directory.resolve, queue_id, lambda: self._version_of(queue_id))
        except QueueNotFound:
            if (held := self._queues.get(queue_id)) is not None:
                self.forget(queue_id, refusals.deleted(held.record))
            raise
        record = found.queue
        if record.host_id != self._identity.host_id:
            error = refusals.moved(record)
            self.forget(queue_id, error)
            raise error
        self.adopt(record)

    def _version_of(self, queue_id: bytes) -> object:
        """See `confirmed_record`."""
        hosted = self._queues.get(queue_id)
        return self.registrations, hosted, hosted and hosted.epoch

    def adopt(self, record: RecordedQueue) -> None:
        """Serve the queue according to a record of the directory. Ignores a record older than the present one."""
        held = self._queues.get(record.queue_id)
        if held is not None and held.record.incarnation == record.incarnation:
            if (record.epoch, record.spec_version) >= (held.record.epoch, held.record.spec_version):
                held.registration = self.registrations
                replication = held.replication
                held.update(record)
                self.scheduler.begin(held.take_ended_work())
                self._note_replicated(held, replication)
            return
        if held is not None:
            if record.epoch < held.record.epoch:
                return
            self.forget(record.queue_id, refusals.wrong_epoch(record, held.record.epoch))
        copy = self.copies.of(record.queue_id)
        if copy is not None and record.epoch <= copy.record.epoch:
            return  # the record is from the time before this host became a replica
        self.check_room(record)
        queue_parts = self.memory, self.now, self._on_dead_letters, self.deadlines, self.may_serve
        hosted = HostedQueue(record, *queue_parts, self.arriving.content_of(record))
        hosted.registration = self.registrations
        self._queues[record.queue_id] = hosted
        self._creation_shares.note(record.created_by, +1)
        self._note_replicated(hosted, None)
        self.scheduler.begin(hosted.take_ended_work())
        self.in_use.set()

    def _note_replicated(self, hosted: HostedQueue, before: QueueReplication | None) -> None:
        """Call `on_replicated` if a queue has just begun to wait for replicas. `before`: its former replication, or
        None.
        """
        if hosted.replication is not None and hosted.replication is not before:
            self.on_replicated(hosted)

    def forget(self, queue_id: bytes, error: StampedeError) -> None:
        """Drop the queue, if it is here. Its callers get `error`."""
        self.scheduler.begin(one_after_another(self._drop(queue_id, error)))

    def _drop(self, queue_id: bytes, error: StampedeError) -> list[Pieces[None]]:
        """Drop the queue, and end the calls of some of its callers with `error`. Returns the rest of this work."""
        hosted = self._queues.pop(queue_id, None)
        if hosted is None:
            return []
        self._creation_shares.note(hosted.record.created_by, -1)
        add_counts(self.departed, hosted)
        kept = None
        if error.reason == "MOVED" and hosted.moving is not None:
            kept = hosted.moving.kept
        hosted.is_kept = kept is not None
        rest = rest_of(hosted.leaving(error))
        if kept is not None:
            self.copies.keep(hosted.record, kept)
        return rest
