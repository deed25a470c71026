"""The owner of a queue sends a put to the replicas before the queue stores the message."""

from __future__ import annotations

import asyncio
from collections.abc import Callable
from contextlib import nullcontext, suppress
from dataclasses import replace
from types import SimpleNamespace
from typing import Any, cast

import pytest

from stampede_rt.errors import InvalidArgument, MalformedRun, StampedeError
from stampede_rt.values.queueing import QueuePolicy
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.core.channel import run_to_end
from stampede_rt_channel_host.core.deadlines import Deadlines
from stampede_rt_channel_host.core.queue import AheadPut, Enqueue, TakerState
from stampede_rt_channel_host.core.queue.queue_items import QueueItems
from stampede_rt_channel_host.core.records import RecordedQueue
from stampede_rt_channel_host.core.replication import KnownReplica
from stampede_rt_channel_host.queues.hosted_queue import HostedQueue, TakerStream

REPLICAS = b"r" * 16, b"s" * 16


class Feed:
    """The feed of a replica that has everything that was sent. `events`: the calls of the owner."""

    next_step = 1

    def __init__(self, owner: Owner) -> None:
        self._owner = owner
        self.events: list[Any] = []
        self.puts: list[AheadPut] = []

    def wake(self) -> None:
        self.events.append("step")

    def send_ahead(self, put: AheadPut) -> None:
        self.puts.append(put)
        self.events.append(("ahead", put.seq, self._owner.stored_bytes()))

    def end(self, error: StampedeError) -> None:
        self.events.append("ended")

    def take_back(self) -> None:
        self.events.append("taken back")
        for host_id in REPLICAS:
            self._owner.replication.discard(host_id, self)


class Owner:
    """A queue with two replicas. The test sets the clock."""

    def __init__(self, **policy: Any) -> None:
        record = RecordedQueue(
            queue_id=b"q" * 16, name="jobs", host_id=b"h" * 16, epoch=1, incarnation=5, spec_version=1,
            policy=QueuePolicy(replicas=2, ack="replica", **policy), message=b"",
        )  # fmt: skip
        self.now = 1000
        self.hosted = HostedQueue(record, MemoryBudget(2**20), lambda: self.now, lambda hosted: None, Deadlines())
        assert self.hosted.replication is not None
        self.replication = self.hosted.replication
        self.feeds = [Feed(self), Feed(self)]
        for host_id, feed in zip(REPLICAS, self.feeds, strict=True):
            self.replication.add(host_id, feed)
        self.replication.know([KnownReplica(host_id, 1, True) for host_id in REPLICAS])
        self.number = 1

    def stored_bytes(self) -> int:
        return self.hosted.queue._queue_items.stored_bytes

    def put(self, *lengths: int, producer_id: int = 7, message_id: str = "", number: int = 0) -> Enqueue:
        run = Enqueue(
            lengths or (3,), lambda first_seq, positions, stamped_time: b"run %d" % first_seq, producer_id=producer_id,
            first_number=number or self.number, message_id=message_id, wait_nanos=0, caller_name="client cam",
        )  # fmt: skip
        self.number += len(run.lengths)
        with suppress(StopIteration):
            self.hosted.enqueue(run, nullcontext).send(None)
        return run

    def sent(self) -> list[Any]:
        """The new events of both feeds, which are the same."""
        first, second = [[*feed.events] for feed in self.feeds]
        assert first == second
        for feed in self.feeds:
            feed.events.clear()
        return first


def test_a_put_goes_to_all_replicas_before_the_queue_stores_the_message() -> None:
    owner = Owner()
    owner.put()
    assert owner.sent() == [("ahead", 1, 0), "step"]
    assert owner.feeds[0].puts == [AheadPut(2, 1, 7, 1, 3, 1000, "client cam", b"run 1")]
    stored_bytes = owner.stored_bytes()
    owner.put()
    assert owner.sent() == [("ahead", 2, stored_bytes), "step"]
    assert owner.replication.journal.has_made(owner.feeds[0].puts[1])
    assert owner.replication.journal.next_step == 4


def taker_waits(owner: Owner) -> None:
    taker, stream = TakerState(1), SimpleNamespace(deliver=lambda batch: None)
    owner.hosted.attach(taker, cast(TakerStream, stream))
    owner.hosted.grant(taker, 1)


def message_is_refused(owner: Owner) -> None:
    """The host counts a message that it cannot read. The next step also tells the replicas of it."""
    owner.hosted.refuse_unread(MalformedRun("no run"))


