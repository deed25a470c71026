"""All streams of a host end when it shuts down: a few in each turn of the event loop."""

from __future__ import annotations

import asyncio
from collections import Counter
from typing import Any

import grpc

from stampede_rt.errors import Unavailable
from stampede_rt_channel_host.channels.streams import STREAMS_PER_TURN, OpenStreams

STREAMS = 200


class Call:
    async def abort(self, *_: Any, **__: Any) -> None:
        raise grpc.aio.AbortError

    def set_trailing_metadata(self, _: Any) -> None: ...


async def test_a_host_that_shuts_down_ends_a_few_streams_in_each_turn() -> None:
    streams, ended = OpenStreams(), Counter[int]()
    turn = 0

    async def serve() -> None:
        nonlocal turn
        try:
            async with streams.serve(Call()):  # type: ignore[arg-type]
                await asyncio.Event().wait()
        except grpc.aio.AbortError:
            ended[turn] += 1

    serving = [asyncio.create_task(serve()) for _ in range(STREAMS)]
    await asyncio.sleep(0)
    ending = asyncio.create_task(streams.end_all(Unavailable("the host shuts down")))
    while not ending.done():
        turn += 1
        await asyncio.sleep(0)
    await asyncio.gather(*serving)
    assert ended.total() == STREAMS
    assert max(ended.values()) <= STREAMS_PER_TURN
