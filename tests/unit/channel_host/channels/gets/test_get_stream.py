"""The work of a stream of gets that the host does in pieces."""

from __future__ import annotations

import asyncio
from itertools import pairwise
from types import SimpleNamespace
from typing import Any

from stampede_rt_channel_host.channels.gets.get_stream import POLLS_PER_PIECE, GetStream
from stampede_rt_channel_host.channels.gets.waiting_gets import GETS_PER_PIECE
from stampede_rt_channel_host.channels.piece_scheduler import PieceScheduler

CALLS = 1000


class Get:
    def __init__(self, cancelled: list[int], number: int) -> None:
        self._cancelled, self._number = cancelled, number

    def cancel(self) -> None:
        self._cancelled.append(self._number)


async def test_the_waiting_gets_of_a_vanished_caller_are_cancelled_a_few_at_a_time() -> None:
    """In an earlier version, one turn of the event loop cancelled all waiting gets. 10,000 blocked gets took 57 ms."""
    cancelled: list[int] = []
    nothing: Any = None
    store: Any = SimpleNamespace(scheduler=PieceScheduler())
    stream = GetStream(store, nothing, nothing, nothing)
    stream._calls = {number: Get(cancelled, number) for number in range(CALLS)}  # type: ignore[misc]
    done = [0]
    for _ in stream._cancelling():
        done.append(len(cancelled))
    assert max(after - before for before, after in pairwise(done)) <= GETS_PER_PIECE
    assert {*cancelled} == {*range(CALLS)}


async def test_gets_that_waited_for_room_are_looked_at_a_few_at_a_time_in_order() -> None:
    """In an earlier version, when room for 256 answers came, one step made all of them."""
    polled: list[int] = []
    in_one_step: list[int] = []
    nothing: Any = None

    class HeldBack:
        def __init__(self, call_id: int) -> None:
            self.call_id, self.plan = call_id, SimpleNamespace(channel_id=b"", epoch=1, demand=None)
            self.hosted = SimpleNamespace(record=SimpleNamespace(name="a"))

        def poll(self, now: int) -> None:
            if not polled:
                asyncio.get_running_loop().call_soon(lambda: in_one_step.append(len(polled)))
            polled.append(self.call_id)

    store: Any = SimpleNamespace(scheduler=PieceScheduler(), now=lambda: 1, find_readable=lambda *_: None)
    stream = GetStream(store, nothing, nothing, nothing)
    stream._answer_or_wait = lambda *_: None  # type: ignore[method-assign]
    stream._held_back = {number: HeldBack(number) for number in range(100)}  # type: ignore[misc]
    stream._room_came()
    stream._room_came()  # more room changes nothing
    for _ in range(100):
        await asyncio.sleep(0)
    assert not stream._is_polling
    assert polled == [*range(100)]
    assert in_one_step == [POLLS_PER_PIECE]
