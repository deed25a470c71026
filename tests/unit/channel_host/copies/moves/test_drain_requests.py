"""The requests of a drain to one host, over a stream that takes no message for a while."""

from __future__ import annotations

import asyncio
from typing import Any

import pytest

from stampede_rt.errors import DeadlineExceeded, Unavailable
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.copies.moves.drain_requests import DrainRequests
from stampede_rt_channel_host.copies.moves.moves_of_drains import NAMED_MAX

CHANNELS = [b"c%d" % at for at in range(2 * NAMED_MAX)]


class Channel:
    """A connection and its stream. `is_open` set: the host takes messages, and answers each immediately."""

    def __init__(self) -> None:
        self.is_open = asyncio.Event()
        self.named: list[list[bytes]] = []
        self._responses: asyncio.Queue[pb.MoveEachHereResponse] = asyncio.Queue()

    def stream_stream(self, method: str, **named: Any) -> Any:
        return lambda: self

    async def write(self, request: pb.MoveEachHereRequest) -> None:
        await self.is_open.wait()
        self.named.append([*request.channel_ids])
        self._responses.put_nowait(
            pb.MoveEachHereResponse(outcomes=[pb.MoveOutcome(channel_id=one) for one in request.channel_ids])
        )

    async def read(self) -> pb.MoveEachHereResponse:
        return await self._responses.get()

    def cancel(self) -> None:
        """The stream ends."""

    async def close(self, grace: None) -> None:
        """The connection ends."""


async def test_no_message_names_a_channel_twice_or_one_that_was_given_up_or_too_many() -> None:
    """In an earlier version, one message gathered the names of repeated requests.

    The host refused the message, and so all of its moves.
    """
    channel: Any = Channel()
    requests = DrainRequests("host", channel)
    for _ in range(3):
        given_up = await asyncio.gather(*(requests.take(one, 0.0) for one in CHANNELS), return_exceptions=True)
        assert {type(one) for one in given_up} == {DeadlineExceeded}
    requested = [asyncio.ensure_future(requests.take(one, 30.0)) for one in CHANNELS[1:]]
    channel.is_open.set()
    assert await asyncio.gather(*requested) == [True] * len(requested)
    await requests.aclose()

    later = [one for names in channel.named[1:] for one in names]  # the first message was under way before
    assert sorted(later) == sorted(CHANNELS[1:])
    assert max(map(len, channel.named)) <= NAMED_MAX


class BrokenOnce(Channel):
    """The first stream breaks. Its task that writes ends a little later."""

    def __init__(self) -> None:
        super().__init__()
        self.is_written, self.breaks, self.ends = asyncio.Event(), asyncio.Event(), asyncio.Event()
        self.ends_slowly = True

    async def write(self, request: pb.MoveEachHereRequest) -> None:
        self.is_written.set()
        try:
            await super().write(request)
        except asyncio.CancelledError:
            if self.ends_slowly:
                self.ends_slowly = False
                self.is_open.set()
                await self.ends.wait()
            raise

    async def read(self) -> pb.MoveEachHereResponse:
        if not self.breaks.is_set():
            await self.breaks.wait()
            raise Unavailable("the stream is broken")
        return await super().read()


async def test_a_request_that_comes_while_a_broken_stream_ends_is_asked_in_the_next_stream() -> None:
    """In an earlier version, it failed with the error of the broken stream."""
    channel: Any = BrokenOnce()
    requests = DrainRequests("host", channel)
    first = asyncio.ensure_future(requests.take(CHANNELS[0], 5.0))
    await channel.is_written.wait()
    channel.breaks.set()
    with pytest.raises(Unavailable):
        await first
    second = asyncio.ensure_future(requests.take(CHANNELS[1], 5.0))
    await asyncio.sleep(0.0)
    channel.ends.set()
    assert await second
    await requests.aclose()


@pytest.mark.parametrize("channels", [1, NAMED_MAX, NAMED_MAX + 1])
async def test_the_requests_of_one_turn_go_together(channels: int) -> None:
    channel: Any = Channel()
    channel.is_open.set()
    requests = DrainRequests("host", channel)
    await asyncio.gather(*(requests.take(one, 30.0) for one in CHANNELS[:channels]))
    await requests.aclose()
    assert len(channel.named) == -(-channels // NAMED_MAX)
