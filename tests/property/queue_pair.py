"""A queue's core and the oracle. Each step runs on both, and all their visible results must agree."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, field

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.copies.queues.queue_messages import ArrivingQueue, parts_of
from stampede_rt_channel_host.copies.queues.queue_steps import ArrivingParts, WholeQueue, step_parts
from stampede_rt_channel_host.core.channel import UnfinishedWork, first_of, run_to_end
from stampede_rt_channel_host.core.queue import (
    Acknowledge,
    Batch,
    Enqueue,
    Extend,
    FailedDelivery,
    GiveBack,
    PendingDelivery,
    QueueCore,
    QueueLimits,
    Settlement,
    TakerState,
    Terminate,
)
from stampede_rt_channel_host.core.queue.queue_snapshot import QueueSnapshot
from stampede_rt_channel_host.core.run_outcome import RunOutcome
from stampede_rt_channel_host.queues.queue_copying import QueueCopying
from tests.oracle import queue as oracle

Verdict = tuple[str, int, int]


def limits_of(setup: oracle.Setup) -> QueueLimits:
    return QueueLimits(
        max_items=setup.max_items,
        max_bytes=setup.max_bytes,
        max_item_bytes=setup.max_item_bytes,
        on_full=setup.on_full,
        copies=setup.copies,
        lease_nanos=setup.lease,
        max_deliveries=setup.max_deliveries,
        dead_letters=setup.dead_letters,
    )


def body_of(first_seq: int, positions: Sequence[int], stamped_time: int | None) -> bytes:
    return b"%d %d %d" % (first_seq, len(positions), stamped_time or 0)


def core_settlement(verdict: Verdict) -> Settlement:
    kind, delivery_id, nanos = verdict
    if kind == "ack":
        return Settlement(delivery_id, Acknowledge())
    if kind == "extend":
        return Settlement(delivery_id, Extend(nanos))
    if kind == "term":
        return Settlement(delivery_id, Terminate(f"reason {nanos}"))
    return Settlement(delivery_id, GiveBack(nanos, uncounted=kind == "uncounted"))


class _Copy:
    """A copy of a queue for a move. `clock`: the time at both hosts. `snapshot`: None before its last piece."""

    def __init__(self, copying: QueueCopying, clock: Callable[[], int]) -> None:
        self.copying = copying
        self.clock = clock
        self.snapshot: QueueSnapshot | None = None
        self._pieces = copying.snapshot(self._noted)
        self._as_of = 0

    def _noted(self) -> int:
        self.copying.changed(self.clock())
        return self.clock()

    def take_piece(self) -> None:
        """Take a piece of the snapshot."""
        if self.snapshot is None:
            found = first_of(self._pieces)
            self.snapshot = None if isinstance(found, UnfinishedWork) else found
            self._as_of = self.clock()

    def followed(self, limits: QueueLimits) -> QueueCore:
        """The queue at the other host, after the steps since the snapshot."""
        assert self.snapshot is not None
        self.copying.changed(self.clock())
        arriving = ArrivingQueue()
        for part in parts_of(self.snapshot, next_step=self.snapshot.next_step, steps_follow=True):
            arriving.add(pb.HandOverQueueResponse.FromString(part.SerializeToString()))
        core = QueueCore.restored(limits, arriving.state(), self._as_of, incarnation=7)
        journal, parts = core.journal(arriving.next_step), ArrivingParts()
        while steps := self.copying.steps.take(3, 2**20):
            sent = [part.SerializeToString() for step in steps for part in step_parts(step, self.clock())]
            for arrived in parts.add(map(pb.FedQueuePart.FromString, sent)):
                assert not isinstance(arrived, WholeQueue)
                journal.apply(arrived[0], self.clock() - arrived[1])
        run_to_end(journal.stopping())
        core.resume(self.clock())
        core.configure(limits, self.clock())
        return core


@dataclass
class QueuePair:
    """One queue in the core and in the oracle, with its takers and waiting runs."""

    setup: oracle.Setup
    clock: int
    core: QueueCore = field(init=False)
    oracle: oracle.OracleQueue = field(init=False)
    takers: list[tuple[TakerState, oracle.Taker]] = field(default_factory=list)
    waiting: list[tuple[Enqueue, oracle.Run]] = field(default_factory=list)
    deliveries: list[tuple[int, int]] = field(default_factory=list)  # taker id, delivery id
    runs: list[oracle.Run] = field(default_factory=list)
    _copy: _Copy | None = None

    def __post_init__(self) -> None:
        self.core = QueueCore(limits_of(self.setup), incarnation=7)
        self.oracle = oracle.OracleQueue(self.setup)

    def enqueue(
        self, lengths: list[int], producer_id: int, first_number: int, wait: int | None, message_id: str
    ) -> None:
        mine = Enqueue(
            lengths,
            body_of,
            producer_id=producer_id,
            first_number=first_number,
            wait_nanos=wait,
            message_id=message_id,
        )
        other = oracle.Run(lengths, producer_id, first_number, wait, message_id)
        refused = [_raises(lambda: self.put(mine)), _raises(lambda: self._oracle_enqueue(other))]
        assert refused[0] == refused[1]
        self.check()
        if not refused[0]:
            self.runs.append(other)
            self._agree(mine, other)
            if not mine.is_done:
                self.waiting.append((mine, other))

    def put(self, run: Enqueue) -> None:
        """Give the run to the core. Raises the errors of the core."""
        self.core.enqueue(run, self.clock)

    def _oracle_enqueue(self, run: oracle.Run) -> None:
        try:
            self.oracle.enqueue(run, self.clock)
        except ValueError as error:
            raise InvalidArgument(str(error)) from None

    def withdraw(self, position: int) -> None:
        if position < len(self.waiting):
            mine, other = self.waiting.pop(position)
            self.core.withdraw(mine, self.clock)
            self.oracle.withdraw(other, self.clock)
            self.check()

    def attach(self, taker_id: int, lease: int | None) -> None:
        self.takers.append((TakerState(taker_id, lease, f"taker {taker_id}"), oracle.Taker(taker_id, lease)))

    def grant(self, position: int, credit: int) -> None:
        if position < len(self.takers):
            mine, other = self.takers[position]
            self.core.grant(mine, credit, self.clock)
            self.oracle.grant(other, credit, self.clock)
            self.check()

    def sent(self, position: int, *, begun: bool) -> None:
        """Note that a batch was sent. `begun`: the host has only begun to send it."""
        if position < len(self.takers) and self.takers[position][0].is_busy:
            mine, other = self.takers[position]
            if begun:
                self.core.sending(mine)
                other.unsent = []
            else:
                self.core.note_sent(mine, self.clock)
                self.oracle.sent(other, self.clock)
            self.check()

    def leave(self, position: int, *, drain: bool) -> None:
        if position < len(self.takers):
            mine, other = self.takers[position] if drain else self.takers.pop(position)
            if drain:
                self.core.drain(mine)
                self.oracle.drain(other)
            else:
                self.core.leave(mine, self.clock)
                self.oracle.leave(other, self.clock)
            self.check()

    def settle(self, taker_id: int, verdicts: list[Verdict]) -> None:
        results = self.core.settle(taker_id, map(core_settlement, verdicts), self.clock)
        expected = self.oracle.settle(taker_id, verdicts, self.clock)
        assert [one.error.reason if one.error else None for one in results] == expected
        self.check()

    def dead_letter_moved(self, position: int, *, failed: bool) -> None:
        if position < len(self.oracle.dead_letter_seqs):
            seq = self.oracle.dead_letter_seqs[position]
            if failed:
                self.core.postpone_dead_letter(seq)
                self.oracle.dead_letter_seqs.append(self.oracle.dead_letter_seqs.pop(position))
            else:
                self.core.dead_letter_moved(seq, self.clock)
                self.oracle.dead_letter_moved(seq, self.clock)
            self.check()

    def configure(self, setup: oracle.Setup) -> None:
        self.core.configure(limits_of(setup), self.clock)
        self.oracle.configure(setup, self.clock)
        self.check()

    def copy(self) -> None:
        """Copy a piece of the queue for a move. The first call begins the copy, and the queue notes its changes."""
        if self._copy is None:
            self._copy = _Copy(QueueCopying(self.core, None), lambda: self.clock)
        self._copy.take_piece()

    def hand_over(self) -> None:
        """Move the queue to another host. The takers and waiting runs at this host end first.

        If `copy` has copied the queue, the other host gets the copy and the steps since then.
        """
        while self.takers:
            self.leave(0, drain=False)
        while self.waiting:
            self.withdraw(0)
        copy, self._copy = self._copy, None
        if copy is not None and copy.snapshot is not None:
            self.core = copy.followed(limits_of(self.oracle.setup))
            order = [one.seq for one in self.core.dead_letters(10**6)]
            assert sorted(order) == sorted(self.oracle.dead_letter_seqs)
            self.oracle.dead_letter_seqs = order  # a step does not say that a dead letter was postponed
            self.check()
            return
        arriving = ArrivingQueue()
        for part in parts_of(self.core.export(self.clock)):
            arriving.add(pb.HandOverQueueResponse.FromString(part.SerializeToString()))
        limits = limits_of(self.oracle.setup)
        self.core = QueueCore.restore(limits, arriving.state(), self.clock, incarnation=7)
        self.check()

    def tick(self, nanos: int) -> None:
        self.clock += nanos
        self.core.tick(self.clock)
        self.oracle.tick(self.clock)
        self.check()

    def check(self) -> None:
        """Compare all deliveries, the outcomes of all runs, and all counters."""
        if self._copy is not None:
            self._copy.copying.changed(self.clock)
        dealt, self.oracle.dealt = self.oracle.dealt, []
        other_of = {id(mine): other for mine, other in self.takers}
        found = [(other_of[id(taker)], _flat(batch), batch.expires) for taker, batch in self.core.take_batches()]
        assert found == dealt
        self.deliveries += [(taker.taker_id, one[1]) for taker, given, _ in dealt for one in given]
        silent, self.oracle.silent = self.oracle.silent, []
        assert [other_of[id(taker)] for taker in self.core.take_silent()] == silent
        self._check_finished()
        counters = asdict(self.core.counters(self.clock))
        assert counters == self.oracle.counters()
        gone = sum(counters[name] for name in ("consumed", "dropped", "dead_lettered", "expelled"))
        assert counters["accepted"] == counters["held"] + gone
        self._check_views()

    def _check_finished(self) -> None:
        finished, self.oracle.finished = self.oracle.finished, []
        mine = self.core.take_finished()
        assert len(mine) == len(finished)
        for one, other in zip(mine, finished, strict=True):
            assert (one, other) in self.waiting
            self._agree(one, other)
        self.waiting = [pair for pair in self.waiting if pair[0] not in mine]

    def _check_views(self) -> None:
        core, messages = self.core, self.oracle.messages
        assert core.waiting_takers == len(self.oracle.takers)
        assert core.waiting_enqueues == len(self.oracle.line)
        assert core.next_deadline() == self.oracle.next_deadline()
        assert [(one.seq, _how(one.last)) for one in core.dead_letters(10**6)] == [
            (seq, one.last) for seq in self.oracle.dead_letter_seqs for one in messages if one.seq == seq
        ]
        self._check_pending()
        assert core.oldest_accepted_at == (messages[0].accepted_at if messages else None)
        charged = sum(run.lengths[position] for run in self.oracle.line for position in range(len(run.lengths)))
        assert core.footprint_bytes >= charged + 64 * len(messages)

    def _check_pending(self) -> None:
        """Compare the list of pending messages, page by page."""
        found: list[PendingDelivery] = []
        while page := self.core.pending(found[-1].delivery_id if found else 0, 2, self.clock):
            found += page
        pending = [(one.delivery_id, one.seq, one.taker_id, one.number, one.leased_at, one.expires) for one in found]
        assert pending == self.oracle.pending()
        assert all(one.taker_name == f"taker {one.taker_id}" for one in found)

    def _agree(self, mine: Enqueue, other: oracle.Run) -> None:
        assert mine.is_done == (other.outcome is not None or other.error is not None)
        if other.error is not None:
            assert mine.error is not None
            assert mine.error.reason == other.error
        elif mine.outcome is not None:
            refused = tuple((one.position, one.error.reason) for one in mine.outcome.refusals)
            assert (_seqs(mine.outcome), mine.outcome.stamped_time, refused, mine.is_duplicate) == other.outcome


def _raises(step: object) -> bool:
    try:
        step()  # type: ignore[operator]
    except InvalidArgument:
        return True
    return False


def _seqs(judged: RunOutcome) -> tuple[tuple[int, int], ...]:
    """The accepted positions with their seqs."""
    refused = {one.position for one in judged.refusals}
    bounds = [*(part.position for part in judged.parts[1:]), judged.items]
    found: list[tuple[int, int]] = []
    for part, bound in zip(judged.parts, bounds, strict=False):
        positions = (position for position in range(part.position, bound) if position not in refused)
        found += [(position, seq) for seq, position in enumerate(positions, part.first_seq)]
    return tuple(found)


def _how(last: FailedDelivery | None) -> tuple[int, int, str] | None:
    return None if last is None else (last.number, last.taker_id, last.ended)


def _flat(batch: Batch) -> list[tuple[int, int, int]]:
    return [
        (one.run.first_seq + one.lo + position, one.delivery_ids[position], one.deliveries[position])
        for one in batch.slices
        for position in range(one.hi - one.lo)
    ]
