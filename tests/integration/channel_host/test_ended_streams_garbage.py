"""A host frees the memory of a stream as soon as the stream ends, even if its caller leaves and has read nothing.

In an earlier version, each stream that a reader of 1 MiB items left in this way kept 1 MiB until the garbage collector
ran, every ten minutes.
"""

from __future__ import annotations

import asyncio
import gc
from collections import Counter
from collections.abc import AsyncIterator, Awaitable, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from typing import Any

import pytest

from stampede_rt.transports.grpc_options import ENQUEUE_METHOD, PUT_METHOD
from stampede_rt.v1 import channel_service_pb2 as pb
from stampede_rt.v1 import queue_service_pb2 as queue_pb
from stampede_rt.wire.stream_frames import FrameKind
from stampede_rt_runtime.sockets.tcp_socket import listen_over_tcp
from tests.robustness.fuzz.ports.socket_calls import socket_target
from tests.support.channel_host import queue_rig
from tests.support.channel_host.queue_rig import QueueRig, running_queue_host
from tests.support.channel_host.rig import MAX_INSTANT, MIN_INSTANT, Rig, instant, run_of, running_host
from tests.support.raw_stream import RawStream, raw_stream
from tests.support.socket_port import until

SERVICE = "/stampede_rt.v1.ChannelService"
ITEMS = 8
ITEM = bytes(2**20)


@contextmanager
def left_to_the_collector() -> Iterator[Counter[str]]:
    """Fills the counter, at the end of the block, with the host's objects that only the cyclic collector found."""
    found: Counter[str] = Counter()
    gc.collect()
    gc.set_debug(gc.DEBUG_SAVEALL)
    try:
        yield found
        gc.collect()
        found.update(type(one).__qualname__ for one in gc.garbage if is_of_a_stream(one))
    finally:
        gc.set_debug(0)
        gc.garbage.clear()


def is_of_a_stream(found: object) -> bool:
    """Whether this object belongs to a stream that the host serves. Objects of the host's own calls are in
    `cluster`.
    """
    module = str(type(found).__module__)  # in some classes that are written in C, this attribute is a descriptor
    return module.startswith(("stampede_rt_runtime", "stampede_rt_channel_host")) and ".cluster." not in module


async def until_stuck(rig: Any) -> None:
    """Wait until the host waits for a reader that takes nothing."""
    await until(lambda: any(one._is_full for one in rig.sockets._streams))


async def gets(rig: Rig, stream: RawStream, *, count: int = ITEMS) -> None:
    """Many gets of everything, whose answers no reader reads."""
    channel = await filled(rig)
    await stream.begin(f"{SERVICE}/Get")
    for call_id in range(1, count + 1):
        await stream.send(FrameKind.MESSAGE, channel.get_request(call_id).SerializeToString())
    await until_stuck(rig)


async def gets_that_wait(rig: Rig, stream: RawStream) -> None:
    channel = await filled(rig)
    await stream.begin(f"{SERVICE}/Get")
    for call_id in range(1, 4):
        request = channel.get_request(call_id, interval=channel.future(), wait_nanos=-1)
        await stream.send(FrameKind.MESSAGE, request.SerializeToString())
    await channel.until(lambda status: status.waiting_gets == 3)


async def answered_get(rig: Rig, stream: RawStream) -> None:
    channel = await filled(rig)
    await stream.begin(f"{SERVICE}/Get")
    await stream.send(FrameKind.MESSAGE, channel.newest_request().SerializeToString())
    while not pb.GetResponse.FromString(await stream.message()).HasField("summary"):
        pass


async def subscription(rig: Rig, stream: RawStream) -> None:
    channel = await filled(rig)
    await stream.begin(f"{SERVICE}/Subscribe")
    request = channel.subscribe_request(credit_bytes=MAX_INSTANT, start=instant(MIN_INSTANT))
    await stream.send(FrameKind.MESSAGE, request.SerializeToString())
    await until_stuck(rig)


async def idle_subscription(rig: Rig, stream: RawStream) -> None:
    channel = await filled(rig)
    await stream.begin(f"{SERVICE}/Subscribe")
    await stream.send(FrameKind.MESSAGE, channel.subscribe_request(credit_bytes=MAX_INSTANT).SerializeToString())
    await stream.message()


