"""The copy of a queue that its owner sends to the next owner, while the queue is in use."""

from __future__ import annotations

from collections.abc import Callable

from stampede_rt_channel_host.core.channel import Pieces
from stampede_rt_channel_host.core.queue import JOURNAL_BYTES_MAX, QueueCore, QueueJournal
from stampede_rt_channel_host.core.queue.followed_steps import FollowedSteps
from stampede_rt_channel_host.core.queue.queue_snapshot import QueueSnapshot


class QueueCopying:
    """The steps of a queue after a snapshot. The owner sends them after the snapshot.

    `journal`: the journal of the queue's replicas; None: it has none, and this object makes a journal.
    """

    def __init__(self, queue: QueueCore, journal: QueueJournal | None) -> None:
        self._is_own = journal is None
        self.journal = journal or queue.journal()
        if self._is_own:
            self.journal.bytes_max = 0  # only `steps` keeps the steps
        self.steps = FollowedSteps(JOURNAL_BYTES_MAX)

    def snapshot(self, note: Callable[[], int]) -> Pieces[QueueSnapshot]:
        """The whole queue, as it is when the last piece ends. From then on, `steps` gets all steps. `note`: see
        `QueueJournal.snapshot`.
        """
        snapshot = yield from self.journal.snapshot(note, None)
        self.journal.follow(self.steps)
        return snapshot

    @property
    def is_complete(self) -> bool:
        """Whether `steps` has all steps. False if the queue has begun or stopped to have replicas, or if it has changed
        too much.
        """
        return self.journal.is_noting and not self.steps.is_too_long

    def changed(self, now: int) -> None:
        """Make a step of the changes of a queue without replicas. (`QueueReplication` makes the others.)"""
        if self._is_own and self.journal.is_noting:
            self.journal.note(now)

    def ending(self) -> Pieces[None]:
        """Stop, and free the memory, in pieces."""
        self.journal.unfollow(self.steps)
        if self._is_own:
            yield from self.journal.stopping()
        yield from self.steps.freeing()
