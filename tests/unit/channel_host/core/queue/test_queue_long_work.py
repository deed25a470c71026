"""Each call of a queue does a bounded amount of work, however many messages and takers there are.

Later calls continue it.
"""

from __future__ import annotations

from stampede_rt.errors import StampedeError, Unavailable
from stampede_rt.v1 import queue_pb2
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.cluster.records import recorded_queue
from stampede_rt_channel_host.core.channel.pieces import abandoning, run_to_end
from stampede_rt_channel_host.core.deadlines import Deadlines
from stampede_rt_channel_host.core.queue import Batch, Enqueue, QueueCore, QueueLimits, TakerState
from stampede_rt_channel_host.core.queue.dispatcher import ITEMS_DISPATCHED_MAX
from stampede_rt_channel_host.core.queue.due_work import CHECKED_PER_CALL_MAX
from stampede_rt_channel_host.core.queue.enqueue_line import DROPPED_PER_RUN_MAX, OFFERED_PER_CALL_MAX
from stampede_rt_channel_host.core.queue.handoff import FREED_PER_PIECE, freeing
from stampede_rt_channel_host.core.queue.journal import FORGOTTEN_BYTES_PER_CALL
from stampede_rt_channel_host.core.queue.queue import EMPTIED_PER_PIECE, ENDED_PER_CALL_MAX
from stampede_rt_channel_host.core.queue.queue_snapshot import MESSAGES_PER_PIECE
from stampede_rt_channel_host.queues.hosted_queue import STREAMS_PER_PIECE, HostedQueue
from tests.support.channel_host.queue_cores import Core

LEASE_NANOS = 60 * 10**9


def test_a_batch_holds_a_bounded_number_of_messages_however_small_they_are() -> None:
    core = Core()
    for _ in range(2000):
        core.put(1)
    core.taker(1, 2000)
    ((taker, batch),) = core.queue.take_batches()
    assert len(batch.slices) == ITEMS_DISPATCHED_MAX
    core.queue.sending(taker)
    core.queue.note_sent(taker, core.now)
    assert core.dispatched() == {1: [*range(ITEMS_DISPATCHED_MAX + 1, 2001)]}


def test_each_call_serves_some_of_many_waiting_takers_and_all_get_the_same_number() -> None:
    core = Core(max_items=10_000)
    for taker_id in range(1, 101):
        core.taker(taker_id, 100)
    core.put(*[1] * 10_000)
    served: dict[int, list[int]] = {}
    while batches := core.queue.take_batches():
        assert sum(one.hi - one.lo for _, batch in batches for one in batch.slices) < 2 * ITEMS_DISPATCHED_MAX
        served |= {taker.taker_id: [one.hi - one.lo for one in batch.slices] for taker, batch in batches}
        if len(served) < 100:
            assert core.queue.next_deadline() == core.now
        core.queue.tick(core.now)
    assert served == {taker_id: [100] for taker_id in range(1, 101)}


def test_no_call_delivers_more_messages_than_the_limit_of_a_call() -> None:
    core = Core(max_items=30_000)
    for taker_id in range(1, 21):
        core.taker(taker_id, 1000)
    core.put(*[1] * 20_000)
    busy, given = [*core.queue.take_batches()], 0
    while busy:
        taker, batch = busy.pop(0)
        given += batch.items
        core.queue.sending(taker)
        core.queue.note_sent(taker, core.now)
        batches = core.queue.take_batches()
        assert sum(batch.items for _, batch in batches) <= ITEMS_DISPATCHED_MAX
        busy += batches
        if not busy:
            core.queue.tick(core.now)
            busy += core.queue.take_batches()
    assert given == 20_000


def test_a_new_taker_waits_until_earlier_takers_are_served() -> None:
    core = Core(max_items=10_000)
    for taker_id in range(1, 21):
        core.taker(taker_id, 100)
    core.put(*[1] * 2000)
    before = {taker.taker_id for taker, _ in core.queue.take_batches()}
    core.taker(100, 100)
    assert 100 not in {taker.taker_id for taker, _ in core.queue.take_batches()}
    assert before == {*range(1, len(before) + 1)}


