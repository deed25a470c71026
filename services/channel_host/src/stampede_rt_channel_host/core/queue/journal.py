"""The steps of a queue, so that replicas at other hosts repeat them (paper, section 3.5). Pure.

A step has everything that one call of the queue has changed. A copy that has repeated all steps up to a number is equal
to its owner right after that step. The owner counts its steps as a channel counts its items. So the rule of the
replicas in sync holds for both, because this rule compares numbers only.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from itertools import chain, islice
from typing import NamedTuple

from stampede_rt.errors import InvalidArgument
from stampede_rt_channel_host.core.channel.pieces import Pieces
from stampede_rt_channel_host.core.queue.ahead_put import AheadPut
from stampede_rt_channel_host.core.queue.changes import QueueChanges
from stampede_rt_channel_host.core.queue.enqueue import Enqueue
from stampede_rt_channel_host.core.queue.enqueue_line import EnqueueLine
from stampede_rt_channel_host.core.queue.followed_steps import FollowedSteps
from stampede_rt_channel_host.core.queue.handoff import (
    ItemState,
    QueueHandoff,
    aged,
    change_of,
    enter,
    fresh_run_of,
    run_with_age,
    state_of,
)
from stampede_rt_channel_host.core.queue.items import TrackedItem
from stampede_rt_channel_host.core.queue.queue_items import QueueItems, QueueTally
from stampede_rt_channel_host.core.queue.queue_leases import QueueLeases
from stampede_rt_channel_host.core.queue.queue_snapshot import QueueSnapshot

JOURNAL_BYTES_MAX = 64 * 2**20
"""The most bytes of the steps that a queue keeps for its replicas. A replica that lacks older steps begins anew."""
FORGOTTEN_BYTES_PER_CALL = 2**18  # a step of this size has 800 messages with a lease
_STEP_BYTES, _ENTRY_BYTES = 600, 200  # about the memory of a step, and of each entry in it


class QueueStep(NamedTuple):
    """A step. `changes` has the accepted runs, and the new states of messages; its times are ages as of `time`.

    `changes.held` is empty. `removed`: the seqs of the messages that have left the queue.
    """

    number: int
    time: int
    changes: QueueHandoff
    removed: tuple[int, ...]

    @property
    def size_bytes(self) -> int:
        """About its memory."""
        changes = self.changes
        lists = ((one.deliveries, one.acknowledged, one.leases, one.ended or ()) for one in changes.items)
        copies = sum(map(len, chain.from_iterable(lists)))
        noted = len(changes.acknowledged) + len(changes.producers) + len(changes.message_ids)
        bodies = sum(len(run.body) for run in changes.runs)
        return _STEP_BYTES + bodies + _ENTRY_BYTES * (copies + len(changes.items) + noted) + 8 * len(self.removed)

    def step(self) -> QueueStep:
        """See `FollowedStep`."""
        return self

    @property
    def has_changes(self) -> bool:
        """Whether it has a message as a change, which earlier releases do not understand."""
        return any(item.ended is not None for item in self.changes.items)


class _PutStep(NamedTuple):
    """A step that is only a put. A QueueStep takes longer to make, and a replica rarely needs it.

    `tally`, `next_delivery_id`: the values before the step.
    """

    put: AheadPut
    time: int
    tally: QueueTally
    next_delivery_id: int

    @property
    def number(self) -> int:
        return self.put.number

    @property
    def size_bytes(self) -> int:
        return _STEP_BYTES + len(self.put.body) + _ENTRY_BYTES

    def step(self) -> QueueStep:
        return QueueStep(self.number, self.time, self.put.changes(self.tally, self.next_delivery_id), ())


class QueueJournal:
    """The latest steps of a queue. At the owner, `note` makes the steps. At a copy, `apply` repeats the steps of the
    owner.

    The queue has made all steps before `next_step`. `takes_changes`: all replicas understand changes of messages.
    """

    def __init__(
        self, queue_items: QueueItems, queue_leases: QueueLeases, enqueue_line: EnqueueLine, next_step: int = 1,
        bytes_max: int = JOURNAL_BYTES_MAX,
    ) -> None:  # fmt: skip
        self._queue_items = queue_items
        self._queue_leases = queue_leases
        self._enqueue_line = enqueue_line
        self.bytes_max = bytes_max
        self._steps: deque[tuple[QueueStep | _PutStep, int]] = deque()  # each with its size, which takes time to add up
        self._changes = queue_items.changes = QueueChanges()
        self._tally = queue_items.tally.copied()
        self._clock = 0
        self.takes_changes = True
        self.next_step = next_step
        self.size_bytes = 0
        self._snapshots: list[QueueSnapshot] = []
        self._followers: list[FollowedSteps] = []

    @property
    def is_noting(self) -> bool:
        """Whether the queue still notes its changes in this journal."""
        return self._queue_items.changes is self._changes

    def follow(self, steps: FollowedSteps) -> None:
        """Add all later steps to `steps`, too, until `unfollow`."""
        self._followers.append(steps)

    def unfollow(self, steps: FollowedSteps) -> None:
        """End `follow`. Idempotent."""
        self._followers = [one for one in self._followers if one is not steps]

    def note(self, now: int, put: AheadPut | None = None) -> bool:
        """Make a step of all changes since the last step. Returns False if nothing has changed.

        `put`: the result of `next_put`, if the caller has sent it to a replica.
        """
        self._clock = now = max(self._clock, now)
        if not self._changes and self._tally == self._queue_items.tally:
            return False
        if put is not None and self._is_only(put):
            step = _PutStep(put, now, self._tally, self._queue_leases.next_delivery_id)
            self._append(step, self._tally.after_put(put.length))
        else:
            changes = self._changed(now)
            self._append(QueueStep(self.next_step, now, changes, tuple(self._changes.removed)), changes.tally)
        return True

    def next_put(self, run: Enqueue, seq: int, stamped_time: int | None, body: bytes) -> AheadPut | None:
        """The next step, if the queue has changed in nothing but this put of one message, which it has accepted.

        The caller knows that the present call changes nothing else. `seq`, `stamped_time`, `body`: as for `SealRun`.
        """
        if self._changes or self._queue_items.tally != self._tally.after_put(run.lengths[0]):
            return None
        return AheadPut(
            self.next_step, seq, run.producer_id, run.first_number, run.lengths[0], stamped_time, run.caller_name, body
        )

    def has_made(self, put: AheadPut) -> bool:
        """Whether the last step is this put, which `note` has got, and nothing else."""
        last = self._steps[-1][0] if self._steps else None
        return isinstance(last, _PutStep) and last.put is put

    def _is_only(self, put: AheadPut) -> bool:
        """Whether the queue has changed in nothing but this put since the last step."""
        changes = self._changes
        if put.number != self.next_step or len(changes.runs) != 1 or len(changes.producers) != 1:
            return False
        if changes.removed or changes.items or changes.acknowledged or changes.message_ids:
            return False
        run, kept = changes.runs[0], changes.producers[0]
        has_run = run.first_seq == put.seq and run.body == put.body
        return has_run and (kept.producer_id, kept.first_number) == (put.producer_id, put.first_number)

    def _changed(self, now: int) -> QueueHandoff:
        changes = self._changes
        items = sorted(changes.items.values(), key=lambda item: item.seq)
        return QueueHandoff(
            next_seq=self._queue_items.next_seq,
            next_delivery_id=self._queue_leases.next_delivery_id,
            tally=self._queue_items.tally.copied(),
            runs=[run_with_age(run, now) for run in changes.runs],
            held=(),
            items=[self._state_of(item, now) for item in items],
            acknowledged=[one._replace(time=now - one.time) for one in changes.acknowledged],
            producers=[aged(kept, now) for kept in changes.producers],
            message_ids=[known._replace(time=now - known.time) for known in changes.message_ids],
        )

    def _state_of(self, item: TrackedItem, now: int) -> ItemState:
        change = self._changes.item_changes[item.seq] if self.takes_changes else None
        if change is None:
            return state_of(item, self._queue_leases, now)
        return change_of(item, change, self._queue_leases, now)

    def steps_from(self, number: int, bytes_max: int) -> list[QueueStep] | None:
        """The steps from `number` on, of about `bytes_max` bytes, but at least one. None if the journal lacks some."""
        first = self.next_step - len(self._steps)
        if not first <= number <= self.next_step:
            return None
        found: list[QueueStep] = []
        for step, size_bytes in islice(self._steps, number - first, None):
            found.append(step.step())
            bytes_max -= size_bytes
            if bytes_max <= 0:
                break
        return found

    def surely_takes(self, step: QueueStep) -> bool:
        """Whether `apply` cannot fail: this is the next step, and the copy holds each message that the step changes.

        Also False if only a longer search could show this.
        """
        changed = (*(one.seq for one in step.changes.items), *step.removed)
        new = {seq for seq in changed if self._queue_items.tracked.get(seq) is None}
        return step.number == self.next_step and (not new or new == {self._next_fresh()})

    def surely_takes_put(self, put: AheadPut) -> bool:
        """Whether `apply` of the step with this put cannot fail: this is the next step, with the next message."""
        return (put.number, put.seq) == (self.next_step, self._queue_items.next_seq)

    def step_of(self, put: AheadPut) -> QueueStep:
        """The step with this put, for `apply`. The copy must have repeated all earlier steps."""
        changes = put.changes(self._queue_items.tally, self._queue_leases.next_delivery_id)
        return QueueStep(put.number, 0, changes, ())

    def _next_fresh(self) -> int | None:
        """The seq of the first fresh message; None if there is none."""
        run = self._queue_items.fresh_run()
        return None if run is None else run.first_seq + self._queue_items.fresh_position

    def apply(self, step: QueueStep, now: int) -> None:
        """Repeat a step of the owner. `now`: the copy's clock. Ignores a step that the copy has repeated before.

        Raises InvalidArgument if steps are missing, or if the step does not fit the queue: then begin the copy anew.
        """
        if step.number < self.next_step:
            return
        if step.number > self.next_step:
            raise InvalidArgument(f"step {step.number} of the queue came, and step {self.next_step} is missing")
        self._add_runs(step.changes, now)
        states = {one.seq: one for one in step.changes.items}
        removed = {*step.removed}
        for seq in sorted(states.keys() | removed):
            item = self._queue_items.tracked.get(seq) or self._tracked(seq)
            if seq in removed:
                self._queue_leases.void(item)
                self._queue_items.remove(item)
            else:
                enter(self._queue_items, self._queue_leases, states[seq], now)
        self._note_rest(step.changes, now)
        self._append(step._replace(time=now), step.changes.tally)

    def _add_runs(self, changes: QueueHandoff, now: int) -> None:
        for run in changes.runs:
            own = fresh_run_of(run, now)
            for position in range(len(own.lengths)):
                self._queue_items.put_back(own, position, is_fresh=True)
        self._queue_items.next_seq = changes.next_seq

    def _tracked(self, seq: int) -> TrackedItem:
        """The first fresh message. It must have this seq, because messages are delivered and dropped in order."""
        if self._next_fresh() != seq:
            raise InvalidArgument(f"a step of the queue changes message {seq}, which the copy does not hold")
        return self._queue_items.track_fresh()

    def _note_rest(self, changes: QueueHandoff, now: int) -> None:
        """Take over the other facts of a step, which do not concern the state of messages."""
        self._queue_items.tally = changes.tally.copied()
        self._queue_leases.next_delivery_id = changes.next_delivery_id
        for one in changes.acknowledged:
            self._queue_leases.acknowledged.record(one.delivery_id, one.taker_id, now - one.time)
        for kept in changes.producers:
            self._enqueue_line.retries.record(
                kept.producer_id, kept.first_number, aged(kept, now).outcome, kept.caller_name
            )
        for known in changes.message_ids:
            self._enqueue_line.message_ids.record(known.message_id, known.seq, now - known.time, known.caller_name)

    def _append(self, step: QueueStep | _PutStep, tally: QueueTally) -> None:
        """Add a step. `tally`: the tally after it; nothing changes this object."""
        for snapshot in self._snapshots:
            snapshot.changed(self._changes)
        self._changes.clear()
        self._tally = tally
        self.next_step = step.number + 1
        size_bytes = step.size_bytes
        self._steps.append((step, size_bytes))
        self.size_bytes += size_bytes
        for follower in self._followers:
            follower.add(step, size_bytes)
        while self.size_bytes > self.bytes_max and len(self._steps) > 1:
            self.size_bytes -= self._steps.popleft()[1]

    def snapshot(self, note: Callable[[], int], chunks_max: int | None) -> Pieces[QueueSnapshot]:
        """The whole queue, right after the step that is the last one when the last piece ends.

        `note` makes a step of all changes, and returns the time by the host's clock. Its errors end the work.
        `chunks_max`: see `QueueSnapshot.take_some`.
        """
        snapshot = QueueSnapshot(self._queue_items, self._queue_leases, self._enqueue_line)
        self._snapshots.append(snapshot)
        try:
            while not snapshot.take_some(note(), chunks_max):
                yield
            snapshot.next_step = self.next_step
        except Exception:
            yield from snapshot.freeing()
            raise
        finally:
            self._snapshots.remove(snapshot)
        return snapshot

    def stopping(self) -> Pieces[None]:
        """Stop noting changes, unless another journal has taken it over, and forget all steps, in pieces. The first one
        stops the noting.
        """
        if self.is_noting:
            self._queue_items.changes = None
        while self._steps:
            self.forget(self.next_step)
            yield

    def forget(self, next_step: int) -> None:
        """Forget the steps before `next_step`, because every replica has them. If there are many, later calls
        forget the others.
        """
        least_bytes = self.size_bytes - FORGOTTEN_BYTES_PER_CALL
        while self._steps and self._steps[0][0].number < next_step and self.size_bytes > least_bytes:
            self.size_bytes -= self._steps.popleft()[1]
