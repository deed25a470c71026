"""The feed of a queue's replica on the wire: steps and whole queues, in parts of any size."""

from __future__ import annotations

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.wire.request_pieces import MESSAGE_BYTES_MAX
from stampede_rt_channel_host.copies.message_histories import items_of
from stampede_rt_channel_host.copies.queues import queue_steps
from stampede_rt_channel_host.copies.queues.queue_messages import PART_BYTES
from stampede_rt_channel_host.copies.queues.queue_steps import ArrivingParts, WholeQueue, step_parts, whole_parts
from stampede_rt_channel_host.core.queue import QueueCore, QueueLimits, QueueStep, TakerState
from tests.support.channel_host.queue_cores import Core


def sent(parts: list[pb.FedQueuePart]) -> list[pb.FedQueuePart]:
    return [pb.FedQueuePart.FromString(part.SerializeToString()) for part in parts]


def test_a_large_step_is_sent_in_several_parts(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(queue_steps, "PART_BYTES", 64)
    core = Core()
    journal = core.queue.journal()
    for length in (100, 1, 100):
        core.put(length)
    core.taker(1, credit=2)
    assert journal.note(core.now)
    (step,) = journal.steps_from(1, 10**9) or ()
    parts = sent([*step_parts(step, core.now + 5)])
    assert len(parts) > 1
    arriving = ArrivingParts()
    found = [one for part in parts for one in arriving.add([part])]
    assert len(found) == 1
    assert not isinstance(found[0], WholeQueue)
    arrived, ago_nanos = found[0]
    assert (arrived.number, ago_nanos, arriving.size_bytes) == (1, 5, 0)
    copy = QueueCore(QueueLimits(), incarnation=7)
    copy.journal().apply(arrived, core.now)
    assert copy.latest_counters() == core.queue.latest_counters()


def test_many_short_runs_share_a_part_and_stay_in_order() -> None:
    """In an earlier version, each run had a part of its own. A queue of 200,000 messages that were put one by one had
    so many parts that it could not move in time.
    """
    core = Core()
    for length in [1] * 1000 + [PART_BYTES] + [1] * 1000 + [2 * PART_BYTES]:
        core.put(length)
    state = core.queue.export(core.now)
    parts = sent([*whole_parts(state, 1)])
    assert len(parts) < 20
    arriving = ArrivingParts()
    arriving.begin_anew()
    (arrived,) = [one for part in parts for one in arriving.add([part])]
    assert isinstance(arrived, WholeQueue)
    assert [(run.first_seq, run.body) for run in arrived.state().runs] == [
        (one.first_seq, one.body) for one in state.runs
    ]


def test_no_part_is_longer_than_the_limit_of_a_host() -> None:
    """In an earlier version, a part could have 1 MiB, and gRPC refused it.

    So a queue with large messages had no replica in sync.
    """
    core = Core()
    journal = core.queue.journal()
    for _ in range(9_000):
        core.put(1)
    taker = core.taker(1, credit=9_000)
    for length in (300_000, 1_500_000, 1):
        core.put(length)
    assert taker.credit < 9_000
    assert journal.note(core.now)
    (step,) = journal.steps_from(1, 10**9) or ()
    for parts in (step_parts(step, core.now), whole_parts(core.queue.export(core.now), journal.next_step)):
        lengths = [pb.FeedQueueRequest(parts=[part]).ByteSize() for part in parts]
        assert len(lengths) > 10
        assert max(lengths) <= MESSAGE_BYTES_MAX - 2**14, "there is room for the record of the queue"


def test_a_message_with_the_copies_of_very_many_takers_fits_in_parts_within_the_limit_of_a_host() -> None:
    """In an earlier version, such a message was one part. The other host refused it, so the queue could not move."""
    core = Core(copies=5000)
    journal = core.queue.journal()
    core.put(1)
    for number in range(1, 4001):
        taker = TakerState(number, None, f"{number:0128}")
        core.queue.grant(taker, 1, core.now)
    core.dispatched()
    for number in range(1, 1001):
        core.ack(number, number)
    core.nack(1001, 1001)
    core.put(1)
    assert journal.note(core.now)
    (step,) = journal.steps_from(1, 10**9) or ()
    assert step.size_bytes > 4000 * 200, "the journal counts them"
    whole = core.queue.export(core.now)
    parts = sent([*step_parts(step, core.now)])
    assert max(pb.FeedQueueRequest(parts=[part]).ByteSize() for part in parts) <= MESSAGE_BYTES_MAX - 2**14
    [arrived] = ArrivingParts().add(parts)
    assert not isinstance(arrived, WholeQueue)
    copy = QueueCore(core.queue.limits, incarnation=1)
    copy.journal().apply(arrived[0], core.now)
    assert copy.export(core.now).items == whole.items


def test_an_entry_that_continues_no_message_is_refused() -> None:
    with pytest.raises(InvalidArgument, match="continues no message"):
        [*items_of([pb.HandedMessage()])]


def test_the_refusals_of_a_producer_fit_in_parts_within_the_limit_of_a_host() -> None:
    """When a full queue gets room, it takes many runs of one producer in one step, and may refuse most messages."""
    core = Core(max_item_bytes=100)
    journal = core.queue.journal()
    for number in range(64):
        core.put(1, *([101] * 255), producer_id=7, first_number=1 + 256 * number)
    assert journal.note(core.now)
    (step,) = journal.steps_from(1, 10**9) or ()
    parts = sent([*step_parts(step, core.now)])
    assert max(pb.FeedQueueRequest(parts=[part]).ByteSize() for part in parts) <= MESSAGE_BYTES_MAX - 2**14
    [arrived] = ArrivingParts().add(parts)
    assert not isinstance(arrived, WholeQueue)
    assert [one.first_number for one in arrived[0].changes.producers] == [1 + 256 * number for number in range(64)]


def test_a_copy_knows_a_run_that_waits_for_room_with_its_first_messages() -> None:
    """In an earlier version, the copy got these messages without their run. After a take-over the queue accepted them
    again.
    """
    core = Core(max_items=2)
    journal = core.queue.journal()
    core.put(1, 1, 1, producer_id=7, first_number=1)
    assert journal.note(core.now)
    copy = Core(max_items=3)
    copies = copy.queue.journal()
    for step in journal.steps_from(1, 10**9) or ():
        copies.apply(step, copy.now)
    repeated = copy.put(1, 1, 1, producer_id=7, first_number=1)
    assert repeated.outcome is not None
    assert [tuple(part) for part in repeated.outcome.parts] == [(0, 1, 3, 1000)]


def test_a_whole_queue_arrives_before_the_steps_after_it() -> None:
    core = Core()
    journal = core.queue.journal(5)
    core.put(1)
    journal.note(core.now)
    whole = [*whole_parts(core.queue.export(core.now), journal.next_step)]
    core.put(2)
    journal.note(core.now)
    (step,) = journal.steps_from(6, 10**9) or ()
    arriving = ArrivingParts()
    arriving.begin_anew()
    first, second = [*arriving.add(sent([*whole, *step_parts(step, core.now)]))]
    assert isinstance(first, WholeQueue)
    assert (first.next_step, first.state().next_seq) == (6, 2)
    assert not isinstance(second, WholeQueue)
    assert isinstance(second[0], QueueStep)
    assert second[0].number == 6


def test_parts_that_are_no_whole_queue_are_refused() -> None:
    arriving = ArrivingParts()
    arriving.begin_anew()
    (arrived,) = arriving.add([pb.FedQueuePart(content=pb.HandOverQueueResponse(ends=True), next_step=3)])
    assert isinstance(arrived, WholeQueue)
    with pytest.raises(InvalidArgument, match="no facts"):
        arrived.state()


LEASES = 300


class WithManyLeases:
    """A queue with one message, which has LEASES leases, and a copy of the queue after the same steps."""

    def __init__(self) -> None:
        self.core = Core(copies=2 * LEASES)
        self.journal = self.core.queue.journal()
        self.copy = QueueCore(QueueLimits(copies=2 * LEASES), incarnation=1)
        self.copy_journal, self.arriving = self.copy.journal(), ArrivingParts()
        self.core.put(1)
        for taker_id in range(1, LEASES + 1):
            self.core.taker(taker_id, credit=1)
        self.fed()

    def fed(self) -> int:
        """Feed a step to the copy. Returns its bytes."""
        assert self.journal.note(self.core.now)
        (step,) = self.journal.steps_from(self.journal.next_step - 1, 10**9) or ()
        parts = sent([*step_parts(step, self.core.now)])
        for arrived in self.arriving.add(parts):
            assert not isinstance(arrived, WholeQueue)
            self.copy_journal.apply(arrived[0], self.core.now)
        pending = self.core.queue.pending(0, 10**6, self.core.now)
        assert self.copy.pending(0, 10**6, self.core.now) == pending
        return sum(part.ByteSize() for part in parts)


def test_a_step_of_a_message_with_many_leases_has_only_the_changed_leases() -> None:
    rig = WithManyLeases()
    rig.core.ack(1, 1)
    assert rig.fed() < 200
    rig.core.extend(2, 2, 10**9)
    assert rig.fed() < 200
    rig.core.nack(3, 3)
    assert rig.fed() < 200
    rig.core.taker(LEASES + 1, credit=1)
    assert rig.fed() < 200


def test_a_replica_of_an_earlier_release_gets_all_leases_of_a_message() -> None:
    rig = WithManyLeases()
    rig.journal.takes_changes = False
    rig.core.ack(1, 1)
    assert rig.fed() > 10 * LEASES
