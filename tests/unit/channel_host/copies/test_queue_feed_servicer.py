"""The host of a queue's replica lets the caller of a feed change only the replica of that queue."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.errors import InvalidArgument, StaleBinding
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.copies.queue_feed_servicer import STEPS_AT_ONCE_MAX, _Feed
from stampede_rt_channel_host.copies.queue_steps import whole_parts
from tests.support.channel_host.queue_cores import Core


async def test_an_owner_that_feeds_one_queue_cannot_replace_the_copy_of_another() -> None:
    """The host has checked the ownership only for the queue of the first request. A later request names another one."""
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
    """A fixed fault: a thread restored the queue of the former owner, and it replaced the copy of the next owner."""
    begun: list[Any] = []
    room = SimpleNamespace(claim=lambda size: None, set=lambda size: None)
    copies = SimpleNamespace(
        drop=lambda queue_id: None, of=lambda queue_id: None, begin=lambda *copy: begun.append(copy),
        restored=lambda record, state: latest.clear(),
    )  # fmt: skip
    queues: Any = SimpleNamespace(
        copies=copies, memory=SimpleNamespace(charge_for=lambda owner: room), known=lambda queue_id: None
    )
    record: Any = SimpleNamespace(queue_id=b"q" * 16, created_by="", name="jobs", host_id=b"h" * 16)
    core = Core()
    request = pb.FeedQueueRequest(begins_anew=True, parts=whole_parts(core.queue.export(core.now), 1))
    latest = ["this feed"]
    with pytest.raises(StaleBinding):
        await _Feed(queues, record).take(request, lambda: bool(latest))
    assert not begun


def test_a_feed_takes_only_steps_at_once() -> None:
    """The other host may need a thread for a whole queue."""
    room = SimpleNamespace(claim=lambda size: None, set=lambda size: None)
    copies = SimpleNamespace(drop=lambda queue_id: None, of=lambda queue_id: None)
    queues: Any = SimpleNamespace(
        copies=copies, memory=SimpleNamespace(charge_for=lambda owner: room), known=lambda queue_id: None
    )
    record: Any = SimpleNamespace(queue_id=b"q" * 16, created_by="")
    feed = _Feed(queues, record)
    assert feed.take_steps(pb.FeedQueueRequest())
    assert not feed.take_steps(pb.FeedQueueRequest(begins_anew=True))
    assert not feed.take_steps(pb.FeedQueueRequest(parts=[pb.FedQueuePart()] * (STEPS_AT_ONCE_MAX + 1)))
    feed._parts.begin_anew()
    assert not feed.take_steps(pb.FeedQueueRequest())
