"""A host that drains names its channels in one stream, and gets the outcome of each move."""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Awaitable, Callable
from contextlib import asynccontextmanager
from typing import Any

import pytest
from grpc.aio import EOF

from stampede_rt.errors import InvalidArgument, Overloaded
from stampede_rt.v1 import error_pb2
from stampede_rt.v1 import migration_service_pb2 as pb
from stampede_rt_channel_host.channels.streams import OpenStreams
from stampede_rt_channel_host.copies.moves.moves_of_drains import NAMED_MAX, UNANSWERED_MAX, MovesOfDrain


class Caller:
    """The context of a stream: the requests of a caller, and the answers."""

    def __init__(self) -> None:
        self.requests: asyncio.Queue[Any] = asyncio.Queue()
        self.answers: list[pb.MoveEachHereResponse] = []
        self.takes_answers = asyncio.Event()
        self.takes_answers.set()
        self.refused = ""

    def name(self, *channel_ids: bytes) -> None:
        self.requests.put_nowait(pb.MoveEachHereRequest(channel_ids=channel_ids))

    def close(self) -> None:
        self.requests.put_nowait(EOF)

    async def read(self) -> Any:
        return await self.requests.get()

    async def write(self, answer: pb.MoveEachHereResponse) -> None:
        await self.takes_answers.wait()
        self.answers.append(answer)

    async def abort(self, code: Any, details: str, trailing: Any = ()) -> None:
        self.refused = details
        raise asyncio.CancelledError

    @property
    def outcomes(self) -> dict[bytes, pb.MoveOutcome]:
        return {one.channel_id: one for answer in self.answers for one in answer.outcomes}


@asynccontextmanager
async def served(caller: Caller, move: Callable[[bytes], Awaitable[None]]) -> AsyncIterator[asyncio.Task[None]]:
    """A stream that the host serves. `move` takes a channel over."""

    async def serve() -> None:
        context: Any = caller
        async with OpenStreams().serve(context) as stream:
            await MovesOfDrain(stream, context, move).run()

    task = asyncio.create_task(serve())
    try:
        async with asyncio.timeout(30):
            yield task
    finally:
        task.cancel()
        await asyncio.wait({task})


async def turns() -> None:
    for _ in range(4 * UNANSWERED_MAX):
        await asyncio.sleep(0)


async def nothing(channel_id: bytes) -> None:
    """Succeed immediately."""


async def test_each_move_has_its_own_outcome() -> None:
    async def refuse_b(channel_id: bytes) -> None:
        if channel_id == b"b":
            raise Overloaded("no room for b")

    caller = Caller()
    caller.name(b"a", b"b")
    caller.name(b"c")
    caller.close()
    async with served(caller, refuse_b) as stream:
        await stream
    assert sorted(caller.outcomes) == [b"a", b"b", b"c"]
    assert [one.HasField("error") for one in (caller.outcomes[key] for key in (b"a", b"b", b"c"))] == [0, 1, 0]
    assert caller.outcomes[b"b"].error.reason == error_pb2.ERROR_REASON_OVERLOADED


async def test_a_slow_move_delays_no_outcome_and_outcomes_of_one_write_go_together() -> None:
    slow = asyncio.Event()

    async def move(channel_id: bytes) -> None:
        if channel_id == b"slow":
            await slow.wait()

    caller = Caller()
    async with served(caller, move) as stream:
        caller.name(b"slow", b"a", b"b", b"c")
        await turns()
        assert sorted(caller.outcomes) == [b"a", b"b", b"c"]
        assert len(caller.answers) == 1
        caller.close()
        await turns()
        assert not stream.done()
        slow.set()
        await stream
    assert b"slow" in caller.outcomes


async def test_a_caller_that_takes_no_answers_gets_no_more_moves() -> None:
    begun: list[bytes] = []

    async def move(channel_id: bytes) -> None:
        begun.append(channel_id)

    caller = Caller()
    caller.takes_answers.clear()
    async with served(caller, move) as stream:
        for at in range(4 * UNANSWERED_MAX):
            caller.name(b"%d" % at)
        await turns()
        assert len(begun) == UNANSWERED_MAX
        caller.takes_answers.set()
        caller.close()
        await stream
    assert len(begun) == len(caller.outcomes) == 4 * UNANSWERED_MAX


async def test_repeated_requests_for_slow_moves_take_no_room_from_other_channels() -> None:
    """In an earlier version, each repetition took room of the stream until the move ended, and others got none."""
    slow = asyncio.Event()
    begun: list[bytes] = []

    async def move(channel_id: bytes) -> None:
        begun.append(channel_id)
        if channel_id.startswith(b"slow"):
            await slow.wait()

    caller = Caller()
    async with served(caller, move) as stream:
        for _ in range(UNANSWERED_MAX):
            caller.name(b"slow a", b"slow b")
        caller.name(b"quick")
        await turns()
        assert [*caller.outcomes] == [b"quick"]
        slow.set()
        await turns()
        caller.name(b"slow a")
        caller.close()
        await stream
    assert begun == [b"slow a", b"slow b", b"quick", b"slow a"]


async def test_a_request_with_too_many_channels_ends_the_stream() -> None:
    caller = Caller()
    caller.name(*(b"%d" % at for at in range(NAMED_MAX + 1)))
    async with served(caller, nothing) as stream:
        with pytest.raises(asyncio.CancelledError):
            await stream
    assert caller.refused == InvalidArgument(f"the request names {NAMED_MAX + 1} channels; name 32 at most").message
