"""The host of a queue's replica lets the caller of a feed change only the replica of that queue."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import pytest

from stampede_rt.errors import InvalidArgument
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.copies.queue_feed_servicer import _Feed


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
        await _Feed(queues, record).take(request)
    assert not dropped