def test_each_call_gives_room_to_some_of_many_waiting_runs_in_order() -> None:
    core = Core(max_items=1)
    core.put(1)
    waiting = [core.put(1, wait_nanos=10**9) for _ in range(5 * OFFERED_PER_CALL_MAX)]
    core.queue.configure(QueueLimits(max_items=10_000), core.now)
    finished: list[Enqueue] = []
    while more := core.queue.take_finished():
        assert len(more) == OFFERED_PER_CALL_MAX
        finished += more
        core.queue.tick(core.now)
    assert finished == waiting
    assert core.queue.next_deadline() is None


def test_a_smaller_limit_drops_the_excess_in_many_calls_while_the_put_waits() -> None:
    core = Core(max_items=20_000, on_full="drop_oldest")
    core.put(*[1] * 10_000)
    core.queue.configure(QueueLimits(max_items=10, on_full="drop_oldest"), core.now)
    run, held = core.put(1, wait_nanos=0), 10_000
    while not run.is_done:
        (now_held,) = core.counted("held")  # `counted` also does the due work
        assert held - 2 * (DROPPED_PER_RUN_MAX + 2) <= now_held < held
        held = now_held
    assert core.counted("held", "dropped") == (10, 9991)
    assert core.queue.take_finished() == [run]
    assert run.outcome is not None
    assert run.outcome.parts


def test_a_dropped_queue_frees_its_messages_in_pieces() -> None:
    core = Core(max_items=20_000)
    for _ in range(20):
        core.put(*[1] * 500)
    core.taker(1, 2000)
    core.dispatched()
    held = 10_000
    for _ in core.queue.emptying():
        (now_held,) = core.counted("held")
        assert held - EMPTIED_PER_PIECE <= now_held <= held
        held = now_held
    assert core.counted("held", "leased") == (0, 0)
    assert not core.queue._queue_leases._deadlines._heap, "an entry keeps its lease, and so its message"


def test_many_calls_refuse_waiting_runs_in_order_and_accept_none_of_them() -> None:
    core = Core(max_items=1)
    core.put(1)
    waiting = [
        core.put(1, wait_nanos=10**9, producer_id=5, first_number=at + 2) for at in range(3 * ENDED_PER_CALL_MAX)
    ]
    refused: list[Enqueue] = []
    more = True
    while more:
        more = core.queue.refuse_waiting(Unavailable("gone", reason="NOT_HERE"), core.now)
        refused += core.queue.take_finished()
        assert len(refused) % ENDED_PER_CALL_MAX == 0
        if more:
            core.queue.configure(QueueLimits(max_items=10_000), core.now)  # there is room now, and no put waits for it
            repeated = core.put(1, producer_id=5, first_number=len(waiting) + 1)  # repeats a run that still waits
            assert repeated.error is not None
    assert refused == waiting
    assert all(run.error is not None for run in waiting)
    assert core.counted("held") == (1,)
    assert core.put(1, producer_id=5, first_number=2).outcome is not None


def test_a_queue_that_is_paused_or_may_not_serve_gives_takers_nothing() -> None:
    core, serves = Core(max_items=10), True
    core.queue = QueueCore(QueueLimits(max_items=1), incarnation=1, may_serve=lambda: serves)
    core.put(1)
    waits = core.put(1, wait_nanos=10**9)
    serves = False
    core.taker(1, 10)
    core.queue.configure(QueueLimits(max_items=10), core.now)
    core.queue.tick(core.now)
    assert (core.queue.take_batches(), waits.is_done) == ([], False)
    serves = True
    core.queue.pause()
    core.queue.tick(core.now)
    assert core.queue.take_batches() == []
    core.queue.resume(core.now)
    assert core.dispatched() == {1: [1, 2]}


async def test_the_streams_of_takers_are_ended_in_pieces() -> None:
    record = queue_pb2.QueueRecord(queue_id=b"q" * 16, name="q", epoch=1, incarnation=1)
    hosted = HostedQueue(recorded_queue(record), MemoryBudget(2**30), lambda: 1000, lambda hosted: None, Deadlines())
    ended: list[StampedeError] = []

    class Stream:
        def deliver(self, batch: Batch) -> None: ...

        def probe(self) -> None: ...

        def end(self, error: StampedeError) -> None:
            ended.append(error)

    for taker_id in range(1, 3 * STREAMS_PER_PIECE + 1):
        hosted.attach(TakerState(taker_id), Stream())
    counts = [len(ended) for _ in hosted.ending(Unavailable("gone"))]
    assert counts == [STREAMS_PER_PIECE * pieces for pieces in (1, 2, 3, 3)]


