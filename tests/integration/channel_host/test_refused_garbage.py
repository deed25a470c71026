"""A host keeps nothing of a refused request. An error in a reference cycle with its traceback would keep the local
variables of all frames.
"""

from __future__ import annotations

import asyncio
import gc
from collections import Counter
from collections.abc import Awaitable, Callable, Iterator
from contextlib import contextmanager

import pytest

from stampede_rt.errors import InvalidArgument, StampedeError
from stampede_rt.transports.grpc_options import PUT_METHOD
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import error_pb2, item_pb2
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.wire.stream_frames import FrameKind
from tests.robustness.fuzz.ports.socket_calls import socket_target
from tests.support.channel_host.queue_rig import running_queue_host
from tests.support.channel_host.rig import OpenedChannel, run_of, running_host
from tests.support.raw_stream import raw_stream

BAD_RUN = item_pb2.ItemRun(payload_length_bytes=[1], payloads=b"longer than it says")


@contextmanager
def refusals_left_to_the_collector() -> Iterator[list[StampedeError]]:
    """Fills the list, at the end of the block, with the refusals that only the cyclic collector found.

    It has only refusals of bad requests, because a host's own tasks may meet other errors meanwhile.
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


async def test_a_refused_put_uses_no_memory_afterwards() -> None:
    async with running_host() as rig:
        channel = await rig.open()
        with refusals_left_to_the_collector() as left:
            (ack,) = await channel.put(pb.PutRun(first_number=1, run=BAD_RUN))
        assert ack.error.reason == error_pb2.ERROR_REASON_MALFORMED_RUN
        assert left == []


async def test_a_refused_get_or_enqueue_uses_no_memory_afterwards() -> None:
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


async def puts_over_grpc(channel: OpenedChannel, target: str) -> None:
    await channel.put(run_of(b"x"))


async def puts_over_a_socket(channel: OpenedChannel, target: str) -> None:
    request = pb.PutRequest(channel_id=channel.channel_id, epoch=channel.epoch, puts=[run_of(b"x")])
    async with raw_stream(target) as stream:
        await stream.begin(PUT_METHOD)
        for _ in range(2):  # the host may answer the second request in the turn in which this request comes
            await stream.send(FrameKind.MESSAGE, request.SerializeToString())
            assert not pb.PutResponse.FromString(await stream.message()).acks[0].HasField("error")


def is_of_the_host(found: object) -> bool:
    """Whether this object belongs to the host's side of a stream."""
    return type(found).__module__.startswith(("stampede_rt_runtime", "stampede_rt_channel_host"))


@pytest.mark.parametrize("puts", [puts_over_grpc, puts_over_a_socket])
async def test_a_stream_of_puts_makes_no_garbage_in_cycles(
    puts: Callable[[OpenedChannel, str], Awaitable[None]],
) -> None:
    """In an earlier version, objects of a stream's rights and answers referred to each other, and stayed for 10
    minutes.
    """
    async with running_host() as rig:
        channel, target = await rig.open(), await socket_target(rig.connection, ())
        await puts(channel, target)
        gc.collect()
        gc.set_debug(gc.DEBUG_SAVEALL)
        try:
            for _ in range(5):
                await puts(channel, target)
            async with asyncio.timeout(20):
                while rig.sockets._streams or any(PUT_METHOD in one.get_name() for one in asyncio.all_tasks()):  # noqa: ASYNC110
                    await asyncio.sleep(0)
            gc.collect()
            left = Counter(type(one).__qualname__ for one in gc.garbage if is_of_the_host(one))
        finally:
            gc.set_debug(0)
            gc.garbage.clear()
        assert left == {}