@pytest.mark.parametrize(
    ("policy", "before", "put"),
    [
        ({}, None, {"producer_id": 0}),
        ({}, None, {"message_id": "m"}),
        ({}, taker_waits, {}),
        ({}, message_is_refused, {}),
        ({"max_items": 1, "on_full": "drop_oldest"}, lambda owner: owner.put(), {}),
    ],
    ids=["no producer", "a message id", "a waiting taker", "an earlier refusal", "a message that leaves"],
)
async def test_a_put_that_changes_anything_else_goes_to_the_replicas_as_a_step(
    policy: dict[str, Any], before: Callable[[Owner], object] | None, put: dict[str, Any]
) -> None:
    owner = Owner(**policy)
    if before is not None:
        before(owner)
        owner.sent()
    assert owner.put(**put).outcome is not None
    assert owner.sent() == ["step"]


def test_a_run_of_two_messages_goes_to_the_replicas_as_a_step() -> None:
    owner = Owner()
    owner.put(3, 3)
    assert owner.sent() == ["step"]


def test_a_refused_put_never_goes_ahead() -> None:
    owner = Owner(max_items=1, on_full="reject")
    first = owner.put()
    owner.sent()
    second = owner.put()
    assert second.outcome is not None
    assert second.outcome.refusals
    assert owner.sent() == ["step"], "the step counts the refusal"
    repeated = owner.put(number=1)
    assert repeated.outcome == first.outcome
    assert owner.sent() == []
    with pytest.raises(InvalidArgument):
        owner.put(3, 3, number=1)
    assert owner.sent() == []


async def test_a_put_that_waits_for_room_goes_to_the_replicas_as_a_step() -> None:
    owner = Owner(max_items=1)
    owner.put()
    owner.sent()
    run = Enqueue((3,), lambda *_: b"run", producer_id=7, first_number=9)
    seal = run.seal
    waiting = asyncio.create_task(owner.hosted.enqueue(run, nullcontext))
    await asyncio.sleep(0)
    assert (owner.sent(), run.is_done, run.seal) == ([], False, seal)
    record = owner.hosted.record
    owner.hosted.update(replace(record, spec_version=2, policy=replace(record.policy, max_items=2)))
    await waiting
    assert run.outcome is not None
    assert owner.sent() == ["step"]


@pytest.mark.parametrize("sends", [True, False])
def test_the_replicas_begin_anew_if_a_defect_keeps_the_queue_from_storing_a_message(
    sends: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    owner = Owner()

    def fail(*_: object) -> None:
        raise RuntimeError("a defect")

    monkeypatch.setattr(QueueItems, "set_body", fail)
    with pytest.raises(RuntimeError, match="a defect"):
        owner.put(*((3,) if sends else (3, 3)))
    found = owner.sent()
    assert found[: 2 if sends else 1] == ([("ahead", 1, 0), "taken back"] if sends else ["step"])
    assert [owner.replication.is_fed(host_id) for host_id in REPLICAS] == [not sends, not sends]


async def test_the_replicas_begin_anew_if_the_step_is_another_one(monkeypatch: pytest.MonkeyPatch) -> None:
    """The owner checks its prediction, so that a defect cannot make a replica differ in silence."""
    owner = Owner()
    monkeypatch.setattr(type(owner.hosted.queue), "waiting_takers", 0)
    taker_waits(owner)
    owner.put()
    assert owner.sent() == [("ahead", 1, 0), "taken back"]
    assert not owner.replication.is_fed(REPLICAS[0])


def test_a_queue_that_no_longer_has_replicas_frees_its_steps_in_pieces() -> None:
    owner = Owner()
    owner.replication.journal.bytes_max = 2**24
    for _ in range(1000):
        owner.put(producer_id=0)
    record = owner.hosted.record
    owner.hosted.update(replace(record, spec_version=2, policy=QueuePolicy()))
    journal, left = owner.replication.journal, [owner.replication.journal.size_bytes]
    assert not journal.is_noting
    for _ in owner.hosted.take_ended_work():
        left.append(journal.size_bytes)
    assert len(left) > 2
    assert left[-1] == 0


def test_a_journal_that_another_one_has_replaced_does_not_end_the_notes_of_that_one() -> None:
    owner = Owner()
    following = owner.hosted.queue.journal(10)
    run_to_end(owner.replication.journal.stopping())
    assert following.is_noting