def leased(messages: int) -> Core:
    """A queue whose messages are all leased to the taker 1."""
    core = Core(max_items=messages)
    for _ in range(messages):
        core.put(1)
    core.taker(1, messages)
    while core.dispatched():
        core.queue.tick(core.now)
    assert core.counted("leased") == (messages,)
    return core


def test_a_piece_of_a_snapshot_copies_a_bounded_number_of_messages() -> None:
    core = leased(10 * MESSAGES_PER_PIECE)
    pieces = core.queue.journal().snapshot(lambda: core.now, 1)
    assert sum(1 for _ in pieces) == 10


def test_a_snapshot_ends_while_each_piece_finds_many_changed_messages() -> None:
    core = leased(10 * MESSAGES_PER_PIECE)
    journal = core.queue.journal()
    first = min(lease.order for lease in core.queue._queue_leases.leases.values())

    def note() -> int:
        for delivery_id in range(first, first + 2 * MESSAGES_PER_PIECE):
            core.extend(1, delivery_id, LEASE_NANOS)
        journal.note(core.now)
        core.now += 1
        return core.now

    snapshot = run_to_end(journal.snapshot(note, 1))
    leases = [lease for item in snapshot.items for lease in item.leases]
    assert len(leases) == 10 * MESSAGES_PER_PIECE
    assert {one.lease_nanos for one in leases[: 2 * MESSAGES_PER_PIECE]} == {LEASE_NANOS - 1}, "as of the last piece"
    assert [*snapshot.freeing()]
    assert [*snapshot.held] == []


def test_a_dropped_snapshot_frees_its_messages_in_pieces() -> None:
    core = leased(10 * MESSAGES_PER_PIECE)
    journal = core.queue.journal()
    pieces = journal.snapshot(lambda: core.now, 1)
    for _ in range(9):
        next(pieces)
    assert sum(1 for _ in abandoning(pieces)) >= 2
    assert journal._snapshots == []


def test_a_new_owner_lets_all_leases_last_longer_and_tells_the_replicas_in_many_steps() -> None:
    core = leased(5 * CHECKED_PER_CALL_MAX)
    copy = QueueCore.restored(QueueLimits(max_items=10**6), core.queue.export(core.now), core.now, incarnation=1)
    journal, copied = core.queue.journal(), copy.journal()
    before = core.queue.pending(0, 10**6, core.now)
    core.queue.postpone(7)
    while core.queue.next_deadline() == core.now:
        core.queue.tick(core.now)
        journal.note(core.now)
    after = core.queue.pending(0, 10**6, core.now)
    assert [lease.expires + 7 for lease in before] == [lease.expires for lease in after]
    steps = journal.steps_from(1, 2**40)
    assert steps is not None
    assert [len(step.changes.items) for step in steps] == [CHECKED_PER_CALL_MAX] * 5
    for step in steps:
        copied.apply(step, core.now)
    assert copy.pending(0, 10**6, core.now) == after
    core.now = after[0].expires - 1
    core.queue.tick(core.now)
    assert core.counted("leased") == (5 * CHECKED_PER_CALL_MAX,)
    core.now += 1
    core.queue.tick(core.now)
    assert core.counted("leases_expired")[0] > 0


def test_a_call_forgets_a_bounded_number_of_bytes_of_replicated_steps() -> None:
    core = Core(max_items=10_000)
    journal = core.queue.journal()
    while journal.size_bytes < 3 * FORGOTTEN_BYTES_PER_CALL:
        core.put(1)
        journal.note(core.now)
    sizes = [journal.size_bytes]
    while sizes[-1]:
        journal.forget(journal.next_step)
        sizes.append(journal.size_bytes)
    assert len(sizes) == 4
    assert journal.steps_from(journal.next_step, 1) == []


def test_the_values_of_a_queue_are_freed_in_pieces() -> None:
    core = leased(3 * FREED_PER_PIECE)
    state = core.queue.export(core.now)
    assert (len(state.runs), len(state.items)) == (3 * FREED_PER_PIECE, 3 * FREED_PER_PIECE)
    assert sum(1 for _ in freeing(state)) == 6
    assert not state.items
