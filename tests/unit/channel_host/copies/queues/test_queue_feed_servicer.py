"""The host of a queue's replica lets the caller of a feed change only the replica of that queue."""

from __future__ import annotations

import threading
from types import SimpleNamespace
from typing import Any
from unittest.mock import AsyncMock

import pytest

from stampede_rt.errors import InvalidArgument, StaleBinding
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt.v1 import queue_pb2
from stampede_rt_channel_host.channels.limits.memory import MemoryBudget
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler
from stampede_rt_channel_host.copies.queues import queue_feed_servicer
from stampede_rt_channel_host.copies.queues.queue_feed_servicer import SAME_TURN_STEPS_MAX, QueueFeeds, _Feed
from stampede_rt_channel_host.copies.queues.queue_steps import step_parts, whole_parts
from stampede_rt_channel_host.copies.replica_directory import FeedSource
from stampede_rt_channel_host.core.queue import QueueCore, QueueHandoff, QueueLimits, QueueStep
from stampede_rt_channel_host.core.queue.queue import EMPTIED_PER_PIECE
from tests.support.channel_host.queue_cores import Core


async def test_an_owner_that_feeds_one_queue_cannot_replace_the_copy_of_another() -> None:
    """The host has checked the ownership only for the queue of the first request. A later request names another
    queue.
    """
    dropped: list[bytes] = []
    room = SimpleNamespace(claim=lambda size: None, set=lambda size: None)
    copies = SimpleNamespace(drop=dropped.append, of=lambda queue_id: None)
    queues: Any = SimpleNamespace(copies=copies, memory=SimpleNamespace(charge_for=lambda owner: room))
    record: Any = SimpleNamespace(queue_id=b"q" * 16, created_by="")
    request = pb.FeedQueueRequest(begins_anew=True)
    request.queue.queue_id = b"x" * 16
    with pytest.raises(InvalidArgument, match="names another queue"):
        await _Feed(queues, record).take(request, lambda: True)
    assert not dropped


async def test_a_feed_that_another_owner_has_replaced_begins_no_copy_when_its_queue_is_restored() -> None:
    """In an earlier version, a thread restored the queue of the former owner, and this queue replaced the copy of the
    next owner.
    """
    begun: list[Any] = []
    room = SimpleNamespace(claim=lambda size: None, set=lambda size: None)

    def restored(_: object, state: QueueHandoff) -> QueueCore:
        latest.clear()
        return QueueCore.restored(QueueLimits(), state, 1, incarnation=1)

    copies = SimpleNamespace(
        drop=lambda queue_id: None, of=lambda queue_id: None, begin=lambda *copy: begun.append(copy), restored=restored
    )
    queues: Any = SimpleNamespace(
        copies=copies, memory=SimpleNamespace(charge_for=lambda owner: room), known=lambda queue_id: None,
        scheduler=SimpleNamespace(begin=lambda pieces: freed.append(sum(1 for _ in pieces))),
    )  # fmt: skip
    record: Any = SimpleNamespace(queue_id=b"q" * 16, created_by="", name="jobs", host_id=b"h" * 16)
    core, freed = Core(), list[int]()
    for _ in range(3 * EMPTIED_PER_PIECE):
        core.put(1)
    request = pb.FeedQueueRequest(begins_anew=True, parts=whole_parts(core.queue.export(core.now), 1))
    latest = ["this feed"]
    with pytest.raises(StaleBinding):
        await _Feed(queues, record).take(request, lambda: bool(latest))
    assert not begun
    assert freed == [6], "the queue that nobody needs is freed in pieces"


def test_a_feed_takes_only_steps_in_the_turn_of_their_arrival() -> None:
    """The other host may need a thread for a whole queue."""
    room = SimpleNamespace(claim=lambda size: None, set=lambda size: None)
    copies = SimpleNamespace(drop=lambda queue_id: None, of=lambda queue_id: None)
    queues: Any = SimpleNamespace(
        copies=copies, memory=SimpleNamespace(charge_for=lambda owner: room), known=lambda queue_id: None
    )
    record: Any = SimpleNamespace(queue_id=b"q" * 16, created_by="")
    feed = _Feed(queues, record)
    answers = list[Any]()
    assert feed.take_steps(pb.FeedQueueRequest(), answers.append)
    assert answers == [pb.FeedQueueResponse(takes_changes=True, takes_puts=True)]
    assert not feed.take_steps(pb.FeedQueueRequest(begins_anew=True), answers.append)
    too_many = pb.FeedQueueRequest(parts=[pb.FedQueuePart()] * (SAME_TURN_STEPS_MAX + 1))
    assert not feed.take_steps(too_many, answers.append)
    feed._parts.begin_anew()
    assert not feed.take_steps(pb.FeedQueueRequest(), answers.append)
    assert len(answers) == 1


