"""An ended stream leaves nothing to the garbage collector, however it ends, over each kind of socket.

A host collects all garbage every ten minutes. Until then each object that an ended stream leaves may keep a message.
"""

from __future__ import annotations

import asyncio
import gc
from collections import Counter
from collections.abc import Awaitable, Callable

import pytest

from stampede_rt.wire.stream_frames import FrameKind
from stampede_rt_runtime.sockets import server
from tests.support.raw_stream import RawStream, raw_stream
from tests.support.socket_port import (
    ECHO,
    FAIL,
    FLOOD,
    HOLD,
    READ_LATER,
    REFUSE,
    SAME_TURN,
    Open,
    Port,
    port_fixture,
    until,
)

port = port_fixture()
LONG = bytes(2**20)
PACKAGE = "stampede_rt_runtime.sockets"


async def regular_end(one: Port, stream: RawStream) -> None:
    await stream.begin(ECHO)
    await stream.send(FrameKind.MESSAGE, LONG)
    assert await stream.message() == LONG
    await stream.send(FrameKind.END)
    assert (await stream.status()).code == 0


async def refusal(one: Port, stream: RawStream) -> None:
    await stream.begin(REFUSE)
    assert (await stream.status()).code


async def defect(one: Port, stream: RawStream) -> None:
    await stream.begin(FAIL)
    assert (await stream.status()).code


async def defect_in_same_turn(one: Port, stream: RawStream) -> None:
    await stream.begin(SAME_TURN)
    kind = FrameKind.MESSAGE
    while kind == FrameKind.MESSAGE:  # the method echoes a message that comes before it waits; then send another one
        await stream.send(FrameKind.MESSAGE, b"defect")
        kind = (await stream.frame() or (FrameKind.STATUS,))[0]


async def caller_that_reads_nothing_and_goes(one: Port, stream: RawStream) -> None:
    await stream.begin(FLOOD)
    await one.streams.held.acquire()
    await until(lambda: any(made._is_full for made in one.server.sockets._streams))


async def caller_that_goes(one: Port, stream: RawStream) -> None:
    await stream.begin(HOLD)
    await one.streams.held.acquire()


async def caller_that_goes_with_unread_messages(one: Port, stream: RawStream) -> None:
    await stream.begin(READ_LATER)
    await one.streams.held.acquire()
    for _ in range(3):
        await stream.send(FrameKind.MESSAGE, bytes(50_000))


async def invalid_frame(one: Port, stream: RawStream) -> None:
    await stream.begin(ECHO)
    await stream.send_bytes(b"\xff" * 77)
    assert (await stream.status()).code


ENDS = [
    regular_end, refusal, defect, defect_in_same_turn, caller_that_reads_nothing_and_goes, caller_that_goes,
    caller_that_goes_with_unread_messages, invalid_frame,
]  # fmt: skip


def of_the_service() -> Counter[str]:
    """The objects that a service makes for its streams."""
    kinds = map(type, gc.get_objects())
    return Counter(kind.__qualname__ for kind in kinds if str(kind.__module__).startswith(PACKAGE))


@pytest.mark.parametrize("end", ENDS)
async def test_an_ended_stream_is_freed_without_the_garbage_collector(
    port: Open, end: Callable[[Port, RawStream], Awaitable[None]], monkeypatch: pytest.MonkeyPatch
) -> None:
    # pytest keeps the exceptions of log lines, and so the objects in their frames
    monkeypatch.setattr(server.logger, "disabled", True)

    async def stream(one: Port) -> None:
        async with raw_stream(one.target) as stream:
            await end(one, stream)
        await until(lambda: not one.server.sockets._streams)

    async with port() as one:
        await stream(one)  # makes the objects that the service makes once and keeps
        gc.collect()
        before = of_the_service()
        gc.disable()
        try:
            for _ in range(3):
                await stream(one)
            for _ in range(100):  # turns of the loop in which the last tasks end
                await asyncio.sleep(0)
            assert of_the_service() - before == {}
        finally:
            gc.enable()
