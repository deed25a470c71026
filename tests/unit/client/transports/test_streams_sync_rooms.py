"""A stream drops a response that its caller has taken, because the next long response uses the same memory."""

from __future__ import annotations

import asyncio
import socket
import threading
from collections.abc import AsyncIterator, Iterator

from stampede_rt.transports import streams_async, streams_sync
from stampede_rt.transports.bidi_methods import BidiMethod
from stampede_rt.transports.socket_async import SocketCall as AsyncSocketCall
from stampede_rt.transports.socket_sync import SocketCall
from stampede_rt.transports.watchdog import Watchdog
from stampede_rt.wire.stream_frames import FrameKind, frame_of
from tests.support.socket_pairs import OPENING

VIEWS = BidiMethod("/test/Views", None, lambda body: body, lambda: None)
FULL_AND_ONE_MORE_ITEM = bytes(2**20 + 300_000)
RESPONSES = 4


def sending(far: socket.socket) -> threading.Thread:
    """A thread that sends the responses of a host, each of them once the system has taken the one before it."""
    thread = threading.Thread(
        target=lambda: [far.sendall(frame_of(FrameKind.MESSAGE, FULL_AND_ONE_MORE_ITEM)) for _ in range(RESPONSES)]
    )
    thread.start()
    return thread


def buffers_of(call: SocketCall | AsyncSocketCall) -> list[int]:
    """The list to which the lengths of the stream's new buffers will be added."""
    buffers: list[int] = []

    def new_buffer(frame_bytes: int) -> bytearray:
        buffers.append(frame_bytes)
        return bytearray(frame_bytes)

    call._frames._new_buffer = new_buffer
    return buffers


def test_a_blocking_stream_reads_each_full_response_into_the_same_memory() -> None:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    with far:
        call = SocketCall(near, VIEWS, OPENING, in_turn=False)
        responses: Iterator[memoryview] = iter(streams_sync.ServerStream(call, "a host", Watchdog()))
        sender, buffers = sending(far), buffers_of(call)
        for _ in range(RESPONSES):
            assert len(next(responses)) == len(FULL_AND_ONE_MORE_ITEM)
        sender.join()
        call.cancel()
    assert len(buffers) == 1


async def test_a_stream_on_asyncio_reads_each_full_response_into_the_same_memory() -> None:
    near, far = socket.socketpair(socket.AF_UNIX, socket.SOCK_STREAM)
    with far:
        near.setblocking(False)
        call = await AsyncSocketCall.open(near, VIEWS, OPENING)
        responses: AsyncIterator[memoryview] = aiter(streams_async.ServerStream(call, "a host"))
        sender, buffers = sending(far), buffers_of(call)
        for _ in range(RESPONSES):
            assert len(await anext(responses)) == len(FULL_AND_ONE_MORE_ITEM)
        await asyncio.to_thread(sender.join)
        call.cancel()
    assert len(buffers) == 1