def test_a_copy_answers_a_step_that_surely_fits_before_it_repeats_the_step() -> None:
    """Callers of the owner wait for the answer. A step that the copy must try is answered later, or not at all."""
    owner, core, events = Core(), Core(), list[Any]()
    journal = owner.queue.journal(1)
    copy = SimpleNamespace(journal=core.queue.journal(1), record=SimpleNamespace(incarnation=1), owner_epoch=4)

    def repeat(_: Any, step: QueueStep, ago_nanos: int) -> None:
        copy.journal.apply(step, core.now - ago_nanos)
        events.append("repeated")

    room = SimpleNamespace(claim=lambda size: None, set=lambda size: None)
    copies = SimpleNamespace(of=lambda queue_id: copy, apply=repeat, note_message=lambda copy, record: None)
    queues: Any = SimpleNamespace(
        copies=copies, memory=SimpleNamespace(charge_for=lambda owner: room), known=lambda queue_id: None,
        in_use=SimpleNamespace(set=lambda: None),
    )  # fmt: skip
    record: Any = SimpleNamespace(queue_id=b"q" * 16, created_by="", epoch=4)
    feed = _Feed(queues, record)

    def sent() -> list[Any]:
        assert journal.note(owner.now)
        steps = journal.steps_from(copy.journal.next_step, 2**20)
        assert steps is not None
        events.clear()
        request = pb.FeedQueueRequest(parts=[part for one in steps for part in step_parts(one, owner.now)])
        assert feed.take_steps(request, lambda place: events.append(place.next_step))
        return [*events]

    owner.put(3)
    assert sent() == [2, "repeated"]
    owner.taker(1, credit=10)
    assert owner.dispatched() == {1: [1]}
    assert sent() == [3, "repeated"], "the first fresh message is taken"
    owner.put(3)
    owner.dispatched()
    assert sent() == ["repeated", 4], "the step changes a message that it brings"


async def test_a_feed_that_ends_within_a_queue_leaves_no_bytes_in_the_budget() -> None:
    """In an earlier version, the host counted the parts that had come until it stopped, after each broken feed."""
    memory, owner = MemoryBudget(2**30), b"o" * 16
    copies = SimpleNamespace(of=lambda queue_id: None, drop=lambda queue_id: None, note_feed=lambda queue_id: None)
    queues: Any = SimpleNamespace(
        copies=copies, memory=memory, known=lambda queue_id: None, check_may_serve=lambda: None,
        scheduler=SimpleNamespace(begin=lambda pieces: freed.append(sum(1 for _ in pieces))),
    )  # fmt: skip
    source = AsyncMock(source_of=AsyncMock(return_value=FeedSource(owner, "owner:1", 4, is_replica=True)))
    record = queue_pb2.QueueRecord(queue_id=b"q" * 16, host_id=owner, epoch=4, incarnation=1)
    content = pb.HandOverQueueResponse(runs=[pb.HandedRun(body=bytes(1000))])
    unfinished = pb.FeedQueueRequest(begins_anew=True, parts=[pb.FedQueuePart(content=content)] * 3)
    used, freed = list[int](), list[int]()

    async def read() -> Any:
        used.append(memory.used_bytes)
        return requests.pop(0)

    requests: list[Any] = [pb.FeedQueueRequest(owner_host_id=owner, queue=record), unfinished, None]
    context: Any = SimpleNamespace(read=read, write=AsyncMock())
    await QueueFeeds(SimpleNamespace(host_id=b"r" * 16), queues, source, AsyncMock()).serve(context)  # type: ignore[arg-type]
    assert used[-1] >= 1000
    assert memory.used_bytes == 0
    assert freed == [3], "each piece frees one part"


async def test_a_replica_gives_signs_of_life_while_a_thread_restores_a_whole_queue(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """In an earlier version, the owner ended the feed after 3 s of silence, and sent the whole queue again."""
    monkeypatch.setattr(queue_feed_servicer, "SIGN_SECONDS", 0.001)
    owner, signs, enough, core = b"o" * 16, list[Any](), threading.Event(), Core()

    async def write(place: Any) -> None:
        signs.append(place)
        if len(signs) > 3:  # the first one answers the first request
            enough.set()

    copies = SimpleNamespace(
        of=lambda queue_id: None, drop=lambda queue_id: None, note_feed=lambda queue_id: None,
        begin=lambda *copy: begun.append(copy),
        restored=lambda record, state: enough.wait(10),
    )  # fmt: skip
    begun = list[Any]()
    queues: Any = SimpleNamespace(
        copies=copies, memory=MemoryBudget(2**30), known=lambda queue_id: None, check_may_serve=lambda: None,
        scheduler=PieceScheduler(),
    )  # fmt: skip
    source = AsyncMock(source_of=AsyncMock(return_value=FeedSource(owner, "owner:1", 4, is_replica=True)))
    record = queue_pb2.QueueRecord(queue_id=b"q" * 16, host_id=owner, epoch=4, incarnation=1)
    whole = pb.FeedQueueRequest(begins_anew=True, parts=whole_parts(core.queue.export(core.now), 1))
    requests: list[Any] = [pb.FeedQueueRequest(owner_host_id=owner, queue=record), whole, None]
    context: Any = SimpleNamespace(read=AsyncMock(side_effect=requests), write=write)
    await QueueFeeds(SimpleNamespace(host_id=b"r" * 16), queues, source, AsyncMock()).serve(context)  # type: ignore[arg-type]
    ((_, restored, _),) = begun
    assert restored, "the replica was silent until the queue was restored"
