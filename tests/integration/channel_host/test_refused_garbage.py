"""A host keeps nothing of what it refuses: an error in a circle with its traceback keeps the locals of all frames."""

from __future__ import annotations

import gc
from collections.abc import Iterator
from contextlib import contextmanager

from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import error_pb2, item_pb2
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from tests.support.channel_host.queue_rig import running_queue_host
from tests.support.channel_host.rig import running_host

BAD_RUN = item_pb2.ItemRun(payload_length_bytes=[1], payloads=b"longer than it says")


@contextmanager
def refusals_left_to_the_collector() -> Iterator[list[StampedeError]]:
    """Fills the list, at the end of the block, with the refusals that only the cyclic collector found.

    Refusals of bad requests alone: a host's own tasks may meet other errors meanwhile.
    """
    found: list[StampedeError] = []
    gc.collect()
    gc.set_debug(gc.DEBUG_SAVEALL)
    try:
        yield found
        gc.collect()
        found += [one for one in gc.garbage if isinstance(one, InvalidArgument) and one.__traceback__ is not None]
    finally:
        gc.set_debug(0)
        gc.garbage.clear()


async def test_a_refused_put_is_not_kept() -> None:
    async with running_host() as rig:
        channel = await rig.open()
        with refusals_left_to_the_collector() as left:
            (ack,) = await channel.put(pb.PutRun(first_number=1, run=BAD_RUN))
        assert ack.error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN
        assert left == []


async def test_a_refused_get_or_enqueue_is_not_kept() -> None:
    async with running_host() as rig:
        with refusals_left_to_the_collector() as left:
            call = rig.channels.Get(iter((pb.GetRequest(call_id=1, channel_id=b"x" * 16, epoch=1),)))
            assert [response.error.reason async for response in call] == [error_pb2.ERROR_REASON_INVALID_ARGUMENT]
        assert left == []
    async with running_queue_host() as queues:
        queue = queues.open()
        with refusals_left_to_the_collector() as left:
            (ack,) = await queue.enqueue(queue_pb.EnqueueRun(first_number=1, run=BAD_RUN))
            assert ack.error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN
        assert left == []
