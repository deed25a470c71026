"""The queues that move to this host, from the arrival of their content to the commit in the directory."""

from __future__ import annotations

from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.queues.queue_content import QueueContent
from stampede_rt_channel_host.queues.queue_copies import QueueCopies


class ArrivingQueues:
    """The contents of these queues. `copies`: the replicas at this host. `scheduler` does long work in pieces."""

    def __init__(self, copies: QueueCopies, scheduler: PieceScheduler) -> None:
        self._copies = copies
        self._scheduler = scheduler
        self._contents: dict[bytes, tuple[int, QueueContent]] = {}  # with the epoch of this host as the owner

    def expect(self, record: RecordedQueue, content: QueueContent) -> None:
        """Serve a queue with this content as soon as the directory names this host as its owner in the next epoch."""
        self._contents[record.queue_id] = record.epoch + 1, content

    def give_up(self, queue_id: bytes) -> None:
        """Stop expecting a queue, and free its content. Idempotent."""
        _, content = self._contents.pop(queue_id, (0, None))
        if content is not None:
            self._scheduler.begin(content.emptying())

    def content_of(self, record: RecordedQueue) -> QueueContent | None:
        """The content of a queue that this host owns from now on: from the former owner, or else from the replica at
        this host. Frees the other one. None: the queue is empty.
        """
        epoch, content = self._contents.get(record.queue_id, (0, None))
        # It has another incarnation if the former owner was lost and a caller opened the queue before the commit.
        if content is not None and (epoch, content.core.incarnation) == (record.epoch, record.incarnation):
            del self._contents[record.queue_id]
            self._copies.drop(record.queue_id)
            return content
        self.give_up(record.queue_id)
        return self._copies.inherit(record)
