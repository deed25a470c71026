"""The queues and mailboxes of the directory: by id, name, host and dead-letter queue (paper, section 3.5). Pure."""

from __future__ import annotations

from collections.abc import Callable, Iterable

from sortedcontainers import SortedDict

from stampede_rt_supernode.core.creators import Creators
from stampede_rt_supernode.core.records import ChangeKind, QueueRecord

Note = Callable[[ChangeKind, QueueRecord], None]


class QueueTable:
    """The queues. The table calls `note` for every change.

    Edit it through `Tables`: when a dead host owns nothing any more, `Tables` removes the host.
    """

    def __init__(self, queues: Iterable[QueueRecord], note: Note) -> None:
        self._note = note
        self.by_id: dict[bytes, QueueRecord] = {}
        self.ids: SortedDict[str, bytes] = SortedDict()  # the queue's id by its name, for all queues except mailboxes
        self._ids_at: dict[bytes, set[bytes]] = {}  # by host id; only hosts that own a queue
        self._feeding: dict[bytes, set[bytes]] = {}  # by the id of a dead-letter queue: the queues that use it
        self.creators = Creators()
        for queue in queues:
            self._link(queue)

    def __len__(self) -> int:
        return len(self.by_id)

    def named(self, name: str) -> QueueRecord | None:
        """The queue of that name; None if no queue has it."""
        found = self.ids.get(name)
        return None if found is None else self.by_id[found]

    def at(self, host_id: bytes) -> list[QueueRecord]:
        """The queues and mailboxes that a host owns, in the order of their ids."""
        return [self.by_id[one] for one in sorted(self._ids_at.get(host_id, ()))]

    def count_at(self, host_id: bytes) -> int:
        """The number of queues and mailboxes that a host owns."""
        return len(self._ids_at.get(host_id, ()))

    def feeding(self, queue_id: bytes) -> list[QueueRecord]:
        """The queues that send their dead letters to this queue, in the order of their ids."""
        return [self.by_id[one] for one in sorted(self._feeding.get(queue_id, ()))]

    def put(self, queue: QueueRecord) -> None:
        """Add a queue, or replace the queue with the same id and name."""
        before = self.by_id.get(queue.queue_id)
        if before == queue:
            return
        if before is not None:
            self._unlink(before)
        self._link(queue)
        self._note(ChangeKind.ADDED if before is None else ChangeKind.UPDATED, queue)

    def remove(self, queue: QueueRecord) -> None:
        """Remove a queue that exists, and that is not the dead-letter queue of another queue."""
        self._unlink(queue)
        del self.by_id[queue.queue_id]
        self.ids.pop(queue.name, None)
        self._note(ChangeKind.REMOVED, queue)

    def _link(self, queue: QueueRecord) -> None:
        self.creators.note(queue.created_by, +1)
        self.by_id[queue.queue_id] = queue
        if queue.mailbox_peer_id is None:
            self.ids[queue.name] = queue.queue_id
        self._ids_at.setdefault(queue.host_id, set()).add(queue.queue_id)
        if queue.spec.dead_letter_queue_id is not None:
            self._feeding.setdefault(queue.spec.dead_letter_queue_id, set()).add(queue.queue_id)

    def _unlink(self, queue: QueueRecord) -> None:
        self.creators.note(queue.created_by, -1)
        _discard(self._ids_at, queue.host_id, queue.queue_id)
        if queue.spec.dead_letter_queue_id is not None:
            _discard(self._feeding, queue.spec.dead_letter_queue_id, queue.queue_id)


def _discard(sets: dict[bytes, set[bytes]], key: bytes, member: bytes) -> None:
    held = sets[key]
    held.discard(member)
    if not held:
        del sets[key]