async def puts(rig: Rig, stream: RawStream) -> None:
    """Puts of which the caller reads no ack."""
    channel = await filled(rig)
    await stream.begin(PUT_METHOD)
    for number in range(1, 4):
        request = pb.PutRequest(
            channel_id=channel.channel_id, epoch=channel.epoch, puts=[run_of(bytes(200_000), number=number)]
        )
        await stream.send(FrameKind.MESSAGE, request.SerializeToString())
    await channel.until(lambda status: status.counters.accepted >= ITEMS + 3)


async def invalid_put(rig: Rig, stream: RawStream) -> None:
    await stream.begin(PUT_METHOD)
    await stream.send(FrameKind.MESSAGE, b"\xff" * 77)
    assert (await stream.status()).code


async def filled(rig: Rig) -> Any:
    """The channel of a test. The first call makes it, and puts ITEMS into it."""
    known = rig.__dict__.get("filled")
    if known is None:
        known = rig.__dict__["filled"] = await rig.open()
        for _ in range(ITEMS):
            (ack,) = await known.put(run_of(ITEM))
            assert not ack.HasField("error")
    return known


@asynccontextmanager
async def at_its_socket(rig: Any, kind: str) -> AsyncIterator[str]:
    """The target of the host's socket of this kind."""
    if kind == "unix":
        yield await socket_target(rig.connection, ())
        return
    listening = listen_over_tcp("localhost", 0, allow_insecure_anywhere=False)
    rig.sockets.listen_over_tcp(listening)
    yield f"tcp:localhost:{listening[0].getsockname()[1]}"


async def left_by(rig: Any, target: str, leave: Callable[[Any, RawStream], Awaitable[None]]) -> Counter[str]:
    """The objects of streams that remain after the callers have left without closing them."""

    async def stream() -> None:
        async with raw_stream(target) as stream:
            await leave(rig, stream)
        await until(lambda: not rig.sockets._streams)
        for _ in range(100):  # turns of the loop in which the last tasks end
            await asyncio.sleep(0)

    await stream()
    with left_to_the_collector() as left:
        for _ in range(2):
            await stream()
    return left


@pytest.mark.parametrize("kind", ["unix", "tcp"])
@pytest.mark.parametrize(
    "leave", [gets, gets_that_wait, answered_get, subscription, idle_subscription, puts, invalid_put]
)
async def test_a_stream_of_a_channel_is_freed_without_the_garbage_collector(
    kind: str, leave: Callable[[Rig, RawStream], Awaitable[None]]
) -> None:
    async with running_host() as rig, at_its_socket(rig, kind) as target:
        assert await left_by(rig, target, leave) == {}


async def enqueues(rig: QueueRig, stream: RawStream) -> None:
    queue = rig.open()
    await stream.begin(ENQUEUE_METHOD)
    for number in range(1, 4):
        request = queue.enqueue_request(queue_rig.run_of(bytes(200_000), number=number))
        await stream.send(FrameKind.MESSAGE, request.SerializeToString())
    await queue.until(lambda status: status.counters.accepted == 3)


async def take(rig: QueueRig, stream: RawStream) -> None:
    """A taker with much credit that reads nothing."""
    queue = rig.open()
    for _ in range(ITEMS):
        await queue.put(ITEM)
    opened = queue_pb.TakeOpen(queue_id=queue.queue_id, epoch=queue.record.epoch, taker_id=1)
    await stream.begin("/stampede_rt.v1.QueueService/Take")
    await stream.send(FrameKind.MESSAGE, queue_pb.TakeRequest(open=opened, credit=1000).SerializeToString())
    await until_stuck(rig)


@pytest.mark.parametrize("leave", [enqueues, take])
async def test_a_stream_of_a_queue_is_freed_without_the_garbage_collector(
    leave: Callable[[QueueRig, RawStream], Awaitable[None]],
) -> None:
    async with running_queue_host() as rig, at_its_socket(rig, "unix") as target:
        assert await left_by(rig, target, leave) == {}
