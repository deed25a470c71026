"""The moves of a drain at the same time: how many, and how many to each destination."""

from __future__ import annotations

import asyncio

from stampede_rt_channel_host.copies.moves.drain_room import (
    MOVES_AT_FIRST,
    MOVES_PER_ANSWER,
    MOVES_PER_DESTINATION,
    PARALLEL_MOVES,
    PARALLEL_QUEUE_MOVES,
    SLOW_MOVE_SECONDS,
    DrainRoom,
)


class Moves:
    """Moves that last until `end` is set."""

    def __init__(self) -> None:
        self.room, self.end, self.under_way = DrainRoom(), asyncio.Event(), list[bytes]()

    async def move(self, host_id: bytes, *, is_queue: bool = False) -> None:
        async with self.room.move_slot(host_id, is_queue=is_queue):
            self.under_way.append(host_id)
            await self.end.wait()

    async def begun(self, *host_ids: bytes, is_queue: bool = False) -> None:
        """Begin moves to these hosts, as far as there is room."""
        self.tasks = [asyncio.create_task(self.move(one, is_queue=is_queue)) for one in host_ids]
        await self.turns()

    async def answered(self, host_id: bytes, times: int, seconds: float = 0.1) -> None:
        """Let the host take this many things over, each in this time."""
        for _ in range(times):
            self.room.note_move(host_id, seconds)
        await self.turns()

    async def turns(self) -> None:
        for _ in range(2 * PARALLEL_MOVES):
            await asyncio.sleep(0)


async def test_a_host_gets_few_moves_until_it_answers_and_other_hosts_get_the_remaining_moves() -> None:
    moves = Moves()
    await moves.begun(*[b"frozen"] * 50, *[b"runs"] * 150)
    assert moves.under_way == [b"frozen"] * MOVES_AT_FIRST + [b"runs"] * MOVES_AT_FIRST
    await moves.answered(b"runs", times=1)
    assert moves.under_way.count(b"runs") == MOVES_AT_FIRST + MOVES_PER_ANSWER
    await moves.answered(b"runs", times=MOVES_PER_DESTINATION)
    assert moves.under_way.count(b"runs") == MOVES_PER_DESTINATION
    assert moves.under_way.count(b"frozen") == MOVES_AT_FIRST


async def test_slow_moves_to_a_host_do_not_let_it_have_more_of_them() -> None:
    moves = Moves()
    await moves.begun(*[b"slow"] * 50)
    await moves.answered(b"slow", times=10, seconds=2 * SLOW_MOVE_SECONDS)
    assert len(moves.under_way) == MOVES_AT_FIRST
    await moves.answered(b"slow", times=1, seconds=SLOW_MOVE_SECONDS)
    assert len(moves.under_way) == MOVES_AT_FIRST + MOVES_PER_ANSWER


async def test_the_number_of_moves_to_all_hosts_is_limited_and_every_move_is_served() -> None:
    moves = Moves()
    await moves.begun(*(bytes([one % 3]) for one in range(360)))
    for host in range(3):
        await moves.answered(bytes([host]), times=MOVES_PER_DESTINATION)
    assert len(moves.under_way) == PARALLEL_MOVES < 3 * MOVES_PER_DESTINATION
    moves.end.set()
    await asyncio.gather(*moves.tasks)
    assert len(moves.under_way) == 360


async def test_waiting_moves_of_queues_do_not_hold_up_moves_of_channels() -> None:
    moves = Moves()
    await moves.begun(*[b"h"] * 50, is_queue=True)
    await moves.answered(b"h", times=MOVES_PER_DESTINATION)
    assert len(moves.under_way) == PARALLEL_QUEUE_MOVES
    await moves.begun(*[b"h"] * 100)
    assert len(moves.under_way) == MOVES_PER_DESTINATION
